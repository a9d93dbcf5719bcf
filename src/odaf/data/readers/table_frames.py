"""Tables in memory: polars and pandas frames, and mappings from names to arrays or lists."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import polars as pl

from odaf.data.readers.table_cells import without
from odaf.data.readers.table_sources import Table, reading
from odaf.errors import DatasetError

_MOMENTS = ("moments without a time zone", "moments in a time zone")
_BITS = 127  # whole numbers up to here have a type in polars


def frame_table(frame: Any, source: str, missing_values: Sequence[str] = ()) -> Table:
    """The table in a polars or pandas frame, or in a mapping from names to arrays.

    Anything that lists its `columns` and gives each by its name, with `to_numpy`, is taken as pandas' frames are. What
    a NumPy array masks is missing, whatever stands behind the mask.

    Raises:
        DatasetError: it is none of these, or its columns differ in length.
    """
    words = tuple(missing_values)
    if isinstance(frame, pl.LazyFrame):
        with reading(source):
            schema = frame.collect_schema()
            rows = int(frame.select(pl.len()).collect().item())
        return Table(
            source,
            "frame",
            tuple(schema),
            rows,
            lambda name: frame.select(name).collect().to_series(),
            missing_values=words,
        )
    if isinstance(frame, pl.DataFrame):
        return Table(source, "frame", tuple(frame.columns), frame.height, frame.get_column, missing_values=words)
    names = frame.keys() if isinstance(frame, Mapping) else getattr(frame, "columns", None)
    if names is None or not hasattr(frame, "__getitem__"):
        raise DatasetError(
            f"{source}: got {type(frame).__name__}; pass a polars or pandas frame, or a mapping from names to columns"
        )
    names = tuple(names)
    if not all(isinstance(name, str) for name in names):
        odd = next(name for name in names if not isinstance(name, str))
        raise DatasetError(f"{source}: column name {odd!r} is not a text; rename the columns")
    unique = [name for name in names if names.count(name) == 1]
    rows = 0
    if unique:
        with reading(source, f"column '{unique[0]}'"):
            rows = len(_series(source, unique[0], frame[unique[0]], words))
    return Table(
        source, "frame", names, rows, lambda name: _series(source, name, frame[name], words), missing_values=words
    )


def _series(source: str, name: str, column: Any, missing_values: Sequence[str]) -> pl.Series:
    """A column of any kind; pandas' marks for missing values and masked entries become null."""
    if isinstance(column, pl.Series):
        return column
    if not hasattr(column, "__len__") or getattr(column, "shape", None) == ():
        raise DatasetError(f"{source}: column '{name}' is {column!r:.40}; give a sequence with one entry per step")
    if isinstance(column, np.ma.MaskedArray):
        return _unmasked(source, name, column, missing_values)
    bare = getattr(getattr(column, "dtype", None), "numpy_dtype", None)
    if isinstance(bare, np.dtype) and bare.kind in "biuf" and hasattr(column, "isna"):
        return _nullable(name, column, bare)
    try:
        array = np.asarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
    except ValueError:  # lists of different lengths
        array = np.empty(len(column), object)
        array[:] = list(column)
    if array.dtype.kind in "mM":
        return pl.Series(name, _known_resolution(source, name, array))
    if array.dtype != object:
        if array.dtype.kind == "U" and isinstance(column, (list, tuple)) and len({*map(_kind, column)}) > 1:
            return _of_objects(source, name, list(column), missing_values)  # else 1 and "1" would be one id
        return pl.Series(name, array)
    if hasattr(column, "isna"):
        array = array.copy()
        array[np.asarray(column.isna(), bool)] = None
    values = [value.item() if isinstance(value, np.generic) else value for value in array.tolist()]
    return _of_objects(source, name, values, missing_values)


def _nullable(name: str, column: Any, bare: np.dtype) -> pl.Series:
    """A column of pandas' types that know a missing value, in the type of its numbers.

    By itself it gives floating point where one is missing, which rounds large ids.
    """
    values = pl.Series(name, column.to_numpy(dtype=bare, na_value=bare.type(0)))
    missing = np.asarray(column.isna(), bool)
    return values.set(pl.Series(missing), None) if missing.any() else values


