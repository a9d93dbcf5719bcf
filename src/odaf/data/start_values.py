"""What the first observation of an episode already says of its return, by a linear regression over the episodes.

    V(s_0) = m + w . z(s_0),        min over m, w of  sum_e (G_e - V(s_0 of e))^2 + E ridge ||w||^2

z divides each column by its spread over the first observations. With few episodes and many columns least squares would
explain every return and leave none to compare. So the ridge is the one, of a row of them, whose error is smallest when
each episode is foretold from the others, and V is the mean return unless that foretells them surely better.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

RIDGES = (np.inf, *10.0 ** np.arange(4.0, -11.0, -1.0))
"""What is tried, the strongest first, with which V is the mean; of equally good ones the strongest is taken."""
SURE = 2.0
"""Standard errors by which an episode's squared error has to fall on average for V to be more than the mean."""
FEWEST = 3
"""Episodes below which no slope can be judged: two others determine a line, one does not."""


class StartValues(NamedTuple):
    """V of each episode's first observation, and what it is worth."""

    values: Float[np.ndarray, " episodes"]
    explained: float  # share of the returns' variance that V foretells of episodes left out; 0 where V is the mean


def start_values(returns: Float[np.ndarray, " episodes"], starts: Float[np.ndarray, "episodes obs_dim"]) -> StartValues:
    """V(s_0) of each episode.

    Args:
        returns: G, finite.
        starts: s_0, in any units; columns that never change say nothing.
    """
    returns = np.asarray(returns, np.float64)
    mean = np.full(len(returns), returns.mean())
    columns = np.asarray(starts, np.float64)
    columns = columns - columns.mean(axis=0)
    spread = columns.std(axis=0)
    varies = spread > 1e-9 * np.abs(starts).max(axis=0, initial=0.0)  # else only the mean's rounding
    if len(returns) < FEWEST or not varies.any():
        return StartValues(mean, 0.0)
    left, sizes, _ = np.linalg.svd(columns[:, varies] / spread[varies], full_matrices=False)
    off = returns - mean
    along = left.T @ off
    misses, fits = [], []
    for ridge in RIDGES:
        kept = np.square(sizes) / (np.square(sizes) + len(returns) * ridge)
        fit = left @ (kept * along)
        own = 1.0 / len(returns) + np.square(left) @ kept  # the weight of an episode's return in its own V
        misses.append(np.square((off - fit) / (1.0 - own)))
        fits.append(fit)
    errors = np.mean(misses, axis=1)
    best = int(np.argmax(errors <= errors.min() * (1.0 + 1e-9)))
    gain = misses[0] - misses[best]
    if gain.mean() <= SURE * gain.std() / np.sqrt(len(returns)):
        return StartValues(mean, 0.0)
    return StartValues(mean + fits[best], float(1.0 - errors[best] / errors[0]))
