"""How good an estimator is: its ranking of policies, what its choice costs, its error, and what its intervals hold.

    Spearman    correlation of the ranks of estimates and of true values
    regret@1    ( best true value - true value of the policy that is estimated highest ) / | best true value |
    error       mean | estimate - true value | / spread,     spread = highest - lowest true value
    coverage    share of intervals that hold the true value;     width: their mean width / spread
    interval score      mean ( width + 40 distance of the true value from the interval ) / spread

(Fu et al. 2021, the benchmark DOPE; the last one, of 95 % intervals, where 40 = 2 / 0.05: Gneiting and Raftery 2007.
It is lowest for intervals that are narrow and hold their share.) Estimates are NaN where an estimator had no answer;
such policies are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

PENALTY = 2.0 / 0.05  # of an interval that misses
FEWEST = 3  # policies that a ranking is made of


@dataclass(frozen=True)
class Estimated:
    """What one estimator said of the policies of one data set.

    Attributes:
        values: [policies].
        low: [policies], ends of the intervals.
        high: [policies].
        truth: [policies].
        names: of the policies; may be left out.
    """

    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    truth: np.ndarray
    names: tuple[str, ...] = ()

    @property
    def known(self) -> np.ndarray:
        """[policies] bool, those with an answer and an interval."""
        return np.isfinite(self.values) & np.isfinite(self.low) & np.isfinite(self.high)

    @property
    def spread(self) -> float:
        """Of the true values."""
        return float(np.ptp(self.truth))

    def widened(self, factor: float) -> "Estimated":
        """The same with intervals that reach further from the estimate by this factor."""
        low, high = (self.values + factor * (end - self.values) for end in (self.low, self.high))
        return Estimated(self.values, low, high, self.truth, self.names)

    def without(self, name: str) -> "Estimated":
        """The same of all policies but one."""
        kept = [place for place, each in enumerate(self.names) if each != name]
        names = tuple(self.names[place] for place in kept)
        return Estimated(self.values[kept], self.low[kept], self.high[kept], self.truth[kept], names)


@dataclass(frozen=True)
class Score:
    """The figures of an estimator over data sets; NaN where there is no answer. `answered` is a share of policies."""

    spearman: float
    regret_at_1: float
    mean_absolute_error: float
    coverage: float
    width: float
    answered: float
    interval_score: float


def score(sets: Sequence[Estimated]) -> Score:
    """Means over data sets; coverage and width over all pairs of policy and data set."""
    rankings = [ranking(each) for each in sets]
    regrets = [regret(each) for each in sets]
    errors, widths, held, known, scored = [], [], [], [], []
    for each in sets:
        there = each.known
        known.append(there)
        errors.append(np.abs(each.values - each.truth)[there] / each.spread)
        widths.append((each.high - each.low)[there] / each.spread)
        held.append(((each.low <= each.truth) & (each.truth <= each.high))[there])
        outside = np.maximum(np.maximum(each.low - each.truth, each.truth - each.high), 0.0)[there]
        scored.append(widths[-1] + PENALTY * outside / each.spread)
    return Score(
        _mean(rankings),
        _mean(regrets),
        _mean(np.concatenate(errors)),
        _mean(np.concatenate(held)),
        _mean(np.concatenate(widths)),
        _mean(np.concatenate(known)),
        _mean(np.concatenate(scored)),
    )


def ranking(each: Estimated) -> float:
    """Spearman's rank correlation; NaN for fewer than three answers, or where all are equal."""
    from scipy.stats import rankdata

    there = np.isfinite(each.values)
    if there.sum() < FEWEST:
        return float("nan")
    ranks = [rankdata(column[there]) for column in (each.values, each.truth)]
    if min(np.ptp(column) for column in ranks) == 0.0:
        return float("nan")
    return float(np.corrcoef(*ranks)[0, 1])


def regret(each: Estimated) -> float:
    """Regret@1; NaN without an answer."""
    if not np.isfinite(each.values).any():
        return float("nan")
    best = float(each.truth.max())
    return (best - float(each.truth[int(np.nanargmax(each.values))])) / abs(best)


def widening(sets: Sequence[Estimated], confidence: float) -> float:
    """The factor by which intervals must be wider to hold this share of the true values of these data sets.

    It is the k-th smallest | truth - estimate | / half the width, k = ceil( confidence (n + 1) ) at most n.
    """
    ratios = []
    for each in sets:
        ends = np.where(each.truth < each.values, each.values - each.low, each.high - each.values)
        ratios.append((np.abs(each.truth - each.values) / np.maximum(ends, 1e-12))[each.known])
    found = np.sort(np.concatenate(ratios))
    if not len(found):
        return float("nan")
    place = min(int(np.ceil(confidence * (len(found) + 1))), len(found))
    return float(found[place - 1])


def _mean(values: np.ndarray | Sequence[float]) -> float:
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    return float(known.mean()) if len(known) else float("nan")
