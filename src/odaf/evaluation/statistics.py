"""How sure a mean is: spreads and intervals for few runs."""

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
        half = float(stdtrit(count - 1, 0.5 + confidence / 2)) * std / np.sqrt(count)
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
