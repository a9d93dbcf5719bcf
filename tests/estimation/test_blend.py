"""Weights of a blend, by hand."""

import numpy as np
import pytest

from odaf.estimation.blend import blend, weights_of

SURE = np.array([10.0, 9.0, 11.0])  # squared spread 2
WILD = np.array([-500.0, -600.0, -400.0])  # 20,000


def test_weights_are_of_squared_spread_and_miss():
    np.testing.assert_allclose(weights_of([SURE, WILD], [0.0, 0.0]), np.array([1e4, 1.0]) / 10_001)
    np.testing.assert_allclose(weights_of([SURE, SURE], [2.0, 0.0]), [0.25, 0.75])
    np.testing.assert_allclose(weights_of([SURE], [7.0]), [1.0])


def test_one_that_is_exact_by_chance_takes_all_and_two_such_share():
    np.testing.assert_allclose(weights_of([np.zeros(3), SURE], [0.0, 0.0]), [1.0, 0.0], atol=1e-11)
    np.testing.assert_allclose(weights_of([np.zeros(3), np.ones(3)], [0.0, 0.0]), [0.5, 0.5])


def test_equal_weights_give_the_mean_and_half_the_difference():
    mean, apart = blend([SURE, SURE + 6.0], np.array([0.5, 0.5]))
    np.testing.assert_allclose(mean, SURE + 3.0)
    assert apart == pytest.approx(3.0)


def test_a_wild_estimate_moves_the_blend_little():
    mean, apart = blend([SURE, WILD], weights_of([SURE, WILD], [0.0, 0.0]))
    assert mean[0] == pytest.approx(10.0, abs=0.1) and apart == pytest.approx(5.1, abs=0.1)
