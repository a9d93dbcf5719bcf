"""Columns of any origin as NumPy arrays, with what is missing told from the values themselves.

Masked entries, None, pandas' NA and NaT, null in polars and Arrow: each is a missing value, whatever number may stand
behind it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from odaf.data.row_names import RowNumbers, any_in_row, name_rows
from odaf.errors import DatasetError

_NOTHING = ("NAType", "NaTType")  # pandas' own marks, known by name because pandas need not be installed
_REMEDY = "repair these rows, or drop the whole episodes they belong to"


def numbers(
    source: str, field: str, values: Any, row_numbers: RowNumbers | None = None, *, further: bool = False
) -> np.ndarray:
    """`values` as a real-valued NumPy array in their own type, uncopied where possible.

    Args:
        source: how messages name the rows.
        field: how messages name the column.
        values: anything that NumPy makes an array of: arrays, also masked, series, frames, nested lists.
        row_numbers: what the source calls each row.
        further: of a column that no learner sees: dates and durations become int64 in their own resolution, and missing
            floats become NaN. Otherwise both are refused.

    Raises:
        DatasetError: strings, objects, complex or ragged values; whole numbers beyond 64 bits; missing values.
    """
    array, missing = _array(source, field, values)
    if array.dtype.kind in "mM" and further:
        missing = missing | np.isnat(array)
        array = array.astype(array.dtype.str).view(np.int64)
    if missing.any():
        if not (further and array.dtype.kind == "f"):
            kind = f", which {array.dtype} cannot say" if further else ""
            raise DatasetError(
                f"{source}: field '{field}' has no value (masked, None or NA){kind} in "
                f"{name_rows(any_in_row(missing) if missing.ndim else missing[None], row_numbers)}; {_REMEDY}"
            )
        array = np.where(missing.reshape(missing.shape + (1,) * (array.ndim - missing.ndim)), np.nan, array)
    if array.dtype.kind not in "biuf":
        raise DatasetError(
            f"{source}: field '{field}' holds {array.dtype} values, not real numbers; convert the column to numbers"
        )
    return array


def identifiers(source: str, field: str, values: Any, row_numbers: RowNumbers | None = None) -> np.ndarray:
    """`values` as an array of ids of one kind, in their own type: numbers, texts or dates.

    Raises:
        DatasetError: an id is missing or NaN, or ids are of kinds that cannot be compared.
    """
    array, missing = _array(source, field, values)
    if array.dtype.kind == "f":
        missing = missing | np.isnan(array)
    if array.dtype.kind in "mM":
        missing = missing | np.isnat(array)
    if missing.any():
        raise DatasetError(
            f"{source}: field '{field}' has no value in {name_rows(any_in_row(missing), row_numbers)}; "
            "every row needs the id of its episode"
        )
    if array.dtype == object and all(isinstance(value, str) for value in array.ravel()):
        array = array.astype(str)
    if array.dtype.kind not in "biufmMUS":
        raise DatasetError(
            f"{source}: field '{field}' holds {_kinds(array)}; give ids of one kind, numbers of 64 bits or texts"
        )
    return array


def _array(source: str, field: str, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """The values, objects as numbers where all of them are, and what of them is missing, of as many axes or fewer."""
    if type(values) is np.ndarray and values.dtype != object:
        return values, np.zeros((), bool)
    if isinstance(values, list | tuple) and any(isinstance(value, np.ma.MaskedArray) for value in values):
        values = _stacked(source, field, values)
    missing = _missing(values)
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged nested lists
        raise DatasetError(f"{source}: field '{field}' is not a rectangular array ({error}); pad or cut it") from error
    if array.dtype.kind == "f" and missing.any():
        array = _as_logged(values, array)
    if array.dtype == object:
        array, nothing = _of_objects(array)
        missing = missing.reshape(missing.shape + (1,) * (nothing.ndim - missing.ndim)) | nothing
    return array, missing


def _as_logged(values: Any, array: np.ndarray) -> np.ndarray:
    """Objects in place of floats, where a series held whole numbers that became floats to make room for NaN."""
    for name in ("to_list", "to_pylist"):
        if callable(listed := getattr(values, name, None)):
            return np.array(listed(), object)
    return array


def _stacked(source: str, field: str, rows: Any) -> np.ma.MaskedArray:
    """A list of masked rows as one masked array; NumPy itself would forget the masks."""
    try:
        return np.ma.stack([np.ma.asarray(row) for row in rows])
    except ValueError as error:
        raise DatasetError(f"{source}: field '{field}' is not a rectangular array ({error}); pad or cut it") from error


def _missing(values: Any) -> np.ndarray:
    """What a masked array, a series or a frame itself says is missing."""
    if isinstance(values, np.ma.MaskedArray):
        return np.ma.getmaskarray(values)
    for name in ("isna", "is_null"):  # pandas; polars and Arrow
        ask: Callable[[], Any] | None = getattr(values, name, None)
        if callable(ask):
            return np.asarray(ask()).astype(bool)
    return np.zeros((), bool)


def _of_objects(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Python's objects as numbers where all that are not missing are such, and which are missing."""
    flat = array.ravel().tolist()
    missing = np.array([_is_nothing(value) for value in flat], bool)
    known = [value for value, nothing in zip(flat, missing, strict=True) if not nothing]
    if not all(isinstance(value, bool | int | float | np.number | np.bool_) for value in known):
        return array, missing.reshape(array.shape)
    plain = np.array(known) if known else np.zeros(0)
    whole = all(isinstance(value, bool | int | np.integer | np.bool_) for value in known)
    if plain.dtype == object or (known and whole and plain.dtype.kind == "f"):
        return array, missing.reshape(array.shape)  # whole numbers beyond 64 bits
    result = np.zeros(len(flat), plain.dtype)
    result[~missing] = plain
    return result.reshape(array.shape), missing.reshape(array.shape)


def _is_nothing(value: Any) -> bool:
    return value is None or value is np.ma.masked or type(value).__name__ in _NOTHING


def _kinds(array: np.ndarray) -> str:
    """`int and str`, or the type of the array."""
    kinds = sorted({type(value).__name__ for value in array.ravel()}) if array.dtype == object else [str(array.dtype)]
    return " and ".join(kinds)
