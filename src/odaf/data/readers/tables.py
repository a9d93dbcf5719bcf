"""Reader of tables with named columns: CSV and Parquet files, data frames, mappings from names to arrays.

The caller says what each column means; columns that are not named are not read. Names and units of columns go with the
data into the policy.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from odaf.data.log import Log
from odaf.data.readers import row_order, table_cells, table_sources
from odaf.data.readers.row_order import OnGap
from odaf.data.readers.table_cells import OnMissing
from odaf.data.readers.table_meaning import Meaning, Units
from odaf.data.readers.table_sources import Table
from odaf.data.validation import Bounds, RowNumbers
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
    separator: str | None = None,
    decimal_comma: bool = False,
    encoding: str = "utf-8",
    skip_rows: int = 0,
) -> Log:
    """The log in a CSV or Parquet file; which of the two is told from its first bytes and its name.

    Messages number the rows of a CSV file as a spreadsheet does, the headings being row 1, those of a Parquet file
    from 0. A column whose cells hold lists of one length stands for one column a number, `name_0`, `name_1` and so on.

    Args:
        path: the file.
        observations: columns that say what was seen before the action.
        actions: columns that say what was done.
        reward: the column of what the action of the same row earned. A number instead: every row earned that.
        episode: the column of ids, equal for the rows of one episode. A number instead: all rows are one episode.
            None: an episode ends at each row that is terminated or truncated.
        terminated: the column that says where the task ended.
        truncated: the column that says where the recording was cut.
        time: the column of times, as seconds or dates. Rows must stand in time order inside each episode.
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
        on_missing: "error" refuses empty cells and NaN among the numbers; "nan" keeps them as NaN, to be judged later.
        separator: of a CSV file's cells. None finds it.
        decimal_comma: a CSV file writes 1,5 for one and a half.
        encoding: of a CSV file.
        skip_rows: lines in front of a CSV file's headings.

    Raises:
        DatasetError: the file cannot be read, a column is missing, a cell is not what its column should hold, rows are
            out of order, or nothing tells where episodes end.
    """
    path = Path(path)
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
    )
    meaning.check(os.fspath(path))
    if not _is_parquet(path):
        table = table_sources.csv_table(
            path,
            meaning.columns(),
            meaning.numeric(),
            separator=separator,
            decimal_comma=decimal_comma,
            encoding=encoding,
            skip_rows=skip_rows,
            units_in_headings=units == "headings",
        )
        return build(table, meaning)
    if separator is not None or decimal_comma or encoding != "utf-8" or skip_rows:
        raise DatasetError(
            f"{os.fspath(path)}: separator, decimal_comma, encoding and skip_rows apply to CSV files, this is a "
            "Parquet file; leave them out"
        )
    table = table_sources.parquet_table(path)
    return build(table_sources.with_units(table) if units == "headings" else table, meaning)


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
    table = table_sources.frame_table(frame, source)
    return build(table_sources.with_units(table) if meaning.units == "headings" else table, meaning)


def build(table: Table, meaning: Meaning) -> Log:
    """The log in a table.

    Raises:
        DatasetError: as `read`.
    """
    source, names = table.source, meaning.columns()
    table.require(names)
    if table.rows == 0:
        raise DatasetError(f"{source}: has {len(table.names)} columns and no rows; a log needs at least one transition")
    columns: dict[str, np.ndarray] = {}
    if isinstance(meaning.episode, str):
        columns["episode"] = table_cells.as_ids(table.cells(meaning.episode))
    elif meaning.episode is not None:
        columns["episode"] = np.full(table.rows, meaning.episode, np.int64)
    for field, name in (("terminated", meaning.terminated), ("truncated", meaning.truncated)):
        if name is not None:
            columns[field] = table_cells.as_flags(table.cells(name))
    if meaning.time is not None:
        columns["time"] = table_cells.as_times(table.cells(meaning.time), meaning.time_format)
    columns["observations"], observation_names = _side_by_side(table, meaning.observations, meaning.on_missing)
    columns["actions"], action_names = _side_by_side(table, meaning.actions, meaning.on_missing)
    if isinstance(meaning.reward, str):
        columns["rewards"] = table_cells.as_numbers(table.cells(meaning.reward), meaning.on_missing)
    else:
        columns["rewards"] = np.full(table.rows, meaning.reward, np.float32)
    if meaning.next_observations is not None:
        columns["next_observations"], _ = _side_by_side(table, meaning.next_observations, meaning.on_missing)
    infos = {name: table_cells.as_numbers(table.cells(name), meaning.on_missing) for name in meaning.infos}
    infos = {name: array[:, 0] if array.shape[1] == 1 else array for name, array in infos.items()}

    findings: list[dict[str, Any]] = []
    numbers: RowNumbers = table.numbers
    if meaning.sort_by:
        numbers = _sort(table, meaning, columns, infos, findings)
    facts = _order_and_gaps(table, meaning, columns, numbers, findings)
    units = _units(table, meaning)
    for array in columns.values():
        array.setflags(write=False)  # so that the dataset can share them
    return Log(
        columns=columns,
        source=source,
        format=table.format,
        observation_names=tuple(observation_names),
        action_names=tuple(action_names),
        observation_units=tuple(units.get(name, "") for name in observation_names.values()),
        action_units=tuple(units.get(name, "") for name in action_names.values()),
        action_bounds=_bounds(meaning.action_bounds, action_names),
        infos=infos,
        provenance={
            "file": os.path.basename(source),
            "rows_in_file": table.rows,
            "columns": _roles(meaning),
            "columns_not_read": [name for name in table.names if name not in names],
            **table.facts,
            **facts,
        },
        findings=tuple(findings),
        row_numbers=numbers,
    )


def _side_by_side(table: Table, names: Sequence[str], on_missing: OnMissing) -> tuple[np.ndarray, dict[str, str]]:
    """Columns as one matrix, and for each of its own columns: its name, and the table's column that it comes from."""
    parts, origins = [], {}
    for name in names:
        part = table_cells.as_numbers(table.cells(name), on_missing)
        width = part.shape[1]
        own = table.parts.get(name, ())
        if len(own) != width:
            own = [name] if width == 1 else [f"{name}_{index}" for index in range(width)]
        for each in own:
            if each in origins:
                raise DatasetError(f"{table.source}: column '{each}' is named twice; name every column once")
            origins[each] = name
        parts.append(part)
    return (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)), origins


