"""Checks that columns must pass before they become a dataset; each failure names the source, field, rows and remedy."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odaf.data.arrays import numbers
from odaf.data.rounding import merged_in_single
from odaf.data.row_names import RowNumbers, any_in_row, name_rows, number_of
from odaf.errors import DatasetError

# Actions may miss their bounds by this share of the range (rounding in the logger); they are then moved onto them.
BOUND_TOLERANCE = 1e-3

# Rows looked at together, so that what is computed on the way stays small beside the data.
_PIECE = 65_536

# (low, high), each a number or one per action; or {action name: (low, high)}.
Bounds = Mapping[str, Any] | Sequence[Any] | np.ndarray


def matrix(source: str, field: str, values: Any, row_numbers: RowNumbers | None = None) -> np.ndarray:
    """[rows, dimensions] float32 and finite, copied unless nobody can change it."""
    array = numbers(source, field, values, row_numbers)
    if array.ndim != 2:
        remedy = f"pass {field}[:, None] if it has one dimension per row" if array.ndim == 1 else "flatten each row"
        raise DatasetError(f"{source}: field '{field}' must be [rows, dimensions], got shape {array.shape}; {remedy}")
    if array.shape[1] == 0:
        raise DatasetError(f"{source}: field '{field}' has no columns (shape {array.shape}); name at least one column")
    return _single_precision(source, field, array, row_numbers)


def vector(source: str, field: str, values: Any, row_numbers: RowNumbers | None = None) -> np.ndarray:
    """[rows] float32 and finite, copied unless nobody can change it; [rows, 1] is accepted."""
    return _single_precision(
        source, field, _one_per_row(source, field, numbers(source, field, values, row_numbers)), row_numbers
    )


def flags(source: str, field: str, values: Any, row_numbers: RowNumbers | None = None) -> np.ndarray:
    """[rows] bool, copied; [rows, 1] and numbers that are all 0 or 1 are accepted."""
    array = _one_per_row(source, field, numbers(source, field, values, row_numbers))
    if array.dtype != bool:
        odd = (array != 0) & (array != 1)
        if odd.any():
            raise DatasetError(
                f"{source}: field '{field}' must hold only true and false (or 1 and 0); "
                f"other values in {name_rows(odd, row_numbers)}: {array[odd][:3].tolist()}; derive the flag first"
            )
    return array.astype(bool)


def same_length(source: str, columns: Mapping[str, np.ndarray]) -> int:
    """The common number of rows."""
    lengths = {field: len(column) for field, column in columns.items()}
    reference = lengths["observations"]
    for field, length in lengths.items():
        if length != reference:
            raise DatasetError(
                f"{source}: field '{field}' has {length:,} rows, 'observations' has {reference:,}; "
                "every field needs one entry per step, so find where rows were lost or added"
            )
    if reference == 0:
        raise DatasetError(f"{source}: there are no rows; a dataset needs at least one transition")
    return reference


def same_width(source: str, observations: np.ndarray, next_observations: np.ndarray) -> None:
    """Refuses successors that describe other quantities than the observations."""
    if next_observations.shape[1] != observations.shape[1]:
        raise DatasetError(
            f"{source}: field 'next_observations' has {next_observations.shape[1]} columns, 'observations' has "
            f"{observations.shape[1]}; both must describe the same quantities in the same order"
        )


def finite(source: str, field: str, array: np.ndarray, row_numbers: RowNumbers | None = None) -> None:
    """Refuses NaN and infinity."""
    if array.dtype.kind != "f" or all(
        np.isfinite(array[first : first + _PIECE]).all() for first in range(0, len(array), _PIECE)
    ):
        return
    bad = ~np.isfinite(array)
    if bad.any():
        rows = any_in_row(bad)
        columns = "" if bad.ndim == 1 else f" (columns {np.flatnonzero(bad.any(axis=0)).tolist()})"
        raise DatasetError(
            f"{source}: field '{field}' holds NaN or infinity in {name_rows(rows, row_numbers)}{columns}; "
            "repair these rows, or drop the whole episodes they belong to"
        )


def action_bounds(source: str, actions: np.ndarray, names: tuple[str, ...], bounds: Bounds | None) -> np.ndarray:
    """[2, act_dim] float32: lowest and highest action; taken from the data where `bounds` is None."""
    act_dim = actions.shape[1]
    if bounds is None:
        pair = np.stack([actions.min(axis=0), actions.max(axis=0)])
        remedy = "the column never changes, so its range is unknown: pass action_bounds="
    elif isinstance(bounds, Mapping):
        missing = [name for name in names if name not in bounds]
        unknown = [name for name in bounds if name not in names]
        if missing or unknown:
            raise DatasetError(
                f"{source}: action_bounds must name every action once; missing {missing}, unknown {unknown}, "
                f"actions are {list(names)}"
            )
        pair = np.stack([_edges(bounds[name]) for name in names]).T
        remedy = "give (low, high) with low below high"
    else:
        try:
            low, high = bounds
            pair = np.stack([np.broadcast_to(_edges(edge), (act_dim,)) for edge in (low, high)])
        except (ValueError, TypeError) as error:
            raise DatasetError(
                f"{source}: action_bounds must be (low, high), each one number or {act_dim} numbers, or a mapping from "
                f"action name to (low, high); got {bounds!r}"
            ) from error
        remedy = "give (low, high) with low below high"
    wrong = ~(np.isfinite(pair).all(axis=0) & (pair[0] < pair[1]))
    if wrong.any():
        index = int(np.flatnonzero(wrong)[0])
        raise DatasetError(
            f"{source}: field 'action_bounds': action '{names[index]}' (column {index}) has bounds "
            f"[{pair[0, index]}, {pair[1, index]}]; {remedy}"
        )
    return pair


def _edges(values: Any) -> np.ndarray:
    """Numbers as float32; masked ones as NaN, since no bound is known there."""
    return np.ma.filled(np.ma.asarray(values).astype(np.float32), np.nan)


def outside_bounds(
    source: str, actions: np.ndarray, low: np.ndarray, high: np.ndarray, row_numbers: RowNumbers | None = None
) -> np.ndarray:
    """[rows] bool: actions a hair outside their bounds. Those further out than `BOUND_TOLERANCE` of the range raise."""
    with np.errstate(over="ignore"):  # bounds as wide as single precision goes
        slack = BOUND_TOLERANCE * (high - low)
    outside = np.zeros(len(actions), bool)
    far = np.zeros(actions.shape, bool)
    for first in range(0, len(actions), _PIECE):
        piece = slice(first, first + _PIECE)
        excess = np.maximum(low - actions[piece], actions[piece] - high)
        far[piece] = excess > slack
        outside[piece] = any_in_row(excess > 0)
    if far.any():
        index = int(np.flatnonzero(far.any(axis=0))[0])
        row = int(np.flatnonzero(far[:, index])[0])
        raise DatasetError(
            f"{source}: field 'actions' leaves its bounds in {name_rows(any_in_row(far), row_numbers)}: "
            f"column {index} is {actions[row, index]} in row {number_of(row, len(far), row_numbers)}, "
            f"allowed [{low[index]}, {high[index]}]",
            remedies=["pass the true action_bounds=", "clip the actions before"],
        )
    return outside


def names(source: str, field: str, given: Sequence[str] | None, count: int, prefix: str) -> tuple[str, ...]:
    """One distinct name per column; `prefix_0`, `prefix_1`, ... where none are given."""
    if given is None:
        return tuple(f"{prefix}_{index}" for index in range(count))
    result = tuple(given)
    if isinstance(given, str) or len(result) != count or len(set(result)) != count:
        raise DatasetError(f"{source}: {field} must be {count} different names, one per column; got {given!r}")
    if not all(isinstance(name, str) and name for name in result):
        raise DatasetError(f"{source}: {field} must be non-empty strings; got {given!r}")
    return result


def units(source: str, field: str, given: Sequence[str] | None, count: int) -> tuple[str, ...]:
    """One unit per column, such as "m/s"; empty texts where none are given."""
    if given is None:
        return ("",) * count
    result = tuple(given)
    if isinstance(given, str) or len(result) != count or not all(isinstance(unit, str) for unit in result):
        raise DatasetError(f"{source}: {field} must be {count} texts, one per column; got {given!r}")
    return result


def infos(
    source: str, columns: Mapping[str, Any], rows: int, row_numbers: RowNumbers | None = None
) -> dict[str, np.ndarray]:
    """Further columns by name, copied: numbers of any precision, bool or dates, with one entry per step.

    What is missing becomes NaN where the column can hold that. Dates and durations become int64 in their own
    resolution, counted from 1970 or from zero.
    """
    own: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if not isinstance(name, str) or not name or "/" in name or name.startswith("."):
            raise DatasetError(
                f"{source}: infos: name {name!r} must be a non-empty text without a slash or leading dot"
            )
        array = np.array(numbers(source, f"infos/{name}", values, row_numbers, further=True))
        if array.ndim == 0 or len(array) != rows:
            raise DatasetError(
                f"{source}: field 'infos/{name}' has shape {array.shape}, but there are {rows:,} rows; "
                "give one entry per step"
            )
        own[name] = array
    return own


def plain_json(source: str, provenance: Any) -> dict[str, Any]:
    """A copy of `provenance` in JSON types alone."""
    try:
        return json.loads(json.dumps(provenance, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise DatasetError(
            f"{source}: provenance must consist of JSON types ({error}); convert arrays with .tolist()"
        ) from error


def _one_per_row(source: str, field: str, array: np.ndarray) -> np.ndarray:
    if array.ndim == 2 and array.shape[1] == 1:
        return array[:, 0]
    if array.ndim != 1:
        raise DatasetError(f"{source}: field '{field}' must be [rows], one value per step; got shape {array.shape}")
    return array


def _single_precision(source: str, field: str, array: np.ndarray, row_numbers: RowNumbers | None) -> np.ndarray:
    finite(source, field, array, row_numbers)
    if array.dtype == np.float32 and array.flags.owndata and not array.flags.writeable:
        return array  # nobody can change it, so it may be shared
    with np.errstate(over="ignore"):
        result = array.astype(np.float32)
    if array.dtype.itemsize < 4 or array.dtype == np.float32:
        return result
    bad = ~np.isfinite(result)
    if bad.any():
        rows = any_in_row(bad)
        raise DatasetError(
            f"{source}: field '{field}' is too large for single precision in {name_rows(rows, row_numbers)}; "
            "change its unit"
        )
    columns = array.reshape(len(array), -1).T if array.size else ()
    for index, column in enumerate(columns):
        if (merged := merged_in_single(column)) is not None:
            place = "" if array.ndim == 1 else f" (column {index})"
            raise DatasetError(
                f"{source}: field '{field}'{place} holds {merged.distinct:,} different numbers, up to "
                f"{merged.largest}, of which single precision keeps {merged.kept:,} apart, "
                f"{name_rows(merged.rows, row_numbers)}; subtract an offset or change its unit before, or keep the "
                "column among the infos"
            )
    return result
