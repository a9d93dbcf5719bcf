"""Intervals against numbers worked by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from odaf.errors import ConfigError
from odaf.evaluation import bootstrap_interval, difference, improvement, paired_difference, t_interval
from odaf.evaluation.statistics import interquartile_mean, seeds_to_decide


def test_t_interval_of_four_values_by_hand():
    # 118, 122, 120, 128: mean 122; squares of deviations 16 + 0 + 4 + 36 = 56; std = sqrt(56 / 3) = 4.320494.
    # t(0.975, 3 degrees) = 3.182446 in any table; half width = 3.182446 * 4.320494 / 2 = 6.874869.
    found = t_interval([118.0, 122.0, 120.0, 128.0])
    assert (found.mean, found.count, found.confidence) == (122.0, 4, 0.95)
    assert found.std == pytest.approx(4.320494, abs=1e-6)
    assert found.low == pytest.approx(122 - 6.874869, abs=1e-4)
    assert found.high == pytest.approx(122 + 6.874869, abs=1e-4)
    # t(0.95, 3 degrees) = 2.353363
    assert t_interval([118.0, 122.0, 120.0, 128.0], 0.9).high == pytest.approx(122 + 2.353363 * 2.160247, abs=1e-4)
    assert str(found) == "122.0 ± 4.3, 95% interval 115.1 to 128.9"


def test_paired_difference_by_hand_ignores_what_pairs_share():
    # Differences 1, 2, 3: mean 2, std 1; t(0.975, 2 degrees) = 4.302653; half width = 4.302653 / sqrt(3) = 2.484138.
    found = paired_difference([101.0, 52.0, 3.0], [100.0, 50.0, 0.0])
    assert (found.mean, found.std) == (2.0, 1.0)
    assert (found.low, found.high) == pytest.approx((2 - 2.484138, 2 + 2.484138), abs=1e-5)
    with pytest.raises(ConfigError, match="3 values against 2"):
        paired_difference([1.0, 2.0, 3.0], [1.0, 2.0])


def test_one_value_has_no_interval():
    for found in (t_interval([5.0]), bootstrap_interval([5.0])):
        assert found.mean == 5.0 and math.isnan(found.std) and math.isnan(found.low) and math.isnan(found.high)
    assert str(t_interval([5.0])) == "5.0 (one value)"


def test_bootstrap_of_two_values_by_hand():
    # Resamples of {0, 1} have means 0, 1/2, 1 with odds 1 : 2 : 1. So 20 % in each tail lies at 0 and 1, 30 % at 1/2.
    assert (bootstrap_interval([0.0, 1.0], 0.6).low, bootstrap_interval([0.0, 1.0], 0.6).high) == (0.0, 1.0)
    assert (bootstrap_interval([0.0, 1.0], 0.4).low, bootstrap_interval([0.0, 1.0], 0.4).high) == (0.5, 0.5)


def test_bootstrap_agrees_with_the_normal_interval_on_many_values_and_repeats_itself():
    values = np.random.default_rng(0).normal(10.0, 2.0, 400)
    found = bootstrap_interval(values, seed=1)
    half = 1.959964 * values.std(ddof=1) / 20
    # The ends of 9,999 resamples scatter by about 1 % of the half width around the normal ones.
    assert found.low == pytest.approx(values.mean() - half, abs=0.05 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.05 * half)
    assert found == bootstrap_interval(values, seed=1) != bootstrap_interval(values, seed=2)


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=8), data=st.data())
def test_order_of_values_does_not_matter(values, data):
    shuffled = data.draw(st.permutations(values))
    first, second = t_interval(values), t_interval(shuffled)
    scale = max(abs(value) for value in values)
    for name in ("mean", "std", "low", "high"):
        assert getattr(first, name) == pytest.approx(getattr(second, name), rel=1e-9, abs=1e-9 * scale)
    assert first.low <= first.mean <= first.high


@pytest.mark.parametrize("values", [[], [1.0, float("nan")], [[1.0, 2.0]]])
def test_bad_values_are_refused(values):
    with pytest.raises(ConfigError, match="finite numbers"):
        t_interval(np.asarray(values))


def test_bad_confidence_is_refused():
    with pytest.raises(ConfigError, match="confidence"):
        t_interval([1.0, 2.0], 95.0)


FIRST, SECOND = [118.0, 122.0, 120.0, 128.0, 131.0], [109.0, 131.0, 96.0]


def test_a_difference_of_independent_seeds_is_welchs():
    found = difference(FIRST, SECOND, paired=False)
    expected = stats.ttest_ind(FIRST, SECOND, equal_var=False).confidence_interval(0.95)
    assert (found.statistic, found.counts) == ("Welch's t", (5, 3))
    assert found.mean == pytest.approx(np.mean(FIRST) - np.mean(SECOND))
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert not found.decided and difference([1e-200, 2e-200], [3.0, 3.0], paired=False).decided


def test_a_difference_of_pairs_takes_out_what_they_share():
    found = difference([101.0, 52.0, 3.0], [100.0, 50.0, 0.0], paired=True)
    expected = stats.ttest_rel([101.0, 52.0, 3.0], [100.0, 50.0, 0.0]).confidence_interval(0.95)
    assert (found.statistic, found.counts, found.mean) == ("paired t", (3, 3), 2.0)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert found.enough == 4  # 4 seeds: 3.182446 / 2 = 1.59 < 2; 3 seeds: 2.48, as above


@pytest.mark.parametrize(("mean", "spreads"), [(3.0, (7.0, 2.0)), (-0.4, (1.0, 30.0)), (5.0, (0.0, 6.0))])
def test_so_many_seeds_decide_and_one_less_does_not(mean, spreads):
    """The test at that many seeds is scipy's, made from means and standard deviations alone."""
    enough = seeds_to_decide(mean, list(spreads))
    assert enough is not None and enough > 2
    for count, decides in ((enough, True), (enough - 1, False)):
        found = stats.ttest_ind_from_stats(mean, spreads[0], count, 0.0, spreads[1], count, equal_var=False)
        assert (found.pvalue < 0.05) == decides


