"""Statistics over several tasks, each with a few seeds: what a table of scores says as a whole.

Scores are put on one scale before they come here, such as normalised scores. The bootstrap is stratified: it draws
seeds anew within each task and keeps the tasks, so an interval is about other seeds of these tasks and not about other
tasks. Source: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice".
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from odaf.errors import ConfigError
from odaf.evaluation.statistics import Estimate, Improvement

Scores = Mapping[str, Sequence[float]]
"""By task, one score a seed."""


def interquartile_mean_over_tasks(
    scores: Scores, confidence: float = 0.95, *, seed: int = 0, resamples: int = 2_000
) -> Estimate:
    """Interquartile mean of all runs of all tasks; its interval by the stratified bootstrap.

    Raises:
        ConfigError: no tasks, a task without scores, or one that is not finite.
    """
    values = [_checked(task, each) for task, each in _tasks(scores).items()]
    low, high = _interval(values, lambda drawn: _middle(np.concatenate(drawn)), confidence, seed, resamples)
    every = np.concatenate(values)
    std = float(every.std(ddof=1)) if every.size > 1 else float("nan")
    return Estimate(_middle(every), std, low, high, confidence, every.size)


def improvement_over_tasks(
    first: Scores, second: Scores, confidence: float = 0.95, *, seed: int = 0, resamples: int = 2_000
) -> Improvement:
    """P(X > Y) + P(X = Y) / 2 of a run of each side on the same task, the mean over tasks; by stratified bootstrap.

    Raises:
        ConfigError: the two have different tasks, or as `interquartile_mean_over_tasks`.
    """
    if set(first) != set(second):
        raise ConfigError(f"improvement: the tasks {sorted(set(first) ^ set(second))} are on one side only; give both")
    ours, theirs = ([_checked(task, side[task]) for task in _tasks(first)] for side in (first, second))

    def mean(drawn: Sequence[np.ndarray]) -> float:
        pairs = zip(drawn[: len(ours)], drawn[len(ours) :], strict=True)
        return float(np.mean([0.5 + 0.5 * np.sign(a[:, None] - b[None, :]).mean() for a, b in pairs]))

    low, high = _interval([*ours, *theirs], mean, confidence, seed, resamples)
    return Improvement(mean([*ours, *theirs]), low, high, confidence)


def performance_profile(
    scores: Scores, heights: Sequence[float], confidence: float = 0.95, *, seed: int = 0, resamples: int = 2_000
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of runs above each height, every task counting alike, with a pointwise band by stratified bootstrap.

    Returns:
        Shares [heights], and the lower and upper ends of their band.

    Raises:
        ConfigError: as `interquartile_mean_over_tasks`.
    """
    values, levels = [_checked(task, each) for task, each in _tasks(scores).items()], np.asarray(heights, np.float64)

    def shares(drawn: Sequence[np.ndarray]) -> np.ndarray:
        return np.mean([(each[:, None] > levels[None, :]).mean(axis=0) for each in drawn], axis=0)

    low, high = _band(values, shares, confidence, seed, resamples)
    return shares(values), low, high


def probability_of_gain(
    first: Scores, second: Scores, *, seed: int = 0, resamples: int = 9_999
) -> tuple[float, Mapping[str, float]]:
    """The share of resamples of the tasks in which the first has the higher mean, and the difference on each task.

    The paired bootstrap over tasks: a task is drawn with both its sides, so the answer is about other tasks like these.

    Raises:
        ConfigError: as `improvement_over_tasks`.
    """
    if set(first) != set(second):
        raise ConfigError(f"gain: the tasks {sorted(set(first) ^ set(second))} are on one side only; give both")
    gains = {
        task: float(_checked(task, first[task]).mean() - _checked(task, second[task]).mean()) for task in _tasks(first)
    }
    values = np.array(list(gains.values()))
    drawn = np.random.default_rng(seed).integers(0, len(values), (resamples, len(values)))
    means = values[drawn].mean(axis=1)
    return float((means > 0).mean() + 0.5 * (means == 0).mean()), gains


def _middle(values: np.ndarray) -> float:
    """Mean of the middle half, as `interquartile_mean`; called too often for that one's checks."""
    outside = len(values) // 4
    return float(np.sort(values)[outside : len(values) - outside].mean())


def _interval(
    values: Sequence[np.ndarray],
    statistic: Callable[[Sequence[np.ndarray]], float],
    confidence: float,
    seed: int,
    resamples: int,
) -> tuple[float, float]:
    low, high = _band(values, lambda drawn: np.asarray(statistic(drawn)), confidence, seed, resamples)
    return float(low), float(high)


def _band(
    values: Sequence[np.ndarray],
    statistic: Callable[[Sequence[np.ndarray]], np.ndarray],
    confidence: float,
    seed: int,
    resamples: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Percentiles of the statistic over resamples within each array; NaN where no array has two values."""
    if all(len(each) < 2 for each in values):
        nothing = np.full_like(statistic(values), np.nan)
        return nothing, nothing
    random = np.random.default_rng(seed)
    found = [statistic([each[random.integers(0, len(each), len(each))] for each in values]) for _ in range(resamples)]
    low, high = np.quantile(np.array(found), [0.5 - confidence / 2, 0.5 + confidence / 2], axis=0)
    return np.asarray(low), np.asarray(high)


def _tasks(scores: Scores) -> dict[str, Sequence[float]]:
    if not scores:
        raise ConfigError("scores: expected one or more tasks, got none")
    return dict(sorted(scores.items()))


def _checked(task: str, values: Sequence[float]) -> np.ndarray:
    found = np.asarray(values, np.float64)
    if found.ndim != 1 or found.size == 0 or not np.isfinite(found).all():
        raise ConfigError(f"scores of {task}: expected one or more finite numbers, got {list(values)}")
    return found
