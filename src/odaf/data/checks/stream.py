"""How checks see a log: block by block, each with the row before it, so that memory does not grow with the log."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from odaf.data import validation
from odaf.data.checks.findings import SHOWN_ROWS, Finding
from odaf.data.log import Log

FLAGS = ("terminated", "truncated")


@dataclass(frozen=True)
class Facts:
    """What is known of a log before its rows are read.

    Attributes:
        log: the log.
        rows: its number of rows.
        fields: columns whose type, rank and length allow their rows to be judged.
        obs_dim: observation columns.
        act_dim: action columns; 0 where the actions cannot be judged.
        action_names: one per action column.
        low: [act_dim] lowest action, or None where no bounds are known.
        high: [act_dim] highest action.
    """

    log: Log
    rows: int
    fields: frozenset[str]
    obs_dim: int
    act_dim: int
    action_names: tuple[str, ...]
    low: np.ndarray | None = None
    high: np.ndarray | None = None


@dataclass(frozen=True)
class Block:
    """Consecutive rows and the one before them.

    Attributes:
        first: number of the first row, counted from 0.
        columns: by field, the block's rows: matrices [rows, dimensions], vectors [rows]; flags are bool.
        raw: by field, the block's rows as the source holds them.
        before: by field, the row before the block with a leading axis of one; empty for the first block.
        starts: [rows] whether the row is the first of its episode.
    """

    first: int
    columns: dict[str, np.ndarray]
    raw: dict[str, np.ndarray]
    before: dict[str, np.ndarray]
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts)

    def with_before(self, name: str) -> np.ndarray:
        """A column with the row before the block in front, where there is one: entry i + `lead` is row i."""
        column = self.columns[name]
        return np.concatenate([self.before[name], column]) if self.before else column

    def pieces(self, rows: int) -> Iterator["Block"]:
        """The same rows as smaller blocks, for checks whose temporary copies are larger than the rows."""
        for start in range(0, len(self), rows):
            stop = start + rows
            columns = {name: values[start:stop] for name, values in self.columns.items()}
            before = self.before
            if start:
                before = {name: values[start - 1 : start] for name, values in self.columns.items()}
            raw = {name: values[start:stop] for name, values in self.raw.items()}
            yield Block(self.first + start, columns, raw, before, self.starts[start:stop])

    def pairs(self) -> tuple[np.ndarray, int]:
        """(whether row i goes on from row i - 1, number of the first such i) for every row that has one before it."""
        lead = 0 if self.before else 1
        return ~self.starts[lead:], self.first + lead


@runtime_checkable
class Check(Protocol):
    """Sees every block once, in order; says afterwards what it found."""

    def see(self, block: Block) -> None: ...

    def findings(self) -> list[Finding]: ...


@dataclass
class Tally:
    """How often something was seen, and the first rows where, counted from 0."""

    count: int = 0
    rows: list[int] = field(default_factory=list)

    def add(self, mask: np.ndarray, first: int, count: int | None = None) -> None:
        """Counts the rows marked in `mask`, whose first entry is row `first`; or `count`, if that is something else."""
        marked = int(np.count_nonzero(mask))
        self.count += marked if count is None else count
        if marked and len(self.rows) < SHOWN_ROWS:
            found = np.flatnonzero(mask)[: SHOWN_ROWS - len(self.rows)]
            self.rows += [int(row) + first for row in found]

    def row(self, number: int) -> None:
        """Counts one row by its number from 0."""
        self.add(np.ones(1, bool), number)


def blocks(facts: Facts, rows: int) -> Iterator[Block]:
    """The log's usable columns, block by block."""
    before: dict[str, np.ndarray] = {}
    for first in range(0, facts.rows, rows):
        raw = {name: np.asarray(facts.log.columns[name][first : first + rows]) for name in sorted(facts.fields)}
        columns = {name: _tidy(name, values) for name, values in raw.items()}
        yield Block(first, columns, raw, before, _starts(columns, before))
        before = {name: values[-1:].copy() for name, values in columns.items()}


def _tidy(name: str, values: np.ndarray) -> np.ndarray:
    if name in ("rewards", "time", "episode", *FLAGS) and values.ndim == 2:
        values = values[:, 0]
    if name in FLAGS and values.dtype != bool:
        return values.astype(np.float64) == 1.0
    if name == "time":
        return _seconds(values)
    return values


def _seconds(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind == "M":
        return values.astype("datetime64[us]").astype(np.int64) / 1e6
    return values


def _starts(columns: dict[str, np.ndarray], before: dict[str, np.ndarray]) -> np.ndarray:
    rows = len(next(iter(columns.values())))
    starts = np.zeros(rows, bool)
    starts[0] = not before
    if "episode" in columns:
        ids = columns["episode"]
        starts[1:] = ids[1:] != ids[:-1]
        if before:
            starts[0] = bool(ids[0] != before["episode"][0])
        return starts
    for name in FLAGS:
        if name in columns:
            starts[1:] |= columns[name][:-1]
            if before:
                starts[0] |= before[name][0]
    return starts


def any_column(mask: np.ndarray) -> np.ndarray:
    """[rows] bool of a mask [rows] or [rows, columns]."""
    return validation.any_in_row(mask)
