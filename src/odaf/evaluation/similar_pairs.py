"""Pairs of states that are similar and were met in different episodes of a log."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError

NEAR_PERCENTILE = 5.0  # of the distances of random pairs: pairs that are nearer are similar
LAST_SHARE = 0.01  # of an episode, from which no states are drawn


@dataclass(frozen=True)
class Pairs:
    """Rows of a log that are similar, with their distance.

    Attributes:
        rows: [pairs] int64, the states that actions are taken in.
        others: [pairs] int64, the nearest rows of other episodes.
        distances: [pairs] between them, in normalised units.
        threshold: what counts as near.
    """

    rows: np.ndarray
    others: np.ndarray
    distances: np.ndarray
    threshold: float


def similar_pairs(
    dataset: Dataset, normaliser: Normaliser, count: int = 2_000, among: int = 100_000, seed: int = 0
) -> Pairs:
    """Draws states and finds for each the nearest one of other episodes; keeps the pairs that are near.

    Args:
        dataset: the log.
        normaliser: distances are measured in its units.
        count: states drawn; the end of an episode, and rows without a recorded successor, are left out.
        among: at most so many rows are searched.
        seed: of both draws.

    Raises:
        DatasetError: there are fewer than two episodes, or no pair is near.
    """
    if dataset.num_episodes < 2:
        raise DatasetError(f"similar pairs: the log has {dataset.num_episodes} episode; two or more are needed")
    random, lengths = np.random.default_rng(seed), dataset.episode_lengths()
    episode = np.repeat(np.arange(dataset.num_episodes), lengths)
    step = np.arange(len(dataset)) - np.repeat(dataset.episode_starts, lengths)
    usable = step < np.ceil((1.0 - LAST_SHARE) * np.repeat(lengths, lengths))
    usable &= ~(dataset.terminated & np.all(dataset.observations == dataset.next_observations, axis=1))
    states = normaliser.normalise(dataset.observations)
    rows = np.sort(random.permutation(np.flatnonzero(usable))[:count])
    searched = np.sort(random.permutation(np.flatnonzero(usable))[:among])
    a, b = (random.choice(searched, 10_000) for _ in range(2))
    apart = np.linalg.norm(states[a] - states[b], axis=1)[episode[a] != episode[b]]
    threshold = float(np.percentile(apart, NEAR_PERCENTILE))

    tree = KDTree(states[searched])
    others, distances = np.full(len(rows), -1), np.full(len(rows), np.inf)
    wanted = np.arange(len(rows))
    for neighbours in (16, 256, 2_048):  # those of the state's own episode come first, and there may be many
        found, near = tree.query(states[rows[wanted]], k=min(neighbours, len(searched)))
        near = searched[np.atleast_2d(near)]
        foreign = episode[near] != episode[rows[wanted]][:, None]
        first, there = foreign.argmax(axis=1), foreign.any(axis=1)
        place = np.arange(len(wanted))[there], first[there]
        others[wanted[there]], distances[wanted[there]] = near[place], np.atleast_2d(found)[place]
        wanted = wanted[~there]
        if len(wanted) == 0:
            break
    kept = distances < threshold
    if not kept.any():
        raise DatasetError("similar pairs: no state of the log has one of another episode near it; give a larger log")
    return Pairs(rows[kept], others[kept], distances[kept], threshold)
