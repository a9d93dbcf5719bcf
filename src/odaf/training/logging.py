"""Where metrics go while a run trains: one small protocol, and JSON lines as its default."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from odaf.data.writing import sync_file, write_atomically
from odaf.errors import CheckpointError
from odaf.training.files import finite


@runtime_checkable
class Logger(Protocol):
    """Receives one flat record of numbers at a time. A tracker is adapted by writing these three methods."""

    def open(self, directory: Path, step: int) -> None:
        """Called once a seed, before training goes on from `step`; what was logged after `step` is void."""
        ...

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        """Takes the metrics of one stretch or one evaluation, named `room/quantity`."""
        ...

    def close(self) -> None:
        """Called once a seed, also after an error."""
        ...


class JsonLines:
    """Appends every record to `metrics.jsonl` in the seed's directory; numbers that are not finite become null."""

    def __init__(self):
        self._file = None

    def open(self, directory: Path, step: int) -> None:
        path = directory / "metrics.jsonl"
        truncate(path, step)
        self._file = path.open("ab")

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        assert self._file is not None, "log was called before open"
        line = json.dumps({"step": step, **finite(dict(metrics))}, allow_nan=False) + "\n"
        self._file.write(line.encode())
        self._file.flush()

    def sync(self) -> None:
        """Hands all lines to the disk; a checkpoint must never be newer than the lines that lead to it."""
        if self._file is not None:
            sync_file(self._file)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def read(path: Path) -> list[dict[str, Any]]:
    """All complete records of a `metrics.jsonl`, in order; a last line torn by a kill is left out.

    Raises:
        CheckpointError: a line before the last is not a JSON object with a step.
    """
    return [record for _, record in _records(path)]


def truncate(path: Path, step: int) -> None:
    """Removes a torn last line and every record later than `step`. Touches nothing when there are none."""
    if not path.exists():
        return
    kept = b"".join(line for line, record in _records(path) if record["step"] <= step)
    if len(kept) != os.path.getsize(path):
        write_atomically(path, lambda file: file.write(kept))


def _records(path: Path) -> list[tuple[bytes, dict[str, Any]]]:
    if not path.exists():
        return []
    lines = path.read_bytes().splitlines(keepends=True)
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            record = json.loads(line) if line.endswith(b"\n") else None
            int(record["step"])  # type: ignore[index]
        except (ValueError, TypeError, KeyError):
            if number == len(lines):
                break
            raise CheckpointError(
                f"{path}, line {number}: expected a JSON object with a step, found {line[:60]!r}. "
                "Remove that line, or the whole file, to go on without it."
            ) from None
        records.append((line, record))
    return records
