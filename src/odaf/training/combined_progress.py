"""The progress of many seeds, each trained in a process of its own, as one line."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from odaf.training.progress import ProgressReport
from odaf.training.seeds import training_stage

_SECONDS_BETWEEN_NEWS = 0.2


class SeedReport:
    """Tells how far one seed has come to whoever combines the reports; a `ProgressReport`.

    Args:
        seed: whose progress it is.
        send: takes (seed, event, text, updates done).
    """

    def __init__(self, seed: int, send: Callable[[tuple[int, str, str, int]], Any]):
        self._seed, self._send, self._counts, self._total, self._told = seed, send, False, 0, 0.0

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        self._counts, self._total = stage == training_stage(self._seed), total
        if self._counts:
            self._send((self._seed, "updates", "", done))
        else:
            self._send((self._seed, "stage", stage, 0))

    def advance(self, done: int, note: str = "") -> None:
        if not self._counts:
            return
        now = time.monotonic()
        if note or done >= self._total or now - self._told >= _SECONDS_BETWEEN_NEWS:
            self._told = now
            self._send((self._seed, "updates", note, done))

    def message(self, text: str) -> None:
        self._send((self._seed, "message", text, 0))

    def close(self) -> None: ...


class CombinedProgress:
    """Shows the sum of all seeds' updates, and beside it the latest news of any of them.

    Args:
        done: for each seed that is trained, the updates it has made already.
        steps: updates for each seed.
        report: where the line is shown.
    """

    def __init__(self, done: Mapping[int, int], steps: int, report: ProgressReport):
        self._report, self._steps, self._done = report, steps, dict(done)
        names = " ".join(map(str, done)) if len(done) <= 8 else f"{len(done)} in all"
        report.start(f"seeds {names}: training", steps * len(done), sum(done.values()))

    def receive(self, news: tuple[int, str, str, int]) -> None:
        """Takes what a `SeedReport` told."""
        seed, event, text, done = news
        if event == "message":
            self._report.message(text)
        elif event == "stage":
            self._report.advance(sum(self._done.values()), text)
        else:
            self._done[seed] = done
            self._report.advance(sum(self._done.values()), f"seed {seed}: {text}" if text else "")

    def finish(self, seed: int) -> None:
        """Says that a seed has made all its updates."""
        self._done[seed] = self._steps
        self._report.advance(sum(self._done.values()))
