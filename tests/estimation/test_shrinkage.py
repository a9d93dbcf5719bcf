"""Fitted Q drawn toward the log's own value, by hand; and the numbers that are found where they are known."""

import math

import numpy as np
import pytest

from odaf.estimation.shrinkage import Shrinkage, posterior, shrink
from odaf.estimation.valuation import Interval

BY = Shrinkage(loss=0.5, prior=0.3, miss=0.1, miss_unlike=0.4)
T_975_7, Z_975 = 2.3646, 1.9600  # quantiles for eight members, and the normal one


def shrunk(difference: float, error: float, unlike: float, own: float = 8.0, scatter: float = 6.0, episodes: int = 9):
    """Of intervals with these standard errors; S = 10."""
    half = Z_975 * scatter / math.sqrt(episodes)
    return shrink(
        Interval(difference, difference - T_975_7 * error, difference + T_975_7 * error),
        Interval(own, own - half, own + half),
        unlike,
        members=8,
        episodes=episodes,
        confidence=0.95,
        by=BY,
    )


def test_both_sources_are_weighed_by_their_precision():
    # In units of S = sqrt(8^2 + 6^2) = 10: prior -0.25 with spread 0.3; fitted Q 0.35, 0.2^2 + 0.1^2 + 0.2^2 = 0.09.
    found = shrunk(3.5, 2.0, 0.5)
    assert found.weight == pytest.approx(0.5, rel=1e-4)
    assert found.mean == pytest.approx(10 * (-0.25 + 0.35) / 2, rel=1e-3)
    assert found.error == pytest.approx(10 * math.sqrt(0.09 / 2), rel=1e-3)
    interval = found.around(8.0, 0.95)
    assert interval.value == pytest.approx(8.5, rel=1e-3)
    assert interval.high - interval.value == pytest.approx(Z_975 * found.error, rel=1e-3)
    assert found.better == pytest.approx(0.5940, abs=1e-3)  # Phi( 0.5 / 2.1213 )


def test_what_is_sure_and_like_the_log_is_hardly_moved_and_what_is_unlike_it_is():
    sure = Shrinkage(0.5, 0.3, 0.0, 0.4)
    near, _, weight = posterior(0.7, 0.01, 0.0, sure)
    assert near == pytest.approx(0.7, abs=1e-3) and weight > 0.99
    far, _, _ = posterior(0.7, 0.01, 1.0, sure)
    assert far < 0.0
    falling = posterior(np.full(5, 0.7), np.full(5, 0.1), np.linspace(0.0, 1.0, 5), BY)[0]
    assert np.all(np.diff(falling) < 0.0)


def test_the_unit_of_the_reward_and_the_sign_of_the_value_do_not_matter():
    one, other = shrunk(3.5, 2.0, 0.5), shrunk(3.5, 2.0, 0.5, own=-8.0)
    assert (one.mean, one.error) == (other.mean, other.error)
    thousand = shrunk(3_500.0, 2_000.0, 0.5, own=8_000.0, scatter=6_000.0)
    assert thousand.mean == pytest.approx(1_000 * one.mean) and thousand.error == pytest.approx(1_000 * one.error)


def test_a_log_that_earns_nothing_has_no_unit_to_draw_by():
    found = shrunk(0.2, 0.1, 0.5, own=0.0, scatter=0.0)
    assert found.mean == 0.2 and found.weight == 1.0 and found.error == pytest.approx(0.1, rel=1e-4)
