"""The columns of a log from the cells of a table: what a learner sees, what orders the rows, what is kept beside."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from odaf.data.derived import Derivation
from odaf.data.expressions import Expression
from odaf.data.readers import table_keys, table_numbers
from odaf.data.readers.table_cells import Cells, Holes, OnMissing
from odaf.data.readers.table_meaning import Meaning, Roles
from odaf.data.readers.table_sources import Table
from odaf.data.validation import RowNumbers, any_in_row, name_rows
from odaf.errors import DatasetError


@dataclass
class TableRows:
    """Columns on their way into a log; what orders, leaves out or cuts rows changes them in place.

    Attributes:
        columns: by field of `Log`.
        infos: further columns by name.
        numbers: [rows] the rows' numbers in the source.
        holes: which rows miss a value that a learner needs.
        observation_names: by name of each column of the observations, the table's column it comes from.
        action_names: the same for the actions.
        findings: in the form of `Dataset.provenance["findings"]`.
    """

    columns: dict[str, np.ndarray]
    infos: dict[str, np.ndarray]
    numbers: RowNumbers
    holes: Holes
    observation_names: dict[str, str]
    action_names: dict[str, str]
    findings: list[dict[str, Any]]

    def __len__(self) -> int:
        return len(self.columns["observations"])

    def take(self, chosen: np.ndarray) -> None:
        """Keeps these rows, in this order.

        Args:
            chosen: [rows] bool, or numbers of rows.
        """
        for fields in (self.columns, self.infos):
            for name in fields:
                fields[name] = fields[name][chosen]
        self.numbers = np.asarray(self.numbers)[chosen]
        for name, missing in self.holes.by_column.items():
            self.holes.by_column[name] = missing[chosen]
        self.holes.rows = len(self.numbers)


def gather(table: Table, meaning: Meaning, roles: Roles) -> tuple[TableRows, Derivation]:
    """All columns that the meaning names, in the order of the table's rows; and how observations were computed.

    Raises:
        DatasetError: a cell is not what its column should hold.
    """
    holes = Holes(table.rows)
    noted = holes if meaning.on_missing == "break" else None
    columns: dict[str, np.ndarray] = {}
    if isinstance(meaning.episode, str):
        columns["episode"] = table_keys.as_ids(table.cells(meaning.episode), noted)
    elif meaning.episode is not None:
        columns["episode"] = np.full(table.rows, meaning.episode, np.int64)
    for field, name in (("terminated", meaning.terminated), ("truncated", meaning.truncated)):
        if name is not None:
            columns[field] = table_numbers.as_flags(table.cells(name), noted)
    if meaning.time is not None:
        columns["time"] = table_keys.as_times(table.cells(meaning.time), meaning.time_format, noted)
    readings = {name: table_numbers.as_doubles(table.cells(name), meaning.on_missing) for name in roles.computed}
    columns["observations"], observation_names, parts = _observations(table, meaning, roles, readings, holes)
    columns["actions"], action_names = _side_by_side(table, meaning.actions, meaning.on_missing, holes)
    columns["rewards"] = _reward(table, roles, meaning.on_missing, readings, holes)
    if meaning.next_observations is not None:
        columns["next_observations"], _ = _side_by_side(table, meaning.next_observations, meaning.on_missing, holes)
    infos = {name: table_numbers.as_info(table.cells(name), meaning.on_missing) for name in meaning.infos}
    rows = TableRows(columns, infos, table.row_numbers, holes, observation_names, action_names, [])
    if meaning.on_missing != "break":
        holes.by_column.clear()
    derivation = Derivation(parts, meaning.differences, meaning.lags, tuple(action_names))
    return rows, derivation


def _observations(
    table: Table, meaning: Meaning, roles: Roles, readings: dict[str, np.ndarray], holes: Holes
) -> tuple[np.ndarray, dict[str, str], tuple[tuple[str, Expression | None], ...]]:
    """Readings and formulas side by side; the origin of each; and the parts, one for each number of a list."""
    known = dict(readings)
    parts, origins = [], {}
    derived: list[tuple[str, Expression | None]] = []
    for name, formula in roles.parts:
        if formula is None:
            matrix, own = _side_by_side(table, [name], meaning.on_missing, holes)
            derived += [(each, None) for each in own]
        else:
            known[name] = _of_formula(table, name, formula, known, meaning.on_missing, holes)
            matrix = known[name].astype(np.float32)[:, None]
            own = {name: name}
            derived.append((name, formula))
        for each in own:
            _once(table.source, each, origins)
        origins |= own
        parts.append(matrix)
    return (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)), origins, tuple(derived)


def _reward(
    table: Table, roles: Roles, on_missing: OnMissing, readings: dict[str, np.ndarray], holes: Holes
) -> np.ndarray:
    """[rows] or [rows, 1] float32."""
    if isinstance(roles.reward, str):
        return _side_by_side(table, [roles.reward], on_missing, holes)[0]
    if isinstance(roles.reward, Expression):
        return _of_formula(table, "reward", roles.reward, readings, on_missing, holes).astype(np.float32)
    return np.full(table.rows, roles.reward, np.float32)


def _of_formula(
    table: Table, name: str, formula: Expression, readings: dict[str, np.ndarray], on_missing: OnMissing, holes: Holes
) -> np.ndarray:
    """[rows] float64; what cannot be computed, such as 0/0, is missing."""
    values = formula(readings)
    title = f"{name} = {formula.text}"
    if np.isinf(values).any():
        row = int(np.flatnonzero(np.isinf(values))[0])
        shown = ", ".join(f"{column} {readings[column][row]:.6g}" for column in formula.columns[:5])
        raise DatasetError(
            f"{table.source}: expression '{title}' is infinite in {name_rows(np.isinf(values), table.row_numbers)} "
            f"({shown}); guard it, as with greatest(x, 0.001) under a fraction"
        )
    cells = Cells(table.source, title, pl.Series(values), table.row_numbers)
    single = table_numbers.as_numbers(cells, on_missing)[:, 0]
    holes.mark(name, np.isnan(single))
    return values


def _side_by_side(
    table: Table, names: Sequence[str], on_missing: OnMissing, holes: Holes
) -> tuple[np.ndarray, dict[str, str]]:
    """Columns as one matrix, and for each of its own columns: its name, and the table's column that it comes from."""
    parts, origins = [], {}
    for name in names:
        part = table_numbers.as_numbers(table.cells(name), on_missing)
        holes.mark(name, any_in_row(np.isnan(part)))
        width = part.shape[1]
        own = table.parts.get(name, ())
        if len(own) != width:
            own = [name] if width == 1 else [f"{name}_{index}" for index in range(width)]
        for each in own:
            _once(table.source, each, origins)
            origins[each] = name
        parts.append(part)
    return (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)), origins


def _once(source: str, name: str, known: dict[str, str]) -> None:
    if name in known:
        raise DatasetError(f"{source}: column '{name}' is named twice; name every column once")
