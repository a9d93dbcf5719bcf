"""Fitted Q drawn toward what the log itself earned, the more so the less the policy acts as the log does.

    D       ~ N( -LOSS u S, ( PRIOR S )^2 )                                what a policy is worth beside the behaviour
    d | D   ~ N( D, s^2 + ( MISS^2 + ( MISS_UNLIKE u )^2 ) S^2 )           what fitted Q says of that

    1 / v = 1 / v_prior + 1 / v_fqe,     m = v ( m_prior / v_prior + d / v_fqe )

d and s are fitted Q's difference from the behaviour and its standard error, u is the share of the policy's actions that
are unlike the log's, and S = sqrt( E G^2 ), of the logged episodes' values G, is the size of what can be won or lost.
Nothing in a log contradicts fitted Q about actions that no one took: of policies far from the log it says much, and its
members may agree on it. So what it says of them is believed less, and a policy of which nothing is known is expected to
lose.

Empirical Bayes (Morris 1983): the four numbers are those by which the true values of policies of known value were most
probable; `odaf reproduce estimates` finds them on its first logs and judges them on others (docs/results/estimates.md).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from odaf.estimation.valuation import Interval

Numbers = float | np.floating | np.ndarray


@dataclass(frozen=True)
class Shrinkage:
    """How far policies of known value lay from their log, and fitted Q from their values; in units of S.

    Attributes:
        loss: what a policy loses that never acts as the log does.
        prior: spread of what policies are worth around that.
        miss: error of fitted Q beyond what its members differ by.
        miss_unlike: the same that comes on top for actions unlike the log's.
    """

    loss: float
    prior: float
    miss: float
    miss_unlike: float


MEASURED = Shrinkage(0.45, 0.33, 0.04, 0.85)
"""On the first logs of `odaf reproduce estimates`, in two digits."""


@dataclass(frozen=True)
class Shrunk:
    """What a policy is worth beside the behaviour.

    Attributes:
        mean: m, in the log's unit of reward.
        error: sqrt( v ).
        weight: of fitted Q, between 0 and 1.
    """

    mean: float
    error: float
    weight: float

    @property
    def better(self) -> float:
        """How probable it is that D is above zero."""
        return float(ndtr(self.mean / self.error)) if self.error > 0.0 else float(self.mean > 0.0)

    def around(self, value: float, confidence: float) -> Interval:
        """The interval of `value` + D."""
        half = float(ndtri(0.5 + confidence / 2.0)) * self.error
        return Interval(value + self.mean, value + self.mean - half, value + self.mean + half)


def shrink(
    difference: Interval,
    behaviour: Interval,
    unlike: float,
    *,
    members: int,
    episodes: int,
    confidence: float,
    by: Shrinkage = MEASURED,
) -> Shrunk:
    """Fitted Q's difference from the behaviour, drawn toward what is known of such policies.

    Args:
        difference: fitted Q's, by `Interval.of_members`, in the log's unit of reward.
        behaviour: what the log's episodes earned, by `Interval.of_resamples`, in the same unit.
        unlike: u, between 0 and 1.
        members: of fitted Q.
        episodes: of the log.
        confidence: of both intervals.
        by: the four numbers.

    Returns:
        What the policy is worth beside the behaviour, in the same unit; as fitted Q says where the log earns nothing,
        and so has no S.
    """
    error, size = error_and_size(difference, behaviour, members, episodes, confidence)
    if size == 0.0:
        return Shrunk(difference.value, error, 1.0)
    mean, error, weight = posterior(difference.value / size, error / size, unlike, by)
    return Shrunk(float(size * mean), float(size * error), float(weight))


def error_and_size(
    difference: Interval, behaviour: Interval, members: int, episodes: int, confidence: float
) -> tuple[float, float]:
    """s and S, from the intervals that `shrink` takes, in their unit."""
    half, own = (0.5 * (each.high - each.low) for each in (difference, behaviour))
    tail = 0.5 + confidence / 2.0
    scatter = own / float(ndtri(tail)) * math.sqrt(episodes)
    return half / float(stdtrit(members - 1, tail)), math.hypot(behaviour.value, scatter)


def posterior(difference: Numbers, error: Numbers, unlike: Numbers, by: Shrinkage) -> tuple[Numbers, Numbers, Numbers]:
    """What is known of D once fitted Q has spoken; in units of S, numbers or arrays of one shape.

    Args:
        difference: d.
        error: s.
        unlike: u.
        by: the four numbers.

    Returns:
        m, sqrt( v ) and the weight of fitted Q.
    """
    expected, prior = -by.loss * unlike, by.prior**2
    said = np.square(error) + by.miss**2 + np.square(by.miss_unlike * unlike)
    weight = prior / (prior + said)
    return expected + weight * (difference - expected), np.sqrt(weight * said), weight
