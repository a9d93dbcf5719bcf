"""Conditions: what counts as broken, the shares of few episodes, and the probability under a policy that is known."""

import numpy as np
import pytest

from estimation.grounds import SMALL, constant
from odaf.assessment import Condition, Kept, assess
from odaf.assessment.conditions import conditions_of, share_of
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError, DatasetError
from odaf.estimation import Interval


def tank() -> Dataset:
    """Three episodes of a level: 1, 2, 4 (broken by the second action); 1, 2, 2; and 5, which begins broken, then 1."""
    levels = np.array([1.0, 2.0, 1.0, 2.0, 5.0])[:, None]
    after = np.array([2.0, 4.0, 2.0, 2.0, 1.0])[:, None]
    return Dataset.from_arrays(
        levels,
        np.array([0.1, 0.9, 0.2, 0.2, 0.3])[:, None],
        np.ones(5),
        next_observations=after,
        truncated=np.array([False, True, False, True, True]),
        action_bounds=(0.0, 1.0),
        observation_names=["level"],
        action_names=["feed"],
    )


def test_a_state_that_an_action_leads_to_breaks_a_condition_and_so_does_the_first_one():
    condition = Condition.parse("level < 3", tank())
    assert condition.broken(tank()).tolist() == [False, True, False, False, True]


def test_a_condition_on_actions_looks_at_its_own_row():
    condition = Condition.parse("feed < 0.5 or level > 3", tank())
    assert condition.names_actions and condition.broken(tank()).tolist() == [False, True, False, False, False]


def test_its_log_earns_one_where_an_episode_breaks_it_first_and_ends_there():
    three = Dataset.from_arrays(
        np.array([1.0, 4.0, 5.0, 1.0])[:, None],
        np.zeros((4, 1)),
        np.full(4, 7.0),
        next_observations=np.array([4.0, 5.0, 1.0, 1.0])[:, None],
        truncated=np.array([False, False, True, True]),
        action_bounds=(-1.0, 1.0),
        observation_names=["level"],
    )
    log = Condition.parse("level < 3", three).as_log(three)
    assert log.rewards.tolist() == [1.0, 0.0] and log.terminated.tolist() == [True, False]
    assert log.truncated.tolist() == [False, True]  # a cut row that breaks it is an end, no cut
    last = tank()
    assert Condition.parse("level < 3", last).as_log(last).truncated.tolist() == [False, False, False, True, False]
    assert log.episode_starts.tolist() == [0, 1]


def test_what_is_no_comparison_or_no_column_is_refused():
    with pytest.raises(ConfigError, match="gives numbers, not true or false"):
        Condition.parse("level + 1", tank())
    with pytest.raises(DatasetError, match="lvel"):
        Condition.parse("lvel < 3", tank())
    with pytest.raises(ConfigError, match="stands there twice"):
        conditions_of(["level < 3", "level < 3"], tank())


def test_intervals_of_shares_are_clopper_and_pearsons():
    # None of n: the upper end is 1 - 0.025 ** (1 / n); of 3 in 10, tables give 6.7 % to 65.2 %.
    none = share_of(0, 20, 0.95)
    assert none.low == 0.0 and none.high == pytest.approx(1.0 - 0.025 ** (1 / 20))
    some = share_of(3, 10, 0.95)
    assert (round(some.low, 3), round(some.high, 3)) == (0.067, 0.652)
    assert share_of(5, 5, 0.95).high == 1.0


def test_surely_worse_is_an_interval_above_the_logged_one():
    logged = Interval(0.1, 0.05, 0.2)
    for low, worse in ((0.19, False), (0.21, True)):
        assert Kept("level < 3", 100, 10, logged, Interval(0.5, low, 0.9), "").worse is worse
    assert not Kept("level < 3", 100, 0, logged, None, "cannot be told").worse


@pytest.mark.parametrize(("action", "probability"), [(0.8, 1.0), (-0.8, 0.0)])
def test_the_probability_of_a_policy_is_found_where_it_is_known(action, probability):
    # One step to a place that is the action itself, uniform in the log; beyond 0.5 the condition is broken.
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (400, 1))
    ends = np.ones(400, bool)
    log = Dataset.from_arrays(
        rng.uniform(-1.0, 0.4, (400, 1)),
        actions,
        rng.normal(size=400),
        next_observations=actions,
        truncated=ends,
        action_bounds=(-1.0, 1.0),
        observation_names=["place"],
    )
    found = assess(
        constant(log, action), log, keep=["place <= 0.5"], settings=SMALL, log=log, guard_changes={"steps": 1}
    )
    (kept,) = found.kept
    assert kept.logged.value == pytest.approx((actions > 0.5).mean()) and kept.broken == int((actions > 0.5).sum())
    assert kept.policy is not None and kept.policy.value == pytest.approx(probability, abs=0.1)
    assert kept.worse is (probability == 1.0)
    assert found.guard is None and "learned from 400" in found.no_guard  # the same episodes are no hold-out
