"""The two directions along which observations spread most."""

from dataclasses import dataclass

import numpy as np

from odaf.data import Dataset
from odaf.data.summary import fragments

FIT_ROWS, DRAWN_ROWS = 50_000, 2_500
GOOD_SHARE = 0.1


@dataclass(frozen=True)
class Coverage:
    """Observations in the plane of the first two principal components of their normalised columns.

    Attributes:
        points: [rows, 2] some rows, drawn evenly over the log.
        rows: [rows] their numbers in the log.
        good: [rows] whether the row's episode is among the best tenth by return.
        explained: share of the total variance along each of the two axes.
        leading: for each axis, the names of the columns that weigh most in it.
    """

    points: np.ndarray
    rows: np.ndarray
    good: np.ndarray
    explained: tuple[float, float]
    leading: tuple[tuple[str, ...], tuple[str, ...]]


def coverage(dataset: Dataset) -> Coverage | None:
    """None where fewer than two columns vary, so that there is no plane."""
    rows = np.unique(np.linspace(0, len(dataset) - 1, FIT_ROWS).astype(np.int64))
    values = dataset.observations[rows].astype(np.float64)
    spread = values.std(axis=0)
    moving = np.flatnonzero(spread > 0)
    if len(moving) < 2 or len(rows) < 3:
        return None
    scaled = (values[:, moving] - values[:, moving].mean(axis=0)) / spread[moving]
    variances, axes = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    axes = axes[:, ::-1][:, :2]
    # The sign of an axis is arbitrary; its heaviest column points to the right and up.
    heaviest = np.abs(axes).argmax(axis=0)
    axes = axes * np.sign(axes[heaviest, [0, 1]])
    explained = variances[::-1][:2] / variances.sum()
    names = [dataset.observation_names[column] for column in moving]
    leading = [tuple(names[place] for place in np.argsort(-np.abs(axes[:, axis]))[:3]) for axis in (0, 1)]
    chosen = np.unique(np.linspace(0, len(rows) - 1, DRAWN_ROWS).astype(np.int64))
    return Coverage(
        points=scaled[chosen] @ axes,
        rows=rows[chosen],
        good=_in_good_episodes(dataset, rows[chosen]),
        explained=(float(explained[0]), float(explained[1])),
        leading=(leading[0], leading[1]),
    )


def _in_good_episodes(dataset: Dataset, rows: np.ndarray) -> np.ndarray:
    lengths = dataset.episode_lengths()
    short = fragments(lengths, dataset.terminated[dataset.episode_starts + lengths - 1])
    returns = np.where(short, -np.inf, dataset.episode_returns())
    best = np.argsort(-returns, kind="stable")[: max(1, round(GOOD_SHARE * len(returns)))]
    return np.isin(np.searchsorted(dataset.episode_starts, rows, side="right") - 1, best)
