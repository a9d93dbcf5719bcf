"""The discounted return that followed each logged row."""

import numpy as np
from jaxtyping import Float

from odaf.data.dataset import Dataset


def returns_to_go(dataset: Dataset, discount: float) -> Float[np.ndarray, " rows"]:
    """G of every row, in the units of the rewards.

    An episode that was cut, by a time limit or by the end of the log, is taken to go on earning the mean reward of its
    rows; one that truly ended earns nothing more.
    """
    from scipy.signal import lfilter  # takes a second to load, so only where it is used

    found = np.empty(len(dataset), np.float64)
    for index in range(dataset.num_episodes):
        rows = dataset.episode(index)
        rewards = dataset.rewards[rows].astype(np.float64)
        rest = 0.0 if dataset.terminated[rows][-1] else rewards.mean() / (1.0 - discount)
        backwards, _ = lfilter([1.0], [1.0, -discount], rewards[::-1], zi=[discount * rest])
        found[rows] = backwards[::-1]
    return found.astype(np.float32)
