"""Where metrics go while a run trains: one small protocol, and JSON lines as its default."""

import json
import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

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
    """Appends every record to `metrics.jsonl` in the seed's directory; numbers that are not finite become null.

    Args:
        due: steps whose evaluation, if there is a line of it, does not count and will be repeated.
    """

    def __init__(self, due: Collection[int] = ()):
        self._file, self._due = None, due

    def open(self, directory: Path, step: int) -> None:
        self._path, self._last, self._ordered = directory / "metrics.jsonl", step, True
        truncate(self._path, step, self._due)
        self._file = self._path.open("ab")

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        assert self._file is not None, "log was called before open"
        self._ordered, self._last = self._ordered and step >= self._last, max(step, self._last)
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
            if not self._ordered:  # an evaluation was done when training was further already
                _put_in_order(self._path)


def read(path: Path) -> list[dict[str, Any]]:
    """All complete records of a `metrics.jsonl`, in order; a last line torn by a kill is left out.

    Raises:
        CheckpointError: a line before the last is not a JSON object with a step.
    """
    return [record for _, record in _records(path)]


def truncate(path: Path, step: int, due: Collection[int] = ()) -> None:
    """Removes a torn last line and every record later than `step`. Touches nothing when there are none.

    Args:
        path: the file.
        step: the last that counts.
        due: steps whose evaluation is removed, because it does not count yet.
    """
    if not path.exists():
        return

    def counts(record: Mapping[str, Any]) -> bool:
        if record["step"] in due:
            return record["step"] <= step and not any(name.startswith("evaluation/") for name in record)
        return record["step"] <= step

    kept = b"".join(line for line, record in _records(path) if counts(record))
    if len(kept) != os.path.getsize(path):
        write_atomically(path, lambda file: file.write(kept))


def _put_in_order(path: Path) -> None:
    """Sorts the records by step; those of one step keep their order."""
    lines = [line for line, _ in sorted(_records(path), key=lambda entry: entry[1]["step"])]
    write_atomically(path, lambda file: file.write(b"".join(lines)))


@dataclass(frozen=True)
class Series:
    """One logged quantity of one seed: `values[i]` was measured after `steps[i]` updates; both have shape [points]."""

    steps: np.ndarray
    values: np.ndarray


def series(records: Sequence[Mapping[str, Any]]) -> dict[str, Series]:
    """Quantities by name, NaN where a value is no number. Of two records of one step the later holds."""
    points: dict[str, dict[int, float]] = {}
    for record in records:
        for name, value in record.items():
            if name != "step" and (value is None or isinstance(value, int | float)):
                number = math.nan if value is None or isinstance(value, bool) else float(value)
                points.setdefault(name, {})[int(record["step"])] = number
    found = {}
    for name, values in points.items():
        steps = sorted(values)
        found[name] = Series(np.asarray(steps, np.int64), np.asarray([values[step] for step in steps], np.float64))
    return found


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
