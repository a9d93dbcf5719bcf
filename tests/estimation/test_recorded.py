"""The behaviour's own value, and importance sampling, by hand."""

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.errors import ConfigError
from odaf.estimation.importance import Weights
from odaf.estimation.recorded import Recorded, check_horizon, resampled, shown_horizon
from odaf.estimation.valuation import Interval

ONCE = np.ones((1, 3))


def log(lengths: list[int], terminated: list[bool], rewards: np.ndarray | None = None) -> Dataset:
    """Episodes of random numbers that end as told; rewards 1, 2, 3 ... within each unless given."""
    rng = np.random.default_rng(0)
    count = sum(lengths)
    last = np.cumsum(lengths) - 1
    ends = np.zeros(count, bool)
    ends[last] = terminated
    cut = np.zeros(count, bool)
    cut[last] = ~np.array(terminated)
    return Dataset.from_arrays(
        rng.normal(size=(count, 2)),
        rng.uniform(-1, 1, (count, 1)),
        np.concatenate([np.arange(1.0, n + 1) for n in lengths]) if rewards is None else rewards,
        rng.normal(size=(count, 2)),
        ends,
        cut,
        action_bounds=(-1.0, 1.0),
    )


def test_without_cuts_the_own_value_is_the_mean_return():
    dataset = log([2, 4, 3], [True, False, True])
    recorded = Recorded.of(dataset, 4, 1.0)
    value, length = recorded.values(ONCE)
    np.testing.assert_allclose(value, dataset.episode_returns().mean())
    np.testing.assert_allclose(length, 3.0)
    assert recorded.complete.all()
    value, _ = Recorded.of(dataset, 4, 0.5).values(ONCE)
    returns = [1 + 1.0, 1 + 1 + 0.75 + 0.5, 1 + 1 + 0.75]
    np.testing.assert_allclose(value, np.mean(returns))
    value, _ = recorded.values(np.array([[2.0, 0.0, 1.0]]))  # of resampled episodes
    np.testing.assert_allclose(value, (3 + 3 + 6) / 3)


def test_a_cut_recording_says_nothing_of_later_steps():
    # Lengths 1 (cut), 3 (cut at the horizon), 2 (ended). At step 1 two run on; one ends there.
    recorded = Recorded.of(log([1, 3, 2], [False, False, True]), 3, 1.0)
    value, length = recorded.values(ONCE)
    np.testing.assert_allclose(value, 1 + 2 + 0.5 * 3)
    np.testing.assert_allclose(length, 1 + 1 + 0.5)
    assert recorded.complete.tolist() == [False, True, True]


def test_the_horizon_that_a_log_shows():
    assert shown_horizon(log([2, 9, 4, 1], [False, True, False, False])) == 2
    assert shown_horizon(log([2, 9], [True, True])) == 9
    with pytest.raises(ConfigError, match="horizon=0 must be at least 1"):
        check_horizon(0, 1.0)
    with pytest.raises(ConfigError, match="discount=0"):
        check_horizon(1, 0.0)


def weighted(ratios: list[list[float]], dataset: Dataset, discount: float = 1.0) -> Weights:
    recorded = Recorded.of(dataset, max(map(len, ratios)), discount)
    table = np.array([[*row, *[1.0] * (recorded.horizon - len(row))] for row in ratios])
    return Weights.of(recorded, np.log(table))


def test_weights_by_hand():
    # Rewards 1, 2 in both episodes of length 2; the third ends after its first step.
    weights = weighted([[2.0, 3.0], [1.0, 0.5], [4.0]], log([2, 2, 1], [False, False, True]), 0.5)
    value, length = weights.whole_episodes(ONCE)  # weights 6, 0.5, 4; returns 2, 2, 1
    np.testing.assert_allclose(value, (6 * 2 + 0.5 * 2 + 4 * 1) / 10.5)
    np.testing.assert_allclose(length, (6 * 1.5 + 0.5 * 1.5 + 4 * 1) / 10.5)
    np.testing.assert_allclose(weights.effective_episodes, 10.5**2 / (36 + 0.25 + 16))
    value, length = weights.per_decision(ONCE)  # at step 0 weights 2, 1, 4, and 4 of 7 end there
    np.testing.assert_allclose(value, 1.0 + 0.5 * (3 / 7) * 2.0)
    np.testing.assert_allclose(length, 1.0 + 0.5 * (3 / 7))


def test_weights_of_long_episodes_neither_overflow_nor_vanish():
    recorded = Recorded.of(log([500, 500], [False, False]), 500, 1.0)
    logs = np.full((2, 500), 30.0)
    weights = Weights.of(recorded, logs)
    np.testing.assert_allclose(weights.effective_episodes, 2.0)
    np.testing.assert_allclose(weights.per_decision(np.ones((1, 2)))[0], 500 * 501 / 2)


def test_doubly_robust_by_hand():
    rng = np.random.default_rng(3)
    lengths, ends = [3, 2, 3, 2], [False, True, True, False]  # the last was cut before the horizon
    weights = weighted([rng.uniform(0.2, 3.0, n).tolist() for n in lengths], log(lengths, ends), 0.9)
    recorded, w = weights.recorded, weights.by_step
    q, v = rng.normal(size=(4, 3)) * recorded.present, np.zeros((4, 4))
    v[:, :3] = rng.normal(size=(4, 3)) * recorded.present
    v[3, 2] = 0.7
    counts = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, 2.0, 1.0, 1.0]])
    for count, found in zip(counts, weights.doubly_robust(counts, recorded.rewards, q, v), strict=True):
        expected = 0.0
        for t in range(4):
            for e in range(4):
                before = count[e] / 4 if t == 0 else count[e] * w[e, t - 1] / np.sum(count * w[:, t - 1])
                expected += 0.9**t * before * v[e, t]
                if t < 3:
                    now = count[e] * w[e, t] / np.sum(count * w[:, t])
                    expected += 0.9**t * now * (recorded.rewards[e, t] - q[e, t])
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_doubly_robust_with_the_right_values_does_not_ask_the_weights():
    # Rewards of 1, 2, 3: with Q = V = what is left, corrections are 0 or cancel, whatever the weights.
    dataset = log([3, 3], [False, False])
    left = np.array([[6.0, 5.0, 3.0]] * 2)
    for ratios in ([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]], [[5.0, 0.1, 3.0], [0.2, 9.0, 1.0]]):
        weights = weighted(ratios, dataset)
        states = np.concatenate([left, np.zeros((2, 1))], axis=1)
        found = weights.doubly_robust(np.ones((1, 2)), weights.recorded.rewards, left, states)
        np.testing.assert_allclose(found, 6.0)


def test_resamples_begin_with_the_log_itself_and_bound_its_mean():
    counts = resampled(40, 500, np.random.default_rng(0))
    assert counts.shape == (501, 40) and (counts[0] == 1).all() and (counts.sum(axis=1) == 40).all()
    values = np.random.default_rng(1).normal(size=40)
    means = counts @ values / 40
    found = Interval.of_resamples(float(means[0]), means[1:], 0.95)
    half = 1.96 * values.std() / np.sqrt(40)
    np.testing.assert_allclose([found.low, found.high], [means[0] - half, means[0] + half], atol=0.06)
