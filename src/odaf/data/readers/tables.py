"""Reader of tables with named columns: CSV and Parquet files, data frames, mappings from names to arrays.

The caller says what each column means; columns that are not named are not read. Names and units of columns go with the
data into the policy.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from odaf.data.expressions import Expression
from odaf.data.log import Log
from odaf.data.readers import (
    table_columns,
    table_csv,
    table_files,
    table_folder,
    table_frames,
    table_rows,
    table_sources,
)
from odaf.data.readers.row_order import OnGap
from odaf.data.readers.table_cells import OnMissing
from odaf.data.readers.table_columns import TableRows
from odaf.data.readers.table_csv import Dialect
from odaf.data.readers.table_files import Kind
from odaf.data.readers.table_meaning import Meaning, Units
from odaf.data.readers.table_sources import Table
from odaf.data.validation import Bounds
from odaf.errors import DatasetError


def read(
    path: str | os.PathLike[str],
    *,
    observations: Sequence[str],
    actions: Sequence[str],
    reward: str | float,
    episode: str | int | None = None,
    terminated: str | None = None,
    truncated: str | None = None,
    time: str | None = None,
    next_observations: Sequence[str] | None = None,
    infos: Sequence[str] = (),
    action_bounds: Bounds | None = None,
    units: Units | None = None,
    time_step: float | None = None,
    time_format: str | None = None,
    sort_by: Sequence[str] = (),
    on_gap: OnGap = "break",
    on_missing: OnMissing = "error",
    missing_values: Sequence[str] = (),
    lags: int = 0,
    differences: bool = False,
    separator: str | None = None,
    decimal_comma: bool = False,
    encoding: str = "utf-8",
    skip_rows: int = 0,
    units_row: bool = False,
) -> Log:
    """The log in a CSV or Parquet file, or in a folder of either; which of the two is told from first bytes and name.

    Messages number the rows of a CSV file as a spreadsheet does, the headings being row 1, those of a Parquet file
    from 0. A column whose cells hold lists of one length stands for one column a number, `name_0`, `name_1` and so on.

    The files of a folder count as one table, in the order of their names, the second before the tenth; what other
    programs leave beside them (`_SUCCESS`, `.DS_Store`, checksums) is passed over. Their rows are numbered from 0
    through all files, and a further column, `file`, says which one each lies in, as for `episode="file"`.

    Args:
        path: the file or folder.
        observations: columns that say what was seen before the action. An entry such as `level_error = level -
            setpoint` is computed (`odaf.data.expressions`).
        actions: columns that say what was done.
        reward: the column of what the action of the same row earned, or a formula such as `1 - abs(level - setpoint)`.
            A number instead: every row earned that.
        episode: the column of ids, equal for the rows of one episode. A number instead: all rows are one episode.
            None: an episode ends at each row that is terminated or truncated.
        terminated: the column that says where the task ended.
        truncated: the column that says where the recording was cut.
        time: the column of times, as seconds or dates. TableRows must stand in time order inside each episode.
        next_observations: columns that say what was seen after the action, in the order of `observations`. None takes
            the observations of the next row of the episode.
        infos: further columns of numbers to keep beside the rows.
        action_bounds: {column: (low, high)}, or (low, high). None takes the smallest and largest logged action.
        units: {column: unit}, or "headings" to part headings such as `level [m]` into name and unit.
        time_step: the usual time between rows. None takes the median of each episode.
        time_format: how dates are written where it is not ISO 8601, such as "%d.%m.%Y %H:%M:%S".
        sort_by: sort the rows by these columns first, such as the episode's and the time's.
        on_gap: where the time to the next row is more than 1.5 usual steps, rows are missing. "break" ends the episode
            there, and its last row has no successor unless one was logged; "error" refuses the log.
        on_missing: "error" refuses empty cells and NaN; "break" leaves out each row that misses a value which is needed
            and cuts its episode there, so that no row is followed by one that came later; "nan" keeps empty cells among
            numbers as NaN, to be judged later.
        missing_values: what else stands for a missing value, such as "Bad", "No Data" or "-9999", in any case.
        lags: so many earlier rows of the episode are seen too, as `level_lag1`, their actions included. The first rows
            of each episode have no such history and are left out.
        differences: the change of each observation since the row before is seen too, as `level_change`. The first row
            of each episode is left out.
        separator: of a CSV file's cells. None finds it.
        decimal_comma: a CSV file writes 1,5 for one and a half.
        encoding: of a CSV file.
        skip_rows: lines in front of a CSV file's headings. Empty lines and Excel's `sep=;` need not be counted.
        units_row: the row under a CSV file's headings holds units.

    Raises:
        DatasetError: the file cannot be read, a column is missing, a cell is not what its column should hold, rows are
            out of order, or nothing tells where episodes end.
    """
    path = Path(path)
    source = os.fspath(path)
    meaning = Meaning(
        observations=observations,
        actions=actions,
        reward=reward,
        episode=episode,
        terminated=terminated,
        truncated=truncated,
        time=time,
        next_observations=next_observations,
        infos=infos,
        action_bounds=action_bounds,
        units=units,
        time_step=time_step,
        time_format=time_format,
        sort_by=sort_by,
        on_gap=on_gap,
        on_missing=on_missing,
        missing_values=missing_values,
        lags=lags,
        differences=differences,
    )
    meaning.check(source)
    dialect = Dialect(separator, decimal_comma, encoding, skip_rows, units_row)
    if path.is_dir():
        kind, files = table_files.table_files(path) or ("csv", [])
        if not files:
            raise DatasetError(f"{source}: is a folder without CSV or Parquet files; name a file or another folder")
        _refuse_dialect(source, kind, dialect)
        return build(table_folder.joined(path, files, lambda file: _table(file, kind, meaning, dialect, True)), meaning)
    kind = "parquet" if _is_parquet(path) else "csv"
    _refuse_dialect(source, kind, dialect)
    return build(_table(path, kind, meaning, dialect, False), meaning)


def from_frame(
    frame: Any,
    *,
    observations: Sequence[str],
    actions: Sequence[str],
    reward: str | float,
    source: str = "frame",
    **options: Any,
) -> Log:
    """The log in a polars or pandas frame, or in a mapping from names to arrays; rows are numbered from 0.

    Args:
        frame: the table. An array with two dimensions holds one list a row.
        observations: as in `read`.
        actions: as in `read`.
        reward: as in `read`.
        source: how messages name the table.
        options: as in `read`, except those that concern CSV files.

    Raises:
        DatasetError: as `read`.
    """
    try:
        meaning = Meaning(observations=observations, actions=actions, reward=reward, **options)
    except TypeError as error:
        known = ", ".join(name for name in Meaning.__dataclass_fields__ if name not in ("observations", "actions"))
        raise DatasetError(f"{source}: unknown among the options {sorted(options)}; a frame takes {known}") from error
    meaning.check(source)
    table = table_frames.frame_table(frame, source, meaning.missing_values)
    return build(table_sources.with_units(table) if meaning.units == "headings" else table, meaning)


def build(table: Table, meaning: Meaning) -> Log:
    """The log in a table.

    Raises:
        DatasetError: as `read`.
    """
    source = table.source
    roles = meaning.roles(source, table.names)
    if table.rows == 0:
        raise DatasetError(f"{source}: has {len(table.names)} columns and no rows; a log needs at least one transition")
    rows, derivation = table_columns.gather(table, meaning, roles)
    if meaning.sort_by:
        table_rows.sort(table, meaning, rows)
    facts = table_rows.order(table, meaning, rows)
    if derivation.history:
        table_rows.add_history(source, derivation, rows)
    recipes = derivation.recipes() if derivation.derives else []
    if isinstance(roles.reward, Expression):
        recipes.append({"recipe": "reward", "expression": roles.reward.text})
    units = _units(table, meaning, rows)
    for array in rows.columns.values():
        array.setflags(write=False)  # so that the dataset can share them
    return Log(
        columns=rows.columns,
        source=source,
        format=table.format,
        observation_names=tuple(rows.observation_names),
        action_names=tuple(rows.action_names),
        observation_units=tuple(units.get(name, "") for name in rows.observation_names.values()),
        action_units=tuple(units.get(name, "") for name in rows.action_names.values()),
        action_bounds=_bounds(meaning.action_bounds, rows.action_names),
        infos=rows.infos,
        provenance={
            "file": os.path.basename(source),
            "rows_in_file": table.rows,
            "columns": _roles(meaning),
            "columns_not_read": [name for name in table.names if name not in roles.columns],
            **({"derived": recipes} if recipes else {}),
            **table.facts,
            **facts,
        },
        findings=tuple(rows.findings),
        row_numbers=rows.numbers,
    )


def _units(table: Table, meaning: Meaning, rows: TableRows) -> Mapping[str, str]:
    """The unit of each column that has one; those of differences and earlier rows are those of their columns."""
    units = dict(table.units)
    if isinstance(meaning.units, Mapping):
        names = list(dict.fromkeys([*table.names, *rows.observation_names]))
        table_sources.require(f"{table.source}: units", names, meaning.units)
        units |= meaning.units
    for name in rows.observation_names:
        stem = re.sub(r"_(change|lag\d+)$", "", name)
        if name not in units and name not in table.names and stem in units:
            units[name] = units[stem]
    return units


def _bounds(bounds: Bounds | None, action_names: Mapping[str, str]) -> Bounds | None:
    """The bounds by action; those of a column of lists hold for each of its numbers."""
    if not isinstance(bounds, Mapping):
        return bounds
    own = {name: bounds[origin] for name, origin in action_names.items() if name not in bounds and origin in bounds}
    expanded = {origin for name, origin in action_names.items() if name != origin}
    return {**{name: pair for name, pair in bounds.items() if name not in expanded}, **own}


def _roles(meaning: Meaning) -> dict[str, Any]:
    """What each named column stands for, as JSON."""
    fields = ("observations", "actions", "reward", "episode", "terminated", "truncated", "time", "next_observations")
    given = {field: getattr(meaning, field) for field in fields if getattr(meaning, field) is not None}
    return {field: value if isinstance(value, (str, int, float)) else list(value) for field, value in given.items()}


def _refuse_dialect(source: str, kind: Kind, dialect: Dialect) -> None:
    if kind == "parquet" and dialect != Dialect():
        raise DatasetError(
            f"{source}: separator=, decimal_comma=, encoding=, skip_rows= and units_row= apply to CSV files, this is a "
            "Parquet file; leave them out"
        )


def _table(path: Path, kind: Kind, meaning: Meaning, dialect: Dialect, in_folder: bool) -> Table:
    """The table in one file; of those in a folder, the column `file` comes from elsewhere."""
    source = os.fspath(path)
    in_headings = meaning.units == "headings"

    def resolve(names: tuple[str, ...]) -> tuple[Sequence[str], Sequence[str]]:
        further = (table_folder.FILE,) if in_folder and table_folder.FILE not in names else ()
        roles = meaning.roles(source, (*names, *further))
        return [name for name in roles.columns if name not in further], roles.direct

    if kind == "csv":
        table = table_csv.csv_table(path, meaning.hints(), resolve, dialect, units_in_headings=in_headings)
    else:
        table = table_sources.parquet_table(path)
        table = table_sources.with_units(table) if in_headings else table
        resolve(table.names)
    return replace(table, missing_values=tuple(meaning.missing_values))


def _is_parquet(path: Path) -> bool:
    if path.suffix.lower() in (".parquet", ".pq"):
        return True
    if not path.is_file():
        return False
    with table_sources.reading(os.fspath(path)), path.open("rb") as file:
        return file.read(4) == b"PAR1"
