"""V of first observations: against a ridge regression that really leaves each episode out, and where none is known."""

import numpy as np
import pytest

from odaf.data.start_values import RIDGES, start_values


def _ridge(rows, returns, ridge, episodes):
    """(intercept, slopes) by the normal equations; `episodes` scales the ridge."""
    wide = np.column_stack([np.ones(len(rows)), rows])
    if np.isinf(ridge):
        return np.append(returns.mean(), np.zeros(rows.shape[1]))
    penalty = episodes * ridge * np.eye(wide.shape[1])
    penalty[0, 0] = 0.0
    return np.linalg.solve(wide.T @ wide + penalty, wide.T @ returns)


@pytest.mark.parametrize(("episodes", "columns", "signal"), [(25, 4, 1.0), (30, 10, 2.0), (40, 60, 6.0)])
def test_the_ridge_is_that_which_foretells_left_out_episodes_best(episodes, columns, signal):
    rng = np.random.default_rng(columns)
    starts = rng.normal(3.0, 50.0, (episodes, columns))
    returns = signal * starts[:, 0] / 50.0 + rng.normal(size=episodes)
    rows = (starts - starts.mean(axis=0)) / starts.std(axis=0)
    errors = []
    for ridge in RIDGES:
        misses = []
        for out in range(episodes):
            kept = np.arange(episodes) != out
            found = _ridge(rows[kept], returns[kept], ridge, episodes)
            misses.append(returns[out] - found[0] - rows[out] @ found[1:])
        errors.append(np.mean(np.square(misses)))
    best = int(np.argmin(errors))
    found = _ridge(rows, returns, RIDGES[best], episodes)
    got = start_values(returns, starts)
    assert 0 < best < len(RIDGES) - 1
    np.testing.assert_allclose(got.values, found[0] + rows @ found[1:], rtol=1e-7, atol=1e-9)
    assert got.explained == pytest.approx(1.0 - errors[best] / errors[0], abs=1e-6)


@pytest.mark.parametrize(("episodes", "columns"), [(12, 60), (30, 25), (200, 5)])
def test_starts_that_say_nothing_are_seldom_believed(episodes, columns):
    """Of 200 logs of noise, at most one in twenty; the lucky ridge alone is better than the mean in far more."""
    rng = np.random.default_rng(7)
    believed = [
        start_values(rng.normal(size=episodes), rng.normal(size=(episodes, columns))).explained > 0.0
        for _ in range(200)
    ]
    assert np.mean(believed) <= 0.05


def test_a_line_is_found_to_the_last_digits_in_any_units():
    x = np.linspace(0.0, 1.0, 20)
    got = start_values(1e-4 * x + 7.0, 1e6 * np.stack([x, np.full(20, 3.0)], axis=1))
    np.testing.assert_allclose(got.values - 7.0, 1e-4 * x, atol=1e-9)
    assert got.explained > 0.999999


@pytest.mark.parametrize(
    ("returns", "starts"),
    [
        ([5.0], [[1.0]]),
        ([5.0, 1.0], [[1.0], [2.0]]),
        ([5.0, 1.0, 2.0, 8.0], [[0.1], [0.1], [0.1], [0.1]]),
        ([5.0, 1.0, 2.0, 8.0], np.zeros((4, 0))),
        ([3.0, 3.0, 3.0, 3.0], [[1.0], [2.0], [3.0], [5.0]]),
    ],
)
def test_where_nothing_can_be_said_the_value_is_the_mean(returns, starts):
    got = start_values(np.array(returns), np.array(starts))
    np.testing.assert_allclose(got.values, np.mean(returns), rtol=1e-12)
    assert got.explained == 0.0


def test_columns_that_are_copies_of_each_other_are_one():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(50, 1))
    returns = x[:, 0] + 0.3 * rng.normal(size=50)
    single, copies = start_values(returns, x), start_values(returns, np.repeat(x, 3, axis=1))
    assert single.explained == pytest.approx(copies.explained, abs=2e-3)
    np.testing.assert_allclose(single.values, copies.values, atol=0.05)
