"""The rows of a table put in order: sorted, left out where cells are missing, cut where rows are, seen with history."""

from typing import Any

import numpy as np

from odaf.data.derived import Derivation
from odaf.data.readers import row_order, table_keys
from odaf.data.readers.table_cells import Cells
from odaf.data.readers.table_columns import TableRows
from odaf.data.readers.table_meaning import Meaning
from odaf.data.readers.table_sources import Table
from odaf.data.validation import name_rows
from odaf.errors import DatasetError


def sort(table: Table, meaning: Meaning, rows: TableRows) -> None:
    """Sorts the rows by the columns that the meaning names; their numbers in the source go into the infos."""
    keys = []
    for name in meaning.sort_by:
        if name == meaning.episode and not rows.holes.by_column.get(name, np.zeros(1)).any():
            keys.append(rows.columns["episode"])
        else:
            cells: Cells = table.cells(name)
            keys.append(table_keys.as_sort_key(cells, meaning.time_format if name == meaning.time else None))
    order = row_order.sorted_rows(keys)
    moved = int((order != np.arange(len(order))).sum())
    if moved:
        rows.take(order)
        rows.infos["source_row"] = np.asarray(rows.numbers)
        rows.findings.append(
            {
                "finding": "rows-sorted",
                "count": moved,
                "message": f"rows moved when they were sorted by {', '.join(meaning.sort_by)}; their numbers in the "
                "source are in infos['source_row']",
            }
        )


def order(table: Table, meaning: Meaning, rows: TableRows) -> dict[str, Any]:
    """Refuses rows out of order, ends episodes at missing cells and at gaps; returns facts for the provenance."""
    source, columns = table.source, rows.columns
    flags = [columns[field] for field in ("terminated", "truncated") if field in columns]
    ends = np.logical_or.reduce(flags) if flags else None
    if "episode" not in columns and (ends is None or not ends.any()):
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
    if isinstance(meaning.episode, str):
        _fill_ids(meaning.episode, rows)
        remedy = f"pass sort_by={by_time}" + ("" if meaning.time else " with the column of the time in the end")
        remedies = [remedy, "use unique ids"]
        row_order.refuse_scattered(source, meaning.episode, columns["episode"], rows.numbers, remedies)
    first, cut = _cut_at_missing(source, meaning, rows)
    if meaning.time is None:
        return {}
    remedies = ["remove rows that were logged twice", "name the column that tells episodes apart with episode="]
    if not meaning.sort_by:
        remedies.insert(0, f"pass sort_by={by_time} to sort the rows")
    clock = row_order.read_clock(
        source,
        meaning.time,
        columns["time"],
        first,
        rows.numbers,
        time_step=meaning.time_step,
        on_gap=meaning.on_gap,
        remedies=remedies,
        cut=cut,
    )
    rows.findings.extend(clock.findings)
    if clock.gaps.any():
        nothing = np.zeros(len(rows), bool)
        terminated = columns.get("terminated", nothing)
        columns["truncated"] = columns.get("truncated", nothing) | (clock.gaps & ~terminated)
        if "episode" in columns:
            starts = row_order.first_rows(columns["episode"], None, len(rows))
            columns["episode"] = np.cumsum(starts | np.append(False, clock.gaps[:-1])) - 1
    return {} if clock.time_step is None else {"time_step": clock.time_step}


def add_history(source: str, derivation: Derivation, rows: TableRows) -> None:
    """Differences and earlier rows join the observations; rows with too few before them in their episode are left out.

    Raises:
        DatasetError: no episode is long enough, or a name is used twice.
    """
    columns = rows.columns
    names = derivation.names
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DatasetError(
            f"{source}: observation '{twice}' is there twice, once made by lags or differences; rename it"
        )
    flags = [columns[field] for field in ("terminated", "truncated") if field in columns]
    ends = np.logical_or.reduce(flags) if flags else None
    first = row_order.first_rows(columns.get("episode"), ends, len(rows))
    columns["observations"], known = derivation.of_log(columns["observations"], columns["actions"], first)
    rows.observation_names.update({name: name for name in names if name not in rows.observation_names})
    if known.all():
        return
    if not known.any():
        raise DatasetError(
            f"{source}: no episode is longer than {derivation.history} rows, so none has the history that lags and "
            "differences need; take fewer"
        )
    lost = int(first.sum()) - len(np.unique(np.cumsum(first)[known]))
    rows.findings.append(
        {
            "finding": "rows-without-history",
            "count": int((~known).sum()),
            "message": f"the first {derivation.history} rows of each episode left out, because their observation needs "
            f"that many rows before it; {lost:,} of {int(first.sum()):,} episodes were no longer than that: "
            f"{name_rows(~known, rows.numbers)}",
        }
    )
    rows.take(known)


def _fill_ids(column: str, rows: TableRows) -> None:
    """A missing id counts as that of the row before it; the row is left out later."""
    if (missing := rows.holes.by_column.get(column)) is not None:
        known = np.flatnonzero(~missing)
        if len(known):
            place = np.maximum.accumulate(np.where(missing, known[0], np.arange(len(rows))))
            rows.columns["episode"] = rows.columns["episode"][place]


def _cut_at_missing(source: str, meaning: Meaning, rows: TableRows) -> tuple[np.ndarray, np.ndarray]:
    """Leaves out the rows that miss a value, and ends the episode of the row before each.

    Returns:
        [rows] bool: where an episode of the source begins; [rows] bool: after which rows an episode was cut here.
    """
    columns, holes, count = rows.columns, rows.holes, len(rows)
    nothing = np.zeros(count, bool)
    flags = [columns[field] for field in ("terminated", "truncated") if field in columns]
    # Where nobody knows whether a row ended its episode, the next row does not continue it.
    flags += [holes.by_column[n] for n in (meaning.terminated, meaning.truncated) if n in holes.by_column and n]
    first = row_order.first_rows(columns.get("episode"), np.logical_or.reduce([nothing, *flags]), count)
    missing = holes.mask()
    if not missing.any():
        return first, nothing
    if missing.all():
        worst = max(holes.by_column, key=lambda name: int(holes.by_column[name].sum()))
        raise DatasetError(
            f"{source}: column '{worst}' has no value in {name_rows(holes.by_column[worst], rows.numbers)}, and no row "
            "is left; leave out columns that hold next to nothing"
        )
    terminated, truncated = columns.get("terminated", nothing), columns.get("truncated", nothing)
    continues = np.append(missing[1:] & ~first[1:], False)
    cut = continues & ~missing & ~terminated & ~truncated
    columns["truncated"] = truncated | cut
    number = np.cumsum(first)
    if "episode" in columns:
        columns["episode"] = np.cumsum(first | np.append(False, missing[:-1])) - 1
    by_column = ", ".join(f"{name} {int(mask.sum()):,}" for name, mask in holes.by_column.items())
    rows.findings.append(
        {
            "finding": "missing-cells",
            "count": int(missing.sum()),
            "message": f"rows without a value left out, and episodes cut there, as the recording was: "
            f"{name_rows(missing, rows.numbers)}; by column: {by_column}",
        }
    )
    rows.take(~missing)
    number, cut = number[~missing], cut[~missing]
    return np.append(True, number[1:] != number[:-1]), cut
