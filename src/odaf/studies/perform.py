"""Doing the jobs of a study that are not held: in the order of the plan, within a number of minutes if one is given."""

import contextlib
import functools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.runs.workers import send
from odaf.studies.cost import Costs
from odaf.studies.executor import Executor
from odaf.studies.job import Job, Log, Record, Work
from odaf.studies.ledger import Ledger
from odaf.studies.news import Display, JobReport

if TYPE_CHECKING:
    from odaf.training.progress import ProgressReport


@dataclass(frozen=True)
class MakeLog(Work):
    """The log that jobs learn from; it leaves no record, and is there when its file is.

    Attributes:
        made: the log.
    """

    made: Log

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.data.dataset import Dataset

        progress.start(f"data of {self.made.name}", 0)
        dataset = Dataset.load(self.made.present(place))
        return {"prints": [dataset.fingerprint(), dataset.file_fingerprint()], "seconds": None}

    def identity(self) -> dict[str, Any]:
        return self.made.recipe()


def perform(
    ledger: Ledger,
    jobs: Sequence[Job],
    place: Path,
    executor: Executor,
    display: Display,
    *,
    minutes: float | None = None,
    costs: Costs | None = None,
) -> None:
    """Measures every job whose record is not held, and redraws the tables after each.

    The order of `jobs` is their priority. With `minutes`, a job begins if it should be done in the time that is left;
    one that is too long makes room for later ones that fit, and when none fits, what is left of the time goes into the
    first that is too long. Jobs that run at the end are stopped; trainings go on from their last checkpoint next time.

    Args:
        ledger: where the records go.
        jobs: in order; those of the study that were asked for.
        place: directory of data and run directories.
        executor: where jobs are done.
        display: hears what happens.
        minutes: when to stop; None does everything.
        costs: estimates; None makes them from the ledger alone.

    Raises:
        ConfigError: a log or a record does not fit the ledger.
    """
    begun = time.monotonic()
    missing = [job for job in jobs if ledger.standing(job).state != "held"]
    if costs is None:
        costs = Costs((job, record) for job in jobs if (record := ledger.record(job)) is not None)
    until = None if minutes is None else begun + 60.0 * minutes
    queue = _Queue(missing, costs, place, executor.width, until)
    display.begin(len(missing), len(jobs), queue.estimates, executor.width, until)
    if missing:
        place.mkdir(parents=True, exist_ok=True)
        results = executor.run(
            functools.partial(_do, place), queue.ready(), then=queue.finished, receive=display.receive, until=until
        )
        with contextlib.closing(display), contextlib.closing(results):
            for job, record in results:
                if isinstance(job.do, MakeLog):
                    ledger.note_log(job.do.made, record["prints"])
                    continue
                written = ledger.write(job, record)
                display.finished(job.name, job.do.said(written))
                ledger.draw()
    ledger.draw()


def _do(place: Path, job: Job) -> Record:
    """In a worker, or here: one job."""
    from odaf.training.memory import forget_programs_in_time

    forget_programs_in_time()
    return job.do.do(place, JobReport(job.name, send))


class _Queue:
    """Which jobs may begin: those whose predecessors are done, as long as they fit in the time that is left."""

    def __init__(self, missing: Sequence[Job], costs: Costs, place: Path, width: int, until: float | None):
        self._width, self._until, self._place = width, until, place
        logs: dict[str, Job] = {}
        for job in missing:
            if job.do.log is not None and job.do.log.name not in logs:
                logs[job.do.log.name] = Job(f"data of {job.do.log.name}", MakeLog(job.do.log))
        waits = {job.name for job in [*logs.values(), *missing]}
        self._after = {job.name: waits & set(job.after) for job in missing} | {job.name: set() for job in logs.values()}
        self._waiting: list[Job] = []
        for job in missing:
            if job.do.log is not None:
                log = logs[job.do.log.name]
                self._after[job.name] |= {log.name}
                if log not in self._waiting:
                    self._waiting.append(log)
            self._waiting.append(job)
        self._under_way: dict[str, float] = {}  # when it began
        self._passed = self._expected = 0.0  # seconds of finished jobs, and what they were estimated at
        self.estimates: dict[str, float] = {}
        before: dict[str | None, list[Job]] = {}
        for job in missing:
            self.estimates[job.name] = costs.left(job, place, before.get(job.do.line, ()))
            before.setdefault(job.do.line, []).append(job)

    def ready(self) -> list[Job]:
        """Jobs to begin now, no more than there is room for."""
        begin: list[Job] = []
        while len(self._under_way) < self._width and (job := self._next()) is not None:
            self._waiting.remove(job)
            self._under_way[job.name] = time.monotonic()
            begin.append(job)
        return begin

    def finished(self, job: Job, record: Record) -> list[Job]:
        """Takes what is done; returns what begins next."""
        del record
        began = self._under_way.pop(job.name)
        if job.name in self.estimates:
            self._passed += time.monotonic() - began
            self._expected += self.estimates[job.name]
        for others in self._after.values():
            others.discard(job.name)
        return self.ready()

    def _next(self) -> Job | None:
        free = [job for job in self._waiting if not self._after[job.name]]
        if self._until is None:
            return free[0] if free else None
        left = self._until - time.monotonic()
        if left <= 0.0:
            return None
        needed = {name for job in self._waiting if self._fits(job, left) for name in self._after[job.name]}
        fitting = [job for job in free if (isinstance(job.do, MakeLog) and job.name in needed) or self._fits(job, left)]
        return (fitting or free or [None])[0]

    def _fits(self, job: Job, left: float) -> bool:
        pace = self._passed / self._expected if self._expected else 1.0  # of this machine, beside where it was measured
        return not isinstance(job.do, MakeLog) and self.estimates[job.name] * pace <= left
