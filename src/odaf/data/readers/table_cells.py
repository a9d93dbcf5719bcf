"""The cells of one column as numbers, flags, ids or times. Each refusal names the column, the rows and the remedy."""

import re
from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np
import polars as pl

from odaf.data.validation import RowNumbers, any_in_row, name_rows
from odaf.errors import DatasetError

OnMissing = Literal["error", "nan"]

_TRUE = ("true", "t", "yes", "1", "1.0")
_FALSE = ("false", "f", "no", "0", "0.0")
_MISSING = ("", "na", "n/a", "null", "none")
_SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}


@dataclass(frozen=True)
class Cells:
    """One column as its source holds it.

    Attributes:
        source: how messages name the table.
        name: the column's name.
        values: the cells.
        numbers: the rows' numbers in the source, as messages give them.
        parsed: whether text may stand for numbers, flags and times, as in CSV.
        decimal_comma: whether such text writes 1,5 for one and a half.
    """

    source: str
    name: str
    values: pl.Series
    numbers: RowNumbers
    parsed: bool = False
    decimal_comma: bool = False


def as_numbers(cells: Cells, on_missing: OnMissing = "error") -> np.ndarray:
    """[rows, width] float32; width is 1, or the common length of the lists in the cells.

    Args:
        cells: numbers or bool, equally long lists of these, or text where the source holds nothing else.
        on_missing: what an empty cell or NaN means: a mistake, or NaN.

    Raises:
        DatasetError: a cell is no number or too large for single precision, is missing, or its list has another length.
    """
    values = cells.values
    if isinstance(values.dtype, (pl.List, pl.Array)):
        return _expanded(cells, on_missing)
    if values.dtype == pl.String and cells.parsed:
        values = _parsed(cells, "number")
    elif values.dtype == pl.Null:
        values = values.cast(pl.Float64)
    elif not _is_plain(values.dtype):
        _refuse_type(cells)
    return _single_precision(cells, values, 1, on_missing)


def as_flags(cells: Cells) -> np.ndarray:
    """[rows] bool, from bool, from numbers that are all 0 or 1, or from text such as `True`, `no` and `1`.

    Raises:
        DatasetError: a cell is missing or neither true nor false.
    """
    values = cells.values
    if values.dtype == pl.String and cells.parsed:
        text = values.str.strip_chars().str.to_lowercase()
        flags = text.is_in(_TRUE)
        odd = ~(flags | text.is_in(_FALSE) | text.is_in(_MISSING)).fill_null(True)
        values = flags.set(text.is_in(_MISSING), None)
    elif values.dtype == pl.Boolean:
        odd = pl.Series([False]).new_from_index(0, len(values))
    elif _is_plain(values.dtype) or values.dtype == pl.Null:
        values = values.cast(pl.Float64)
        odd = ((values != 0) & (values != 1)).fill_null(False) & ~values.is_nan().fill_null(False)
    else:
        _refuse_type(cells)
    if odd.any():
        _refuse(cells, _mask(odd), "is neither true nor false", "use true and false, or 1 and 0, or derive the flag")
    _refuse_missing(cells, values, "write true or false into every row")
    return values.to_numpy().astype(bool)


def as_ids(cells: Cells) -> np.ndarray:
    """[rows] whole numbers or text: equal for the rows of one episode.

    Raises:
        DatasetError: a cell is missing or of a type that cannot name an episode.
    """
    values = cells.values
    if values.dtype in (pl.Categorical, pl.Enum):
        values = values.cast(pl.String)
    if values.dtype == pl.Boolean or isinstance(values.dtype, pl.Decimal):
        values = values.cast(pl.Float64)
    if values.dtype.is_temporal():
        values = values.to_physical()
    if not (values.dtype == pl.String or values.dtype.is_numeric() or values.dtype == pl.Null):
        _refuse_type(cells, "an episode is named by a number or a text")
    if values.dtype == pl.String:
        values = values.set(values.str.strip_chars() == "", None)
    _refuse_missing(cells, values, "every row needs the id of its episode")
    if values.dtype == pl.String:
        whole = values.cast(pl.Int64, strict=False)
        if (whole.cast(pl.String) == values).fill_null(False).all():
            return whole.to_numpy()
        return values.to_numpy().astype(str)
    return values.to_numpy()


def as_times(cells: Cells, format: str | None = None) -> np.ndarray:
    """[rows] float64 seconds: numbers as they are, dates and times of day since their origin.

    Args:
        cells: numbers, dates, times, durations, or text that writes a number or a date as in ISO 8601.
        format: how text writes a date where it is not ISO 8601, such as "%d.%m.%Y %H:%M:%S".

    Raises:
        DatasetError: a cell is missing, not finite or cannot be read as a time.
    """
    values = cells.values
    if values.dtype == pl.String and (cells.parsed or format is not None):
        values = _moments(cells, format)
    if values.dtype == pl.Date:
        values = values.cast(pl.Datetime("us"))
    if isinstance(values.dtype, (pl.Datetime, pl.Duration)):
        seconds = values.to_physical().cast(pl.Float64) * _SECONDS[str(values.dtype.time_unit)]
    elif values.dtype == pl.Time:
        seconds = values.to_physical().cast(pl.Float64) * 1e-9
    elif _is_plain(values.dtype) or values.dtype == pl.Null:
        seconds = values.cast(pl.Float64)
    else:
        _refuse_type(cells, "a time is a number of seconds or a date with its time")
    _refuse_missing(cells, seconds, "every row needs its time")
    array = seconds.to_numpy()
    if not np.isfinite(array).all():
        _refuse(cells, ~np.isfinite(array), "is not finite", "every row needs its time")
    return array


