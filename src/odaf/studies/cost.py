"""What jobs cost: seconds of one core, from their own records where there are any, else from those of like jobs."""

import statistics
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any

from odaf.studies.job import Job, Record


class Costs:
    """Estimates from measured records.

    A job's own record is the best witness, also a stale one; then the records of jobs that share most with it; then
    the work's own guess. Of several records the median counts.

    Args:
        measured: jobs with their records, of this study and of others.
    """

    def __init__(self, measured: Iterable[tuple[Job, Record]]):
        self._own: dict[tuple[type, str], float] = {}
        self._rates: dict[Hashable, list[float]] = {}
        for job, record in measured:
            seconds = seconds_of(record)
            if seconds is None or job.do.amount <= 0:
                continue
            self._own[type(job.do), job.name] = seconds
            for key in job.do.likeness():
                self._rates.setdefault((type(job.do), key), []).append(seconds / job.do.amount)

    def whole(self, job: Job) -> float:
        """Seconds for the job from its beginning."""
        if (own := self._own.get((type(job.do), job.name))) is not None:
            return own
        for key in job.do.likeness():
            if rates := self._rates.get((type(job.do), key)):
                return statistics.median(rates) * job.do.amount
        return job.do.guess() * job.do.amount

    def left(self, job: Job, place: Path | None, before: Sequence[Job] = ()) -> float:
        """Seconds for what is left of the job.

        Args:
            job: the job.
            place: the work directory, where a part of it may be done; None counts nothing that is done.
            before: jobs that will be done when it begins; one of its line leaves it less to do.
        """
        done = 0.0 if place is None else job.do.amount_done(place)
        if job.do.line is not None:
            done = max([done, *(other.do.amount for other in before if other.do.line == job.do.line)])
        return self.whole(job) * max(0.0, 1.0 - done / job.do.amount)

    def total(self, jobs: Sequence[Job], place: Path | None = None) -> float:
        """Seconds for what is left of all these jobs, done in this order."""
        lines: dict[str, list[Job]] = {}
        seconds = 0.0
        for job in jobs:
            before = lines.setdefault(job.do.line or job.name, [])
            seconds += self.left(job, place, before)
            before.append(job)
        return seconds


def seconds_of(record: Record) -> float | None:
    """What a record says it took; None where many trainings shared the time, which says nothing of one."""
    seconds: Any = record.get("seconds") if record.get("lanes", 1) == 1 else None
    if isinstance(seconds, dict):
        seconds = seconds.get("total")
    return float(seconds) if isinstance(seconds, int | float) else None


def minutes(seconds: float) -> str:
    """A duration as a person would say it: "40 s", "12 min", "3.5 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"
