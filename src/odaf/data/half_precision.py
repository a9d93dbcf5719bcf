"""Data sets rounded to half precision: half the bytes to carry to another machine.

Eleven bits round a number by 1 in 2,048 of itself at most. What is rounded is another data set, with prints of its own;
train on it on both machines, and on neither on what it was made of.
"""

from dataclasses import replace

import numpy as np

from odaf.data import fingerprint
from odaf.data.dataset import Dataset
from odaf.errors import DatasetError

_COARSEST = 0.01  # of a column's spread: more rounding than that is noise that learners would see


def rounded(dataset: Dataset) -> Dataset:
    """The data with observations, actions and rewards that half precision holds; infos are left behind.

    Actions that rounding would put outside of the bounds take the nearest number inside. The provenance names the
    prints of the data that were rounded.

    Raises:
        DatasetError: a column holds numbers beyond half precision (65,504), or varies so little for its size that
            rounding would be more than a hundredth of its spread.
    """
    columns = {name: _half(name, getattr(dataset, name)) for name in ("observations", "next_observations")}
    rewards = _half("rewards", dataset.rewards[:, None])[:, 0]
    actions = _inside(_half("actions", dataset.actions), dataset.action_low, dataset.action_high)
    made = {"precision": "half", "rounded_from": fingerprint.record(dataset)}
    provenance = {**dataset.provenance, **made}
    return replace(dataset, **columns, actions=actions, rewards=rewards, infos={}, provenance=provenance)


def _half(name: str, column: np.ndarray) -> np.ndarray:
    """[rows, width] float32 as half precision holds it."""
    with np.errstate(over="ignore"):
        found = column.astype(np.float16).astype(np.float32)
    if not np.isfinite(found[np.isfinite(column)]).all():
        raise DatasetError(
            f"half precision: {name} hold numbers beyond 65,504, the largest that it can; change the unit, or keep "
            "single precision"
        )
    lost = np.sqrt(np.mean(np.square(found - column, dtype=np.float64), axis=0))
    spread = column.std(axis=0, dtype=np.float64)
    coarse = np.flatnonzero((lost > _COARSEST * spread) & (spread > 0.0))
    if len(coarse):
        raise DatasetError(
            f"half precision: column {coarse[0]} of {name} varies by {spread[coarse[0]]:.3g} around "
            f"{column[:, coarse[0]].mean():.6g}, and rounding moves it by {lost[coarse[0]]:.3g}; subtract an offset, "
            "or keep single precision"
        )
    return found


def _inside(actions: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Rounded actions with those beyond a bound one step of half precision nearer."""
    half = actions.astype(np.float16)
    half = np.where(actions > high, np.nextafter(half, np.float16(-np.inf)), half)
    half = np.where(actions < low, np.nextafter(half, np.float16(np.inf)), half)
    return half.astype(np.float32)