def _unmasked(source: str, name: str, column: np.ma.MaskedArray, missing_values: Sequence[str]) -> pl.Series:
    """What lies behind a mask is nobody's business: null in its place."""
    mask, data = np.ma.getmaskarray(column), np.asarray(column.data)
    if data.ndim > 1:
        entries = [[_plain(value) for value in row] for row in column.tolist()] if mask.any() else data
        return pl.Series(name, entries)
    return _series(source, name, data, missing_values).set(pl.Series(mask), None)


def _known_resolution(source: str, name: str, array: np.ndarray) -> np.ndarray:
    """Dates and durations in a resolution that the table library has; as seconds where theirs is finer."""
    unit = np.datetime_data(array.dtype)[0]
    kind = array.dtype.kind
    if unit in ("ms", "us", "ns") or (unit == "D" and kind == "M"):
        return array
    if unit in ("ps", "fs", "as"):
        since = array if kind == "m" else array - array[~np.isnat(array)].min() if (~np.isnat(array)).any() else array
        return np.where(np.isnat(array), np.nan, since.astype(np.int64) * {"ps": 1e-12, "fs": 1e-15, "as": 1e-18}[unit])
    if unit == "generic" or (kind == "m" and unit in ("M", "Y")):
        raise DatasetError(
            f"{source}: column '{name}' holds durations in {'no unit' if unit == 'generic' else unit}, which is no "
            "fixed number of seconds; give them in seconds"
        )
    with np.errstate(over="ignore"):
        fine = array.astype(f"{kind}8[ms]" if unit in ("Y", "M", "W", "D", "h") else f"{kind}8[us]")
    known = ~np.isnat(array)
    if (fine[known].astype(array.dtype) != array[known]).any():
        raise DatasetError(f"{source}: column '{name}' holds moments too far from 1970; give them in seconds")
    return fine


def _of_objects(source: str, name: str, values: list[Any], missing_values: Sequence[str]) -> pl.Series:
    """Python's own objects, all of one kind."""
    texts = [value if isinstance(value, str) else None for value in values]
    known = without(pl.Series(texts, dtype=pl.String), missing_values)
    values = [None if text is not None and known[row] is None else values[row] for row, text in enumerate(texts)]
    kinds = [_kind(value) for value in values]
    found = set(kinds) - {"nothing"}
    if len(found) > 1:
        common = max(found, key=kinds.count)
        row = next(index for index, kind in enumerate(kinds) if kind not in (common, "nothing"))
        raise DatasetError(
            f"{source}: column '{name}' mixes {' and '.join(sorted(found))}, for instance {values[row]!r} "
            f"in row {row}; convert it to one type"
        )
    if (
        len(found) == 1
        and found <= {*_MOMENTS}
        and all(value is None or hasattr(value, "to_datetime64") for value in values)
    ):
        # pandas' moments: as Python's they would lose their nanoseconds. Those in a time zone are counted in UTC.
        moments = [np.datetime64("NaT") if value is None else value.to_datetime64() for value in values]
        return pl.Series(name, _known_resolution(source, name, np.array(moments)))
    if found == {"UUID"}:
        values = [None if value is None else str(value) for value in values]
    if found != {"numbers"}:
        return pl.Series(name, values)
    types = {type(value) for value in values if value is not None}
    if types == {bool}:
        return pl.Series(name, values, dtype=pl.Boolean)
    if types != {int}:
        return pl.Series(name, [None if value is None else float(value) for value in values], dtype=pl.Float64)
    bits = max(value.bit_length() for value in values if value is not None)
    if bits > _BITS:
        row = next(index for index, value in enumerate(values) if value is not None and value.bit_length() > _BITS)
        raise DatasetError(
            f"{source}: column '{name}' holds whole numbers beyond {_BITS} bits, for instance in row {row}; "
            "write them as text"
        )
    return pl.Series(name, values, dtype=pl.Int64 if bits < 64 else pl.Int128)


def _kind(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, (bool, np.bool_, int, float, np.number)):
        return "numbers"
    if isinstance(value, str):
        return "text"
    if isinstance(value, datetime):
        return _MOMENTS[value.tzinfo is not None]
    return "lists" if isinstance(value, (list, tuple, np.ndarray)) else type(value).__name__


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