def _sort(
    table: Table,
    meaning: Meaning,
    columns: dict[str, np.ndarray],
    infos: dict[str, np.ndarray],
    findings: list[dict[str, Any]],
) -> np.ndarray:
    """Sorts all columns in place; returns each row's number in the source."""
    known = {meaning.episode: columns.get("episode"), meaning.time: columns.get("time")}
    keys = []
    for name in meaning.sort_by:
        key = known.get(name)
        keys.append(table_cells.as_numbers(table.cells(name))[:, 0] if key is None else key)
    order = row_order.sorted_rows(keys)
    numbers = order + table.row_offset
    moved = int((order != np.arange(len(order))).sum())
    if moved:
        for field in columns:
            columns[field] = columns[field][order]
        for name in infos:
            infos[name] = infos[name][order]
        infos["source_row"] = numbers
        findings.append(
            {
                "finding": "rows-sorted",
                "count": moved,
                "message": f"rows moved when they were sorted by {', '.join(meaning.sort_by)}; their numbers in the "
                "source are in infos['source_row']",
            }
        )
    return numbers


def _order_and_gaps(
    table: Table,
    meaning: Meaning,
    columns: dict[str, np.ndarray],
    numbers: RowNumbers,
    findings: list[dict[str, Any]],
) -> dict[str, Any]:
    """Refuses rows out of order, ends episodes at gaps; returns facts for the provenance."""
    source, episode, time = table.source, columns.get("episode"), columns.get("time")
    flags = [columns[field] for field in ("terminated", "truncated") if field in columns]
    ends = np.logical_or.reduce(flags) if flags else None
    if episode is None and (ends is None or not ends.any()):
        fact = "no end of an episode was given" if ends is None else "no row is marked as the end of an episode"
        raise DatasetError(
            f"{source}: {fact}, so episodes cannot be told apart; the table has {', '.join(table.names[:40])}",
            remedies=[
                "name the column of ids with episode=",
                "a column of end flags with terminated= or truncated=",
                "pass episode=0 if all rows are one episode",
            ],
        )
    by_time = [name for name in (meaning.episode, meaning.time) if isinstance(name, str)]
    if isinstance(meaning.episode, str) and episode is not None:
        remedy = f"pass sort_by={by_time}" + ("" if meaning.time else " with the column of the time in the end")
        row_order.refuse_scattered(source, meaning.episode, episode, numbers, [remedy, "use unique ids"])
    if meaning.time is None or time is None:
        return {}
    remedies = ["remove rows that were logged twice", "name the column that tells episodes apart with episode="]
    if not meaning.sort_by:
        remedies.insert(0, f"pass sort_by={by_time} to sort the rows")
    first = row_order.first_rows(episode, ends, table.rows)
    clock = row_order.read_clock(
        source,
        meaning.time,
        time,
        first,
        numbers,
        time_step=meaning.time_step,
        on_gap=meaning.on_gap,
        remedies=remedies,
    )
    findings.extend(clock.findings)
    if clock.gaps.any():
        terminated = columns.get("terminated", np.zeros(table.rows, bool))
        columns["truncated"] = columns.get("truncated", np.zeros(table.rows, bool)) | (clock.gaps & ~terminated)
        if episode is not None:
            columns["episode"] = np.cumsum(first | np.append(False, clock.gaps[:-1])) - 1
    return {} if clock.time_step is None else {"time_step": clock.time_step}


def _units(table: Table, meaning: Meaning) -> Mapping[str, str]:
    """The unit of each column that has one."""
    if meaning.units is None:
        return {}
    if isinstance(meaning.units, str):
        return table.units
    table_sources.require(f"{table.source}: units", table.names, meaning.units)
    return meaning.units


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


def _is_parquet(path: Path) -> bool:
    if path.suffix.lower() in (".parquet", ".pq"):
        return True
    if not path.is_file():
        return False
    with table_sources.reading(os.fspath(path)), path.open("rb") as file:
        return file.read(4) == b"PAR1"
