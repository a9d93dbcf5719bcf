"""How sure a mean is, and a difference between two: spreads, intervals and numbers of seeds for few runs."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from odaf.errors import ConfigError


@dataclass(frozen=True)
class Estimate:
    """A mean with its spread; `low` and `high` bound the interval and are NaN where one value cannot give any.

    Attributes:
        mean: of the values.
        std: standard deviation with divisor n - 1; NaN for one value.
        low: lower end of the interval for the mean.
        high: upper end.
        confidence: share of such intervals that hold the true mean, if the method's assumptions do.
        count: number of values.
    """

    mean: float
    std: float
    low: float
    high: float
    confidence: float
    count: int

    def rescaled(self, zero: float, hundred: float) -> "Estimate":
        """The same estimate on the scale where `zero` is 0 and `hundred` is 100; `std` is scaled, never shifted."""
        factor = 100.0 / (hundred - zero)
        mean, low, high = (factor * (value - zero) for value in (self.mean, self.low, self.high))
        return replace(self, mean=mean, std=factor * self.std, low=low, high=high)

    def __str__(self) -> str:
        if self.count < 2:
            return f"{self.mean:.1f} (one value)"
        return f"{self.mean:.1f} ± {self.std:.1f}, {self.confidence:.0%} interval {self.low:.1f} to {self.high:.1f}"


def t_interval(values: np.ndarray | list[float], confidence: float = 0.95) -> Estimate:
    """Student's interval for the mean: mean ± t * std / sqrt(n), t from n - 1 degrees of freedom.

    Meant for few seeds; exact if the values are normal.

    Raises:
        ConfigError: no values, one that is not finite, or `confidence` outside (0, 1).
    """
    values = _checked(values, confidence)
    mean, std, count = _moments(values)
    low = high = float("nan")
    if count > 1:
        half = _quantile(count - 1, confidence) * std / np.sqrt(count)
        low, high = mean - half, mean + half
    return Estimate(mean, std, float(low), float(high), confidence, count)


def bootstrap_interval(
    values: np.ndarray | list[float], confidence: float = 0.95, *, seed: int = 0, resamples: int = 9999
) -> Estimate:
    """Percentile bootstrap interval for the mean; assumes no shape, and wants more than a handful of values.

    Args:
        values: independent values.
        confidence: in (0, 1).
        seed: of the resampling; equal seeds give equal intervals.
        resamples: how many.

    Raises:
        ConfigError: as `t_interval`.
    """
    values = _checked(values, confidence)
    mean, std, count = _moments(values)
    low = high = float("nan")
    if count > 1:
        from scipy import stats  # takes half a second to load, so only where it is used

        result = stats.bootstrap(
            (values,),
            np.mean,
            confidence_level=confidence,
            n_resamples=resamples,
            method="percentile",
            rng=np.random.default_rng(seed),
        )
        low, high = result.confidence_interval
    return Estimate(mean, std, float(low), float(high), confidence, count)


def paired_difference(
    first: np.ndarray | list[float], second: np.ndarray | list[float], confidence: float = 0.95
) -> Estimate:
    """Student's interval for the mean of `first - second`, where equal places share a seed or a start.

    Pairing takes out what both have in common, so it is narrower than comparing two separate intervals.

    Raises:
        ConfigError: the lengths differ, or as `t_interval`.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if first.shape != second.shape:
        raise ConfigError(
            f"paired difference: {first.size} values against {second.size}; each needs its partner in the same place"
        )
    return t_interval(first - second, confidence)


@dataclass(frozen=True)
class Difference:
    """Difference of two means with its interval; `low` and `high` are NaN where too few values cannot give any.

    Attributes:
        statistic: "paired t" (values that share a seed are subtracted first) or "Welch's t" (two independent samples of
            unequal variance).
        mean: of the first less the mean of the second.
        low: lower end of the interval.
        high: upper end.
        confidence: share of such intervals that hold the true difference, if the values are normal.
        counts: values of the first and of the second.
        enough: the least number of values on either side whose interval would exclude zero, if the means and the
            standard deviations stayed as they are; None where it cannot be said: no spread is known, there is none, or
            the means are equal.
    """

    statistic: str
    mean: float
    low: float
    high: float
    confidence: float
    counts: tuple[int, int]
    enough: int | None

    @property
    def decided(self) -> bool:
        """Whether the interval is known and excludes zero."""
        return self.low > 0.0 or self.high < 0.0


def difference(
    first: np.ndarray | list[float], second: np.ndarray | list[float], *, paired: bool, confidence: float = 0.95
) -> Difference:
    """Difference of two means with Student's interval.

    Paired, equal places share a seed, and the interval is the one of `paired_difference`. Otherwise it is Welch's:
    mean ± t * sqrt(s1^2 / n1 + s2^2 / n2), t from the degrees of freedom of Welch and Satterthwaite.

    Raises:
        ConfigError: the lengths of pairs differ, or as `t_interval`.
    """
    if paired:
        found = paired_difference(first, second, confidence)
        enough = seeds_to_decide(found.mean, [found.std], confidence)
        counts = (found.count, found.count)
        return Difference("paired t", found.mean, found.low, found.high, confidence, counts, enough)
    first, second = _checked(first, confidence), _checked(second, confidence)
    spreads = [_moments(values)[1] for values in (first, second)]
    mean = float(first.mean() - second.mean())
    low = high = float("nan")
    if not any(map(math.isnan, spreads)):
        half = _welch_half(spreads, (len(first), len(second)), confidence)
        low, high = mean - half, mean + half
    enough = seeds_to_decide(mean, spreads, confidence)
    return Difference("Welch's t", mean, low, high, confidence, (len(first), len(second)), enough)