def test_how_many_seeds_would_decide_is_not_said_without_a_spread_or_a_difference():
    assert seeds_to_decide(1.0, [0.0, 0.0]) is None
    assert seeds_to_decide(1.0, [math.nan, 1.0]) is None
    assert seeds_to_decide(0.0, [1.0]) is None
    assert seeds_to_decide(1e-14, [1.0]) is None
    assert difference([1.0], [2.0, 3.0], paired=False).enough is None
    # Far apart, two seeds do: 12.7062 * 0.1 / sqrt(2) = 0.9.
    assert seeds_to_decide(1.0, [0.1]) == 2


def test_probability_of_improvement_is_mann_and_whitneys():
    ties = [118.0, 96.0, 140.0]
    found = improvement(FIRST, ties)
    assert found.probability == pytest.approx(stats.mannwhitneyu(FIRST, ties).statistic / 15) == 9.5 / 15
    assert found.low < found.probability < found.high
    assert found == improvement(FIRST, ties)
    assert improvement([2.0, 3.0], [1.0, 0.0]) == improvement([5.0, 5.0], [1.0, 1.0])  # 1, from 1 to 1
    alone = improvement([2.0], [1.0, 3.0])
    assert alone.probability == 0.5 and math.isnan(alone.low) and math.isnan(alone.high)


def test_bootstrap_of_the_probability_of_improvement_by_hand():
    # X is always 1, Y is 0 or 2: of the resamples of Y a quarter has two 2s, a half one, a quarter none, so P(X > Y)
    # is 0, 1/2 and 1 with odds 1 : 2 : 1.
    wide, narrow = (improvement([1.0, 1.0], [0.0, 2.0], confidence) for confidence in (0.6, 0.4))
    assert (wide.low, wide.high, narrow.low, narrow.high) == (0.0, 1.0, 0.5, 0.5)


def test_interquartile_mean_leaves_a_quarter_out_at_each_end():
    assert interquartile_mean([1000.0, 1.0, 2.0, 3.0, 4.0, -50.0, 5.0, 6.0]) == 3.5  # of 2, 3, 4, 5
    assert interquartile_mean([1.0, 5.0, 9.0]) == 5.0
    with pytest.raises(ConfigError, match="finite numbers"):
        interquartile_mean([])
