"""What a person sees while a run trains: a bar on a terminal, a line every ten seconds elsewhere."""

import sys
import time
from typing import Protocol, runtime_checkable

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_SECONDS_BEFORE_A_RATE = 0.5


@runtime_checkable
class ProgressReport(Protocol):
    """Hears how far a stage has come. Stages follow one another; `close` ends the last."""

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        """Begins a stage of `total` units (0: unknown), `done` of which were made by an earlier process."""
        ...

    def advance(self, done: int, note: str = "") -> None:
        """Says that `done` units of the stage are made; `note` is shown beside the numbers until the next note."""
        ...

    def message(self, text: str) -> None:
        """Shows a line that stays, such as a warning."""
        ...

    def close(self) -> None: ...


class Silent:
    """Shows nothing."""

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None: ...

    def advance(self, done: int, note: str = "") -> None: ...

    def message(self, text: str) -> None: ...

    def close(self) -> None: ...


class Bar:
    """A bar with the stage, updates a second, time left and the last evaluation."""

    def __init__(self, console: Console):
        self._console = console
        self._progress: Progress | None = None

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        self.close()
        self._rate, self._total, self._note = _Rate(done, unit), total, ""
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[count]}"),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("{task.fields[note]}"),
            console=self._console,
        )
        self._task = self._progress.add_task(stage, total=total or None, completed=done, rate="", note="", count="")
        self._progress.start()

    def advance(self, done: int, note: str = "") -> None:
        if self._progress is None:
            return
        self._note = note or self._note
        rate = self._rate.text(done)
        self._progress.update(self._task, completed=done, rate=rate, note=self._note, count=f"{done:,}/{self._total:,}")

    def message(self, text: str) -> None:
        self._console.print(text, style="yellow", markup=False, highlight=False)

    def close(self) -> None:
        if self._progress is not None:
            self._progress.stop()
            self._progress = None


@runtime_checkable
class Stream(Protocol):
    """What lines can be written to: an open text file, or standard error."""

    def write(self, text: str, /) -> object: ...

    def flush(self) -> object: ...


class Lines:
    """Plain lines for logs and pipes: at most one every `interval` seconds, and one at the end of a stage."""

    def __init__(self, stream: Stream, interval: float = 10.0):
        self._stream = stream
        self._interval = interval
        self._stage: str | None = None

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        self._stage, self._total, self._note = stage, total, ""
        self._rate = _Rate(done, unit)
        self._shown = time.monotonic()
        self._last: tuple[int, str] | None = None

    def advance(self, done: int, note: str = "") -> None:
        if self._stage is None:
            return
        self._note = note or self._note
        now = time.monotonic()
        if done < self._total and now - self._shown < self._interval:
            return
        if self._last == (done, self._note):  # the end was said already
            return
        self._shown, self._last = now, (done, self._note)
        parts = [f"{self._stage}: {done:,}/{self._total:,}", self._rate.text(done), self._rate.left(done, self._total)]
        self._write("  ".join(part for part in [*parts, self._note] if part))

    def message(self, text: str) -> None:
        self._write(text)

    def close(self) -> None:
        self._stage = None

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()


class _Rate:
    # Units a second since this process began the stage, so that what an earlier process did does not count.
    def __init__(self, done: int, unit: str):
        self._first, self._began, self._unit = done, time.monotonic(), unit

    def _is_known(self, done: int) -> bool:
        # What was reported in the first moment may have waited there for long, and would make an impossible speed.
        return done > self._first and time.monotonic() - self._began >= _SECONDS_BEFORE_A_RATE

    def per_second(self, done: int) -> float:
        return (done - self._first) / max(time.monotonic() - self._began, 1e-9)

    def text(self, done: int) -> str:
        return f"{self.per_second(done):,.0f} {self._unit}/s" if self._is_known(done) else ""

    def left(self, done: int, total: int) -> str:
        if done >= total or not self._is_known(done):
            return ""
        seconds = round((total - done) / self.per_second(done))
        return f"{seconds // 60}:{seconds % 60:02d} left"


def default_progress(wanted: bool | ProgressReport) -> ProgressReport:
    """`wanted` itself if it is a report; else a bar on a terminal, lines elsewhere, or nothing if it is False."""
    if not isinstance(wanted, bool):
        return wanted
    if not wanted:
        return Silent()
    console = Console(stderr=True)
    return Bar(console) if console.is_terminal else Lines(sys.stderr)