def seeds_to_decide(mean: float, spreads: list[float], confidence: float = 0.95) -> int | None:
    """The least number of seeds a side for which the interval of a difference excludes zero.

    Solved with Student's quantile at each number, as if the difference and the standard deviations stayed as seen. What
    was seen is itself uncertain, so this is an order of magnitude to plan by, not a promise.

    Args:
        mean: the difference.
        spreads: the standard deviation of the paired differences, or one for each of two independent samples.
        confidence: of the interval.

    Returns:
        Two or more; None where it cannot be said: a spread is not known, all are 0, or the difference is 0.
    """
    if not all(map(math.isfinite, [mean, *spreads])) or mean == 0.0 or not any(spreads):
        return None

    def decides(count: int) -> bool:
        if len(spreads) == 1:
            half = _quantile(count - 1, confidence) * spreads[0] / math.sqrt(count)
        else:
            half = _welch_half(spreads, (count, count), confidence)
        return half < abs(mean)

    high = 2
    while not decides(high):
        if high > 10**12:  # a difference that is rounding beside its spread
            return None
        high *= 2
    low = max(high // 2, 1)  # does not decide, or is below the least number
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if decides(middle) else (middle, high)
    return high


@dataclass(frozen=True)
class Improvement:
    """Probability that a value of the first exceeds one of the second, ties counting half, with its interval.

    `low` and `high` are NaN where a side has one value.
    """

    probability: float
    low: float
    high: float
    confidence: float


def improvement(
    first: np.ndarray | list[float],
    second: np.ndarray | list[float],
    confidence: float = 0.95,
    *,
    seed: int = 0,
    resamples: int = 9999,
) -> Improvement:
    """P(X > Y) + P(X = Y) / 2 over all pairs of a value of each side: Mann and Whitney's U, divided by the pairs.

    The interval is the percentile bootstrap, which resamples the values of each side on their own. It knows no values
    but those it was given: where every value of one side exceeds all of the other, it says 1 to 1, however few.

    Args:
        first: values of X, such as the seeds' means of a run.
        second: values of Y.
        confidence: in (0, 1).
        seed: of the resampling; equal seeds give equal intervals.
        resamples: how many.

    Raises:
        ConfigError: as `t_interval`.
    """
    first, second = _checked(first, confidence), _checked(second, confidence)
    from scipy import stats  # takes half a second to load, so only where it is used

    probability = float(_superiority(first, second))
    low = high = float("nan")
    if len(first) > 1 and len(second) > 1:
        result = stats.bootstrap(
            (first, second),
            _superiority,
            confidence_level=confidence,
            n_resamples=resamples,
            method="percentile",
            vectorized=True,
            batch=max(1_000_000 // (len(first) * len(second)), 1),
            rng=np.random.default_rng(seed),
        )
        low, high = result.confidence_interval
    return Improvement(probability, float(low), float(high), confidence)


def interquartile_mean(values: np.ndarray | list[float]) -> float:
    """Mean of the middle half: a quarter of the values, rounded down, is left out at each end.

    Raises:
        ConfigError: no values, or one that is not finite.
    """
    from scipy import stats

    return float(stats.trim_mean(_checked(values, 0.95), 0.25))


def _superiority(first: np.ndarray, second: np.ndarray, axis: int = -1) -> np.ndarray:
    """Share of pairs in which the first is greater, ties half, along the last axis of both."""
    del axis
    return np.asarray(np.sign(first[..., :, None] - second[..., None, :]).mean(axis=(-2, -1)) / 2 + 0.5)


def _quantile(freedom: float, confidence: float) -> float:
    return float(stdtrit(freedom, 0.5 + confidence / 2))


def _welch_half(spreads: list[float], counts: tuple[int, int], confidence: float) -> float:
    """Half the width of Welch's interval for a difference of two means."""
    parts = [spread**2 / count for spread, count in zip(spreads, counts, strict=True)]
    total = sum(parts)
    if total == 0.0:
        return 0.0
    # In shares of the total, so that small spreads do not underflow.
    freedom = 1.0 / sum((part / total) ** 2 / (count - 1) for part, count in zip(parts, counts, strict=True))
    return _quantile(freedom, confidence) * math.sqrt(total)


def _checked(values: np.ndarray | list[float], confidence: float) -> np.ndarray:
    values = np.asarray(values, np.float64)
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all():
        raise ConfigError(f"interval: expected one or more finite numbers in a row, got {values.tolist()}")
    if not 0.0 < confidence < 1.0:
        raise ConfigError(f"confidence: must lie between 0 and 1, got {confidence}")
    return values


def _moments(values: np.ndarray) -> tuple[float, float, int]:
    count = len(values)
    return float(values.mean()), float(values.std(ddof=1)) if count > 1 else float("nan"), count
