"""Cells that order the rows and part them into episodes: ids, times and keys to sort by, none of them rounded."""

import numpy as np
import polars as pl

from odaf.data.readers import table_numbers, table_text
from odaf.data.readers.table_cells import (
    Cells,
    Holes,
    is_plain,
    is_wide,
    missing_in,
    refuse,
    refuse_missing,
    refuse_type,
)

_SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}
_LARGEST_DOUBLE = 2**53


def as_ids(cells: Cells, holes: Holes | None = None) -> np.ndarray:
    """[rows] whole numbers, float64 or text: equal for the rows of one episode.

    Whole numbers beyond 64 bits and bytes become text, so that none is rounded onto another.

    Args:
        cells: the column.
        holes: takes note of missing cells, which then read as 0 or an empty text; None refuses them.

    Raises:
        DatasetError: a cell is missing or of a type that cannot name an episode.
    """
    values = cells.values
    if values.dtype == pl.Boolean:
        values = values.cast(pl.Int8)
    if values.dtype in (pl.Categorical, pl.Enum) or is_wide(values.dtype) or isinstance(values.dtype, pl.Decimal):
        values = values.cast(pl.String)
    if values.dtype == pl.Binary:
        values = values.bin.encode("hex")
    if values.dtype.is_temporal():
        values = values.to_physical()
    if not (values.dtype == pl.String or values.dtype.is_numeric() or values.dtype == pl.Null):
        refuse_type(cells, "an episode is named by a number or a text")
    if values.dtype == pl.String:
        values = values.set(values.str.strip_chars() == "", None)
        if cells.parsed:
            values = _numeric_ids(cells, values)
    missing = refuse_missing(cells, values, "every row needs the id of its episode", holes)
    if values.dtype != pl.String:
        array = values.fill_null(0).to_numpy() if values.dtype != pl.Null else np.zeros(len(values))
        return np.where(missing, 0, array) if missing.any() else array
    values = values.fill_null("")
    whole = values.cast(pl.Int64, strict=False)
    if (whole.cast(pl.String) == values).fill_null(False).all():
        return whole.to_numpy()
    return values.to_numpy().astype(str)


def as_times(cells: Cells, format: str | None = None, holes: Holes | None = None) -> np.ndarray:
    """[rows] float64 seconds: numbers as they are, times of day since midnight, dates since the earliest of the column.

    Whole numbers that float64 cannot hold, such as nanoseconds since 1970, count from the smallest of the column.

    Args:
        cells: numbers, dates, times, durations, or text that writes one of these, dates as in ISO 8601.
        format: how text writes a date where it is not ISO 8601, such as "%d.%m.%Y %H:%M:%S".
        holes: takes note of missing cells, which then read as NaN; None refuses them.

    Raises:
        DatasetError: a cell is missing, not finite or cannot be read as a time.
    """
    values = _moments(cells, format)
    missing = refuse_missing(cells, values, "every row needs its time", holes)
    seconds = 1.0
    if values.dtype == pl.Date:
        values = values.cast(pl.Datetime("us"))
    if isinstance(values.dtype, (pl.Datetime, pl.Duration)):
        seconds = _SECONDS[str(values.dtype.time_unit)]
    elif values.dtype == pl.Time:
        seconds = 1e-9
    since_first = isinstance(values.dtype, pl.Datetime)
    values = values.to_physical() if values.dtype.is_temporal() else values
    if values.dtype.is_integer():
        whole = values.fill_null(0 if values.null_count() == len(values) else values.drop_nulls()[0]).to_numpy()
        if since_first or np.abs(whole.astype(np.float64)).max(initial=0.0) > _LARGEST_DOUBLE:
            whole = whole - whole.min()  # exact, unlike a difference of floats
        array = whole * seconds
    else:
        array = values.cast(pl.Float64).to_numpy()
    array = np.where(missing, np.nan, array)
    if not np.isfinite(array[~missing]).all():
        refuse(cells, ~np.isfinite(array) & ~missing, "is not finite", "every row needs its time")
    return array


def as_sort_key(cells: Cells, format: str | None = None) -> np.ndarray:
    """[rows] numbers that ascend as the cells do, none of them rounded.

    Args:
        cells: numbers, bool, dates, times or durations, or text that writes one of these.
        format: how text writes a date where it is not ISO 8601.

    Raises:
        DatasetError: a cell is missing or cannot be put in order.
    """
    values = _moments(cells, format) if format is not None else cells.values
    if values.dtype == pl.String and cells.parsed:
        values = table_numbers.typed(cells)
    if values.dtype.is_temporal():
        values = values.to_physical()
    if isinstance(values.dtype, pl.Decimal) or is_wide(values.dtype):
        refuse_missing(cells, values, "every row needs its place")
        values = values.rank("dense")
    if values.dtype == pl.Null:
        values = values.cast(pl.Float64)
    if not is_plain(values.dtype):
        refuse_type(cells, "rows are sorted by numbers or dates")
    if (missing := missing_in(values)).any():
        refuse(cells, missing, "has no value", "rows are sorted by it, so every row needs one: fill the cells in")
    return values.to_numpy()


def _moments(cells: Cells, format: str | None) -> pl.Series:
    """Numbers, dates, times or durations."""
    values = cells.values
    if values.dtype == pl.String and (cells.parsed or format is not None):
        return table_text.moments_of(cells, format)
    if isinstance(values.dtype, pl.Decimal) or is_wide(values.dtype) or values.dtype in (pl.Null, pl.Boolean):
        return values.cast(pl.Float64)
    if not (is_plain(values.dtype) or values.dtype.is_temporal()):
        refuse_type(cells, "a time is a number of seconds or a date with its time")
    return values


def _numeric_ids(cells: Cells, values: pl.Series) -> pl.Series:
    """Text as numbers where every id is written as one and at least one of them with a decimal mark or an exponent."""
    text = values.str.strip_chars()
    if text.cast(pl.Int64, strict=False).null_count() == text.null_count():
        return text
    number = table_text.floats_of(text, cells.decimal_comma)
    written = number.is_not_null() | text.is_null()
    if not written.all() or (number.drop_nulls().drop_nans().abs() > _LARGEST_DOUBLE).any():
        return text
    return number
