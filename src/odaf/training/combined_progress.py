"""The progress of many seeds, each trained in a process of its own, as one line."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from odaf.training.progress import ProgressReport
from odaf.training.seeds import TRAINING

_SECONDS_BETWEEN_NEWS = 0.2


class SeedReport:
    """Tells how far one seed has come to whoever combines the reports; a `ProgressReport`.

    Args:
        seed: whose progress it is; a number that no other has.
        send: takes (seed, event, text, updates done).
        name: put before what is said, where "seed 3" would not tell whose it is.
    """

    def __init__(self, seed: int, send: Callable[[tuple[int, str, str, int]], Any], name: str = ""):
        self._seed, self._send, self._counts, self._total, self._told = seed, send, False, 0, 0.0
        self._prefix = f"{name}: " if name else ""

    def start(self, stage: str, total: int, done: int = 0, unit: str = "updates") -> None:
        self._counts, self._total = stage.endswith(TRAINING), total
        if self._counts:
            self._send((self._seed, "updates", "", done))
        else:
            self._send((self._seed, "stage", self._prefix + stage, 0))

    def advance(self, done: int, note: str = "") -> None:
        if not self._counts:
            return
        now = time.monotonic()
        if note or done >= self._total or now - self._told >= _SECONDS_BETWEEN_NEWS:
            self._told = now
            self._send((self._seed, "updates", note, done))

    def message(self, text: str) -> None:
        self._send((self._seed, "message", self._prefix + text, 0))

    def close(self) -> None: ...


class CombinedProgress:
    """Shows the sum of all seeds' updates, and beside it the latest news of any of them.

    Args:
        done: for each seed that is trained, the updates it has made already.
        steps: updates for each seed.
        report: where the line is shown.
        who: what the line calls them; without it, the numbers of the seeds.
    """

    def __init__(self, done: Mapping[int, int], steps: int, report: ProgressReport, who: str = ""):
        self._report, self._steps, self._done, self._who = report, steps, dict(done), who
        names = " ".join(map(str, done)) if len(done) <= 8 else f"{len(done)} in all"
        report.start(f"{who or f'seeds {names}'}: training", steps * len(done), sum(done.values()))

    def receive(self, news: tuple[int, str, str, int]) -> None:
        """Takes what a `SeedReport` told."""
        seed, event, text, done = news
        if event == "message":
            self._report.message(text)
        elif event == "stage":
            self._report.advance(sum(self._done.values()), text)
        else:
            self._done[seed] = done
            self._report.advance(sum(self._done.values()), text if self._who or not text else f"seed {seed}: {text}")

    def finish(self, seed: int) -> None:
        """Says that a seed has made all its updates."""
        self._done[seed] = self._steps
        self._report.advance(sum(self._done.values()))
