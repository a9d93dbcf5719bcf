"""How far episodes differ in what they earn a row, whatever the unit of the reward."""

import numpy as np
from jaxtyping import Float


def between_episodes(
    returns: Float[np.ndarray, " episodes"], lengths: Float[np.ndarray, " episodes"], reward_variance: float
) -> float:
    """Share of the variance of rewards, over all rows, that lies between episodes instead of within them; 0 where
    rewards do not vary."""
    if not reward_variance > 0.0:
        return 0.0
    apart = (lengths * np.square(returns / lengths - returns.sum() / lengths.sum())).sum() / lengths.sum()
    return min(float(apart) / reward_variance, 1.0)
