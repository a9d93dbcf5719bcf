"""Which episodes can be compared, by what, and where the best of them part from the rest."""

from dataclasses import dataclass

import numpy as np

from odaf.data.summary import fragments

FEWEST = 5
MUCH_LONGER = 1.5
"""Of lengths that the recording decided, nine tenths over one tenth: above it returns tell how long it ran."""
FEWEST_COMPARED, FEWEST_GOOD = 20, 3
LEAST_ROWS, MOST_GOOD = 0.01, 0.2
"""Share of the rows that a better part is worth speaking of, and of rows and episodes that are still few."""
FAR_BETTER = 4.0
"""Spreads of the other episodes' returns that the worst good one lies above their mean; of 1,000 episodes whose returns
are normally distributed the third best, where good ones begin, lies at 2.9."""
LEAST_SPREAD = 1e-4
"""Of the other episodes, as a share of the whole range, such as that of returns that are all 0."""
ROUNDING = 1e-9
"""Of the size of merits: less apart they differ by the order in which rewards were summed."""


@dataclass(frozen=True, eq=False)
class Merits:
    """What episodes are compared by.

    Attributes:
        values: [episodes] return, or return per step.
        whole: [episodes] bool: no fragment of an episode.
        per_step: which of the two.
    """

    values: np.ndarray
    whole: np.ndarray
    per_step: bool


@dataclass(frozen=True)
class Parting:
    """The best episodes, set apart from the rest.

    Attributes:
        episodes: how many are good.
        rows: share of the rows that they hold.
        least: merit of the worst good one, in units of the reward.
        distance: how far that lies above the mean of the rest, in spreads of the rest.
    """

    episodes: int
    rows: float
    least: float
    distance: float


def compared(returns: np.ndarray, lengths: np.ndarray, terminated: np.ndarray) -> Merits:
    """By return; by return per step where the recorder decided how long episodes are, and made them differ.

    Args:
        returns: [episodes] sums of rewards.
        lengths: [episodes] steps.
        terminated: [episodes] whether the task ended the episode.
    """
    whole = ~fragments(lengths, terminated > 0)
    cut = lengths[whole & (terminated == 0)]
    per_step = len(cut) >= FEWEST and bool(np.quantile(cut, 0.9) > MUCH_LONGER * np.quantile(cut, 0.1))
    return Merits(returns / lengths if per_step else returns, whole, per_step)


def equal(merits: np.ndarray) -> bool:
    """Whether no episode is better than another, but for rounding."""
    return bool(np.ptp(merits) <= ROUNDING * np.abs(merits).max())


def part(
    merits: np.ndarray, lengths: np.ndarray, most: float = MOST_GOOD, distance: float = FAR_BETTER
) -> Parting | None:
    """Of all ways to part the episodes into the best few and the rest, that whose worst good one lies farthest above
    the mean of the rest, in spreads of the rest; None where that is not far.

    Args:
        merits: [episodes] of whole episodes.
        lengths: [episodes] steps.
        most: share of the episodes, and of the rows, that the good ones may be.
        distance: what is far, in spreads of the rest.
    """
    order = np.argsort(-merits, kind="stable")
    best, rows = merits[order], np.cumsum(lengths[order])
    count = len(best)
    if count < FEWEST_COMPARED or equal(merits):
        return None
    few = np.arange(1, count)  # how many are good
    shares = rows[:-1] / rows[-1]
    centred = (best - best[-1]) / (best[0] - best[-1])
    below = np.cumsum(centred[::-1])[::-1][1:] / (count - few)
    squares = np.cumsum(np.square(centred)[::-1])[::-1][1:] / (count - few)
    spread = np.sqrt(np.maximum(squares - np.square(below), LEAST_SPREAD**2))
    apart = np.where(
        (few >= FEWEST_GOOD) & (few <= most * count) & (shares >= LEAST_ROWS) & (shares <= most),
        (centred[:-1] - below) / spread,
        0.0,
    )
    place = int(np.argmax(apart))
    if apart[place] < distance:
        return None
    return Parting(int(few[place]), float(shares[place]), float(best[place]), float(apart[place]))
