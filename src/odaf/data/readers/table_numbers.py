"""Cells as the numbers a learner sees, as flags, and as further columns, which keep their type and precision."""

import numpy as np
import polars as pl

from odaf.data.readers import table_text
from odaf.data.readers.table_cells import (
    Cells,
    Holes,
    OnMissing,
    is_plain,
    is_wide,
    mask_of,
    missing_in,
    refuse,
    refuse_missing,
    refuse_type,
)
from odaf.data.rounding import merged_in_single
from odaf.data.validation import any_in_row

_LARGEST_DOUBLE = 2.0**53


def as_numbers(cells: Cells, on_missing: OnMissing = "error") -> np.ndarray:
    """[rows, width] float32; width is 1, or the common length of the lists in the cells.

    Args:
        cells: numbers or bool, equally long lists of these, or text where the source holds nothing else.
        on_missing: what an empty cell or NaN means: a mistake, or NaN.

    Raises:
        DatasetError: a cell is no number or too large for single precision, is missing, its list has another length, or
            single precision cannot tell the column's values apart.
    """
    values, width = _numeric(cells)
    values = _filled(cells, values, width, on_missing)
    array = values.to_numpy().reshape(-1, width)
    with np.errstate(over="ignore"):
        result = array.astype(np.float32)
    over = np.isinf(result)
    if over.any():
        over &= np.isfinite(array)
        if over.any():
            refuse(cells, any_in_row(over), "is too large for single precision", "change its unit")
    _refuse_merged(cells, array)
    return result


def as_doubles(cells: Cells, on_missing: OnMissing = "error") -> np.ndarray:
    """[rows] float64, to compute with.

    Raises:
        DatasetError: as `as_numbers`, or a cell holds a list or a whole number that float64 cannot hold.
    """
    values, width = _numeric(cells)
    if width != 1 or isinstance(cells.values.dtype, (pl.List, pl.Array)):
        refuse_type(cells, "an expression takes columns of numbers, so write one column for each number of the list")
    values = _filled(cells, values, 1, on_missing)
    array = values.to_numpy().astype(np.float64)
    if values.dtype.is_integer() and (np.abs(array) > _LARGEST_DOUBLE).any():
        refuse(
            cells, np.abs(array) > _LARGEST_DOUBLE, "holds whole numbers beyond 53 bits", "subtract an offset before"
        )
    return array


def as_flags(cells: Cells, holes: Holes | None = None) -> np.ndarray:
    """[rows] bool, from bool, from numbers that are all 0 or 1, or from text such as `True`, `no` and `1.0`.

    Args:
        cells: the column.
        holes: takes note of missing cells, which then read as false; None refuses them.

    Raises:
        DatasetError: a cell is missing or neither true nor false.
    """
    values = cells.values
    if values.dtype == pl.String and cells.parsed:
        known = table_text.text_of(cells)
        values = table_text.flags_of(cells)
        odd = mask_of(values.is_null() & known.is_not_null())
    elif values.dtype == pl.Boolean:
        odd = np.zeros(len(values), bool)
    elif is_plain(values.dtype) or values.dtype == pl.Null:
        values = values.cast(pl.Float64)
        odd = mask_of(((values != 0) & (values != 1)).fill_null(False)) & ~missing_in(values)
    else:
        refuse_type(cells)
    if odd.any():
        remedies = ["use true and false, or 1 and 0", "derive the flag"]
        if odd[0] and table_text.begins_with_a_unit(cells):
            remedies.insert(0, "pass units_row=True if that row holds units")
        refuse(cells, odd, "is neither true nor false", *remedies)
    missing = refuse_missing(cells, values, "write true or false into every row", holes)
    array = values.fill_null(0 if values.dtype.is_numeric() else False).to_numpy().astype(bool)
    return array & ~missing


def as_info(cells: Cells, on_missing: OnMissing = "error") -> np.ndarray:
    """[rows] or [rows, width] in the type of the cells; text of a CSV file in the narrowest type that holds it all.

    Whole numbers stay whole, dates and durations become int64 in their own resolution, counted from 1970 or from zero.
    Missing values turn a column into float64 with NaN, where they are allowed.

    Raises:
        DatasetError: a cell is no number, bool, date or list of numbers, is missing, or would not keep its value.
    """
    values = cells.values
    if isinstance(values.dtype, (pl.List, pl.Array)):
        values, width = _numeric(cells)
        array = _filled(cells, values, width, on_missing).to_numpy().reshape(-1, width)
        return array[:, 0] if width == 1 else array
    if values.dtype == pl.String and cells.parsed:
        values = typed(cells)
    if values.dtype == pl.Date:
        values = values.cast(pl.Datetime("us"))
    if values.dtype.is_temporal():
        values = values.to_physical()
    if isinstance(values.dtype, pl.Decimal):
        values = values.cast(pl.Float64)
    if is_wide(values.dtype):
        narrow = values.cast(pl.Int64, strict=False)
        lost = mask_of(narrow.is_null() & values.is_not_null())
        if lost.any():
            refuse(cells, lost, "holds whole numbers beyond 64 bits", "leave the column out")
        values = narrow
    if values.dtype == pl.Null:
        values = values.cast(pl.Float64)
    if not is_plain(values.dtype):
        refuse_type(cells)
    if values.null_count() and on_missing != "error":
        known = values.drop_nulls().cast(pl.Float64).to_numpy()
        if values.dtype.is_integer() and (np.abs(known) > _LARGEST_DOUBLE).any():
            refuse(
                cells,
                mask_of(values.is_null()),
                "has no value beside whole numbers beyond 53 bits, which NaN cannot stand among",
                "fill the cells in",
                "leave the column out",
            )
    return _filled(cells, values, 1, on_missing).to_numpy()


