"""A study of works that take no time, for the tests of what surrounds them; importable by worker processes."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies.job import Job, Log, Phase, Record, Study, Work

if TYPE_CHECKING:
    from odaf.training.progress import ProgressReport


@dataclass(frozen=True)
class Count(Work):
    """Writes its name, and when it was written, into the work directory."""

    name: str
    version: int = 1
    seconds: float = 0.0
    claims: float = 0.0
    rate: float = 1.0
    source: Log | None = None
    kind: str = "plain"
    ends: bool = True

    @property
    def log(self) -> Log | None:
        return self.source

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"kind": (self.kind,), "name": (self.name,)}

    def identity(self) -> dict[str, Any]:
        return {"version": self.version, "rate": self.rate}

    def guess(self) -> float:
        return self.claims

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        progress.start("counting", 1)
        if self.source is not None:
            self.source.present(place)
        time.sleep(self.seconds)
        with (place / "order.txt").open("a") as file:
            file.write(f"{self.name}\n")
        return {"name": self.name, "identity": self.identity(), "seconds": self.seconds, "process": os.getpid()}


def job(name: str, *after: str, **fields: Any) -> Job:
    return Job(name, Count(name, **fields), after)


def study(*phases: Sequence[Job]) -> Study:
    parts = [Phase(f"part {number}", tuple(jobs)) for number, jobs in enumerate(phases, start=1)]
    return Study("toy", "what a toy does", lambda: parts, {"table.md": lambda records: "".join(map(_line, records))})


def _line(record: Record) -> str:
    return f"{record['name']}\n"