def _expanded(cells: Cells, on_missing: OnMissing) -> np.ndarray:
    """The lists of a column side by side."""
    values = cells.values
    assert isinstance(values.dtype, (pl.List, pl.Array))
    if not (_is_plain(values.dtype.inner) and (isinstance(values.dtype, pl.List) or len(values.dtype.shape) == 1)):
        _refuse_type(cells, "a list must hold numbers, not lists or text")
    _refuse_missing(cells, values, "every row needs its list")
    sizes = values.list.len() if isinstance(values.dtype, pl.List) else values.arr.len()
    lengths: np.ndarray = np.asarray(sizes.to_numpy())
    width = int(lengths[0])
    if (lengths != width).any():
        row = int(np.flatnonzero(lengths != width)[0])
        _refuse(
            cells,
            _mask(sizes != width),
            f"holds lists of different lengths: {width} numbers in the first row, {lengths[row]} elsewhere",
            "every row needs the same quantities; pad or cut the lists",
        )
    if width == 0:
        _refuse(cells, _mask(sizes == 0), "holds empty lists", "name a column that has values")
    return _single_precision(cells, values.explode(), width, on_missing)


def _single_precision(cells: Cells, values: pl.Series, width: int, on_missing: OnMissing) -> np.ndarray:
    if isinstance(values.dtype, pl.Decimal) or values.dtype == pl.Int128:
        values = values.cast(pl.Float64)
    missing = values.is_null() | values.is_nan() if values.dtype.is_float() else values.is_null()
    if on_missing == "nan":
        values = values.cast(pl.Float64).fill_null(np.nan) if values.null_count() else values
    elif missing.any():
        _refuse(
            cells,
            any_in_row(_mask(missing).reshape(-1, width)),
            "has no value (empty or NaN)",
            'fill the cells in, or pass on_missing="nan" to keep them as NaN and decide by their check',
        )
    array = values.to_numpy().reshape(-1, width)
    with np.errstate(over="ignore"):
        result = array.astype(np.float32)
    over = np.isinf(result)
    if over.any():
        over &= np.isfinite(array)
        if over.any():
            _refuse(cells, any_in_row(over), "is too large for single precision", "change its unit")
    return result


def _parsed(cells: Cells, meaning: str) -> pl.Series:
    """Text as Float64; the words for a missing value become null."""
    text = cells.values.str.strip_chars()
    text = text.set(text.str.to_lowercase().is_in(_MISSING), None)
    point = text.str.replace(",", ".", literal=True) if cells.decimal_comma else text
    result = point.cast(pl.Float64, strict=False)
    wrong = result.is_null() & text.is_not_null()
    if wrong.any():
        first = str(text.filter(wrong)[0])
        remedy = "correct the cells, or leave the column out"
        if first.startswith(("[", "(")):
            remedy = "it looks like a list: write one column for each number, or a Parquet file with a column of lists"
        elif re.fullmatch(r"[+-]?\d+,\d+", first) and not cells.decimal_comma:
            remedy = "it looks like a decimal comma: pass decimal_comma=True"
        _refuse(cells, _mask(wrong), f"is not a {meaning}", remedy)
    return result


def _moments(cells: Cells, format: str | None) -> pl.Series:
    """Text as Float64 seconds where it is a number, else as dates."""
    text = cells.values.str.strip_chars()
    text = text.set(text.str.to_lowercase().is_in(_MISSING), None)
    if format is None and text.head(1).cast(pl.Float64, strict=False).null_count() == 0:
        return _parsed(cells, "number of seconds, as the first row is")
    try:
        result = text.str.to_datetime(format, strict=False, time_unit="us")
    except pl.exceptions.PolarsError:  # no format fits the first rows
        result = pl.Series([None], dtype=pl.Datetime("us")).new_from_index(0, len(text))
    wrong = result.is_null() & text.is_not_null()
    if wrong.any():
        fact = "cannot be read as a date in ISO 8601" if format is None else f"does not follow time_format {format!r}"
        _refuse(cells, _mask(wrong), fact, 'say how it is written, as in time_format="%d.%m.%Y %H:%M:%S"')
    return result


def _is_plain(dtype: object) -> bool:
    """Whether cells of this type are numbers or bool."""
    return isinstance(dtype, pl.DataType) and (dtype.is_numeric() or dtype == pl.Boolean)


def _mask(marked: pl.Series) -> np.ndarray:
    return marked.to_numpy().astype(bool)


def _refuse_missing(cells: Cells, values: pl.Series, remedy: str) -> None:
    missing = values.is_null() | values.is_nan() if values.dtype.is_float() else values.is_null()
    if missing.any():
        _refuse(cells, _mask(missing), "has no value", remedy)


def _refuse_type(cells: Cells, rule: str = "convert the column to numbers, or leave it out") -> NoReturn:
    kind = (
        "text" if cells.values.dtype in (pl.String, pl.Categorical, pl.Enum) else f"cells of type {cells.values.dtype}"
    )
    known = cells.values.is_not_null().to_numpy().astype(bool)
    marked = known if known.any() else ~known
    _refuse(cells, marked, f"holds {kind}, not numbers", rule)


def _refuse(cells: Cells, rows: np.ndarray, fact: str, remedy: str) -> NoReturn:
    index = int(np.flatnonzero(rows)[0])
    value = cells.values[index]
    if isinstance(value, pl.Series):
        value = value.to_list()
    shown = "" if value is None else f" ({_short(repr(value))})"
    raise DatasetError(
        f"{cells.source}: column '{cells.name}' {fact} in {name_rows(rows, cells.numbers)}{shown}; {remedy}"
    )


def _short(text: str, limit: int = 40) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."
