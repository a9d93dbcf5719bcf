"""What a person sees while a study is measured: which jobs are under way, what came out, how long it will take."""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from odaf.studies.cost import minutes

_SECONDS_BETWEEN_NEWS = 0.5
_SECONDS_BETWEEN_LINES = 30.0
# The estimates weigh as much as if this share of the whole had been done at their pace: what this machine takes longer
# shows from the first minutes, and a job that begins with a slow model does not make hours into days.
_BELIEVED = 0.1

News = tuple[str, str, str, float]  # job, "share" or "message", text, done share of what was left when it began


class JobReport:
    """Tells how far one job has come to whoever displays them all; a `ProgressReport`.

    Args:
        job: its name.
        tell: takes `News`.
    """

    def __init__(self, job: str, tell: Callable[[News], object]):
        self._job, self._tell, self._told = job, tell, 0.0
        self._stage, self._unit, self._first, self._total = "", "", 0, 0

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        self._stage, self._unit, self._first, self._total = stage, unit, done, total
        self._say(done)

    def advance(self, done: int, note: str = "") -> None:
        del note
        if done >= self._total or time.monotonic() - self._told >= _SECONDS_BETWEEN_NEWS:
            self._say(done)

    def message(self, text: str) -> None:
        self._tell((self._job, "message", text, 0.0))

    def close(self) -> None: ...

    def _say(self, done: int) -> None:
        self._told = time.monotonic()
        # Only the training proper says how much of a job is done; a model before it may take longer, or no time.
        counts = self._total > 0 and self._unit == "updates" and self._stage.endswith("training")
        far = f"{done:,} of {self._total:,}"
        text = f"{far} {self._unit}" if counts else f"{self._stage} {far}" if self._total > 0 else self._stage
        share = (done - self._first) / max(1, self._total - self._first) if counts else 0.0
        self._tell((self._job, "share", text, share))


@runtime_checkable
class Stream(Protocol):
    """What lines can be written to: standard error, or another open text file."""

    def write(self, text: str, /) -> object: ...

    def flush(self) -> object: ...

    def isatty(self) -> bool: ...


@dataclass
class Display:
    """Lines on a stream: one for each job that is done, and one every half minute in between; a bar on a terminal.

    Attributes:
        name: of the study.
        stream: where to write.
    """

    name: str
    stream: Stream = field(default_factory=lambda: sys.stderr)

    def begin(self, missing: int, jobs: int, estimates: Mapping[str, float], width: int, until: float | None) -> None:
        """Says what is to be done.

        Args:
            missing: jobs to do.
            jobs: that were asked for.
            estimates: seconds for each of the missing ones.
            width: jobs at the same time.
            until: a time of `time.monotonic`, when the study is stopped.
        """
        self._estimates, self._width, self._until = dict(estimates), width, until
        self._done, self._shares, self._texts = dict[str, float](), dict[str, float](), dict[str, str]()
        self._began = self._shown = time.monotonic()
        self._bar: Any = None
        cost = f", about {minutes(sum(estimates.values()))} of one core" if missing else ""
        self._write(f"{self.name}: {missing} of {jobs} records to go{cost}")
        if missing and self.stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

            latest = TextColumn("{task.fields[text]}")
            columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), latest)
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(self.name, total=sum(estimates.values()) or None, text="")
            self._bar.start()

    def receive(self, news: News) -> None:
        """Takes what a `JobReport` told."""
        job, event, text, share = news
        if event == "message":
            self._write(f"{job}: {text}")
            return
        self._texts[job] = text
        self._shares[job] = max(share, self._shares.get(job, 0.0))
        if self._bar is not None:
            self._bar.update(self._task, completed=self._worth(), text=self._latest())
        elif time.monotonic() - self._shown >= _SECONDS_BETWEEN_LINES:
            self._shown = time.monotonic()
            self._write(f"{self.name}: {self._latest()}")

    def finished(self, job: str, said: str) -> None:
        """Takes a job whose record is there."""
        self._done[job] = self._estimates.get(job, 0.0)
        self._texts.pop(job, None)
        self._shares.pop(job, None)
        self._shown = time.monotonic()
        self._write(f"[{len(self._done)}/{len(self._estimates)}] {job}: {said}{self._time_left()}")

    def close(self) -> None:
        """Ends the bar; says what was stopped because the time is over."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        left = len(self._estimates) - len(self._done)
        if self._until is not None and left and time.monotonic() >= self._until:
            self._write(f"{self.name}: the time is over, {left} records are still to go; the same command goes on")

    def _worth(self) -> float:
        """Seconds by estimate of what is done."""
        under_way = (self._estimates.get(job, 0.0) * share for job, share in self._shares.items())
        return sum(self._done.values()) + sum(under_way)

    def _time_left(self) -> str:
        worth, whole, passed = self._worth(), sum(self._estimates.values()), time.monotonic() - self._began
        if len(self._done) == len(self._estimates):
            return ""
        believed = _BELIEVED * whole
        seconds = (whole - worth) * (passed + believed / self._width) / max(worth + believed, 1e-9)
        if self._until is not None:
            seconds = min(seconds, max(0.0, self._until - time.monotonic()))
        return f"; {minutes(seconds)} left"

    def _latest(self) -> str:
        jobs = ", ".join(f"{job} {text}" for job, text in self._texts.items() if job in self._estimates)
        return f"{jobs or 'data'}{self._time_left()}"

    def _write(self, line: str) -> None:
        if self._bar is not None:
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
        else:
            self.stream.write(f"{line}\n")
            self.stream.flush()
