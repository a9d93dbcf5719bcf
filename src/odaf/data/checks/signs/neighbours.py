"""Rows of other episodes that lie nearest, in units of each column's spread."""

import numpy as np

from odaf.data.checks.sample import Sample

CHUNK = 128  # rows whose distances to all others are held at once


def scaled(sample: Sample) -> np.ndarray:
    """[rows, columns] float32 of the columns that vary, divided by their spread between the 5th and 95th percentile
    (or the plain spread where that is zero)."""
    values = sample.observations
    low, high = np.quantile(values, [0.05, 0.95], axis=0)
    spread = np.where(high > low, (high - low) / 3.3, values.std(axis=0))
    moving = spread > 0
    return ((values[:, moving] - np.median(values[:, moving], axis=0)) / spread[moving]).astype(np.float32)


def thinned(rows: int, most: int) -> np.ndarray:
    """At most so many places among so many rows, spread evenly."""
    return np.unique(np.linspace(0, rows - 1, min(rows, most)).astype(np.int64))


def nearest(
    points: np.ndarray, group: np.ndarray, queries: np.ndarray, references: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """([queries, count] places in `references`, [queries, count] distances), nearest first, never of the same group.

    Args:
        points: [rows, columns].
        group: [rows] what rows of one group must not be compared within.
        queries: rows to look from.
        references: rows to look at.
    """
    targets, squares = points[references], np.square(points[references]).sum(axis=1)
    places, distances = [], []
    for start in range(0, len(queries), CHUNK):
        chosen = queries[start : start + CHUNK]
        apart = squares - 2 * points[chosen] @ targets.T + np.square(points[chosen]).sum(axis=1)[:, None]
        apart[group[chosen][:, None] == group[references][None]] = np.inf
        near = np.empty((len(chosen), count), np.int64)
        found = np.empty((len(chosen), count), apart.dtype)
        for rank in range(count):  # faster than argpartition for so few, and nearest first
            near[:, rank] = np.argmin(apart, axis=1)
            found[:, rank] = np.take_along_axis(apart, near[:, rank : rank + 1], axis=1)[:, 0]
            np.put_along_axis(apart, near[:, rank : rank + 1], np.inf, axis=1)
        places.append(near)
        distances.append(np.sqrt(np.maximum(found, 0.0)))
    return np.concatenate(places), np.concatenate(distances)
