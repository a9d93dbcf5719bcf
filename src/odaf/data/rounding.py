"""Where single precision, in which learners see every column, makes one number of several."""

from dataclasses import dataclass

import numpy as np

_EXACT = 2.0**24  # whole numbers up to here are exact in single precision
_FEWEST_STEPS = 256  # fractions that single precision parts into fewer would lose their meaning


@dataclass(frozen=True)
class Merged:
    """What single precision would lose of one column.

    Attributes:
        rows: [rows] bool, those whose number another number of the column would be taken for.
        distinct: different numbers in the column.
        kept: how many single precision keeps apart.
        largest: the largest of them.
    """

    rows: np.ndarray
    distinct: int
    kept: int
    largest: float | int


def merged_in_single(column: np.ndarray) -> Merged | None:
    """What single precision would lose of a column [rows] of counters, time stamps and the like; None if nothing.

    A column that single precision parts into many steps is measured, not counted, and may be rounded.
    """
    if column.dtype.itemsize < 4 or column.dtype == np.float32:
        return None
    values = column[np.isfinite(column)] if column.dtype.kind == "f" else column
    with np.errstate(over="ignore"):
        narrow = values.astype(np.float32)
    if not len(values) or np.abs(narrow).max() <= _EXACT or not np.isfinite(narrow).all():
        return None
    counted = column.dtype.kind in "iu" or bool((values == np.floor(values)).all())
    if not counted and not few_steps_in_single(values.min(), values.max()):
        return None
    distinct, first = np.unique(values, return_index=True)
    with np.errstate(over="ignore"):
        same = np.diff(narrow[first]) == 0
    if not same.any():
        return None
    alike = distinct[np.append(False, same) | np.append(same, False)]
    return Merged(np.isin(column, alike), len(distinct), len(distinct) - int(same.sum()), distinct[-1].item())


def few_steps_in_single(low: np.ndarray | np.floating | float, high: np.ndarray | np.floating | float) -> np.ndarray:
    """Whether numbers from `low` to `high` are so far from zero that single precision parts them into too few steps."""
    with np.errstate(over="ignore", invalid="ignore"):
        largest = np.maximum(np.abs(low), np.abs(high)).astype(np.float32)
        steps = (np.asarray(high, np.float64) - low) / np.spacing(largest)
    return np.asarray((largest > _EXACT) & (steps < _FEWEST_STEPS))
