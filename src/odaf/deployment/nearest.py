"""Which logged rows a state and an action are nearest to, and how far that is.

    x = W (z, a),     d(s, a) = min_m | x - x_m |,     W^T W = ( C + e I )^-1

z is the normalised observation, a the action in [-1, 1], C the covariance of both in the log, so that a step that two
columns never take together is a long one. x_m are M rows of the log: half of them drawn at random, for where the log
has been often, and half chosen one after another as the row farthest from those before (Gonzalez 1985), for its rim.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from odaf.data.dataset import Dataset

SPREAD_FLOOR = 1e-2  # e: in directions of less variance than this, distances do not grow any more
CANDIDATES = 20_000  # rows at most that references are chosen from


def whitening(rows: np.ndarray, floor: float = SPREAD_FLOOR) -> np.ndarray:
    """W, symmetric, for rows [N, width]."""
    covariance = np.cov(np.asarray(rows, np.float64), rowvar=False).reshape(rows.shape[1], rows.shape[1])
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / np.sqrt(np.maximum(values, 0.0) + floor)) @ vectors.T


def references(rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers of at most `count` of the rows [N, width], ascending: half at random, half spread out."""
    if len(rows) <= count:
        return np.arange(len(rows))
    candidates = rng.permutation(len(rows))[:CANDIDATES]
    points = np.asarray(rows[candidates], np.float32)
    chosen = list(range((count + 1) // 2))
    distances = KDTree(points[chosen]).query(points)[0].astype(np.float32)
    for _ in range(count - len(chosen)):
        farthest = int(np.argmax(distances))
        chosen.append(farthest)
        distances = np.minimum(distances, np.linalg.norm(points - points[farthest], axis=1))
    return np.sort(candidates[np.unique(chosen)])


@dataclass(frozen=True)
class Neighbour:
    """A logged row.

    Attributes:
        row: its number in the log.
        episode: number of its episode.
        step: its number in the episode.
        distance: d.
        observation: what was seen, in the user's units.
        action: what was done.
        reward: what it earned.
        next_observation: what followed.
        ended: whether the task ended with it.
        rest: sum of the rewards from this row to the end of the episode.
    """

    row: int
    episode: int
    step: int
    distance: float
    observation: np.ndarray
    action: np.ndarray
    reward: float
    next_observation: np.ndarray
    ended: bool
    rest: float


class LoggedRows:
    """The rows of a log, to be asked for those that are nearest.

    Args:
        dataset: the log.
        points: [N, width], x of each of its rows.
    """

    def __init__(self, dataset: Dataset, points: np.ndarray):
        self._dataset, self._tree = dataset, KDTree(points)

    def nearest(self, point: np.ndarray, count: int) -> list[Neighbour]:
        """The `count` rows nearest to x [width], the nearest first."""
        dataset = self._dataset
        wanted: Any = np.arange(1, min(count, len(dataset)) + 1)
        distances, rows = map(np.asarray, self._tree.query(point, k=wanted))
        found = []
        for distance, row in zip(distances.tolist(), rows.tolist(), strict=True):
            episode = int(np.searchsorted(dataset.episode_starts, row, side="right")) - 1
            span = dataset.episode(episode)
            found.append(
                Neighbour(
                    row,
                    episode,
                    row - span.start,
                    distance,
                    dataset.observations[row],
                    dataset.actions[row],
                    float(dataset.rewards[row]),
                    dataset.next_observations[row],
                    bool(dataset.terminated[row]),
                    float(dataset.rewards[row : span.stop].sum(dtype=np.float64)),
                )
            )
        return found