def typed(cells: Cells, format: str | None = None) -> pl.Series:
    """Text of a CSV file as Int64, Float64, Boolean or moments, the first of these that fits every cell.

    Raises:
        DatasetError: none does.
    """
    text = table_text.text_of(cells)
    if text.is_null().all():
        return text.cast(pl.Float64)
    if format is None:
        if (whole := table_text.whole_of(cells)) is not None:
            return whole
        flags = table_text.flags_of(cells)
        words = table_text.floats_of(text, cells.decimal_comma).is_null() & text.is_not_null()
        if bool((flags.is_not_null() | text.is_null()).all()) and words.any():
            return flags
    return table_text.moments_of(cells, format)


def _numeric(cells: Cells) -> tuple[pl.Series, int]:
    """Numbers or bool, [rows * width] of them, nulls included; and the width."""
    values = cells.values
    if isinstance(values.dtype, (pl.List, pl.Array)):
        return _exploded(cells)
    if values.dtype == pl.String and cells.parsed:
        values = table_text.numbers_of(cells)
        if values.abs().max() is not None and float(values.abs().max()) > _LARGEST_DOUBLE:  # type: ignore[arg-type]
            whole = table_text.whole_of(cells)
            values = values if whole is None else whole
    elif values.dtype == pl.Null:
        values = values.cast(pl.Float64)
    elif not is_plain(values.dtype):
        refuse_type(cells)
    if isinstance(values.dtype, pl.Decimal) or is_wide(values.dtype):
        values = values.cast(pl.Float64)
    return values, 1


def _exploded(cells: Cells) -> tuple[pl.Series, int]:
    """The lists of a column, one after another, and their length."""
    values = cells.values
    assert isinstance(values.dtype, (pl.List, pl.Array))
    if not (is_plain(values.dtype.inner) and (isinstance(values.dtype, pl.List) or len(values.dtype.shape) == 1)):
        refuse_type(cells, "a list must hold numbers, not lists or text")
    if values.null_count():
        refuse(cells, mask_of(values.is_null()), "has no value", "every row needs its list")
    sizes = values.list.len() if isinstance(values.dtype, pl.List) else values.arr.len()
    lengths: np.ndarray = np.asarray(sizes.to_numpy())
    width = int(lengths[0])
    if (lengths != width).any():
        row = int(np.flatnonzero(lengths != width)[0])
        refuse(
            cells,
            mask_of(sizes != width),
            f"holds lists of different lengths: {width} numbers in the first row, {lengths[row]} elsewhere",
            "every row needs the same quantities; pad or cut the lists",
        )
    if width == 0:
        refuse(cells, mask_of(sizes == 0), "holds empty lists", "name a column that has values")
    flat = values.explode()
    return flat.cast(pl.Float64) if isinstance(flat.dtype, pl.Decimal) or is_wide(flat.dtype) else flat, width


def _filled(cells: Cells, values: pl.Series, width: int, on_missing: OnMissing) -> pl.Series:
    """`values` without nulls: NaN in their place where missing values are allowed."""
    missing = missing_in(values)
    if not missing.any():
        return values
    if on_missing == "error":
        refuse(
            cells,
            any_in_row(missing.reshape(-1, width)),
            "has no value (empty or NaN)",
            "fill the cells in",
            'pass on_missing="break" to leave such rows out and cut the episode there',
            'on_missing="nan" to keep them as NaN, for the checks to count',
        )
    return values.cast(pl.Float64 if values.dtype != pl.Float32 else pl.Float32).fill_null(np.nan)


def _refuse_merged(cells: Cells, array: np.ndarray) -> None:
    """Raises where single precision makes one number of several, as of times and counters in large numbers."""
    for column in array.T:
        merged = merged_in_single(column)
        if merged is None:
            continue
        known = column[np.isfinite(column)]
        formula = f"put a formula in its place, such as '{cells.name}_since = {cells.name} - {known.min():.10g}'"
        refuse(
            cells,
            merged.rows,
            f"holds {merged.distinct:,} different numbers, up to {merged.largest:.10g}, of which single precision "
            f"keeps {merged.kept:,} apart",
            *([formula] if np.abs(known.astype(np.float64)).max() <= _LARGEST_DOUBLE else []),
            "leave the column out",
        )
