"""Statistics over tasks, against values by hand."""

import numpy as np
import pytest

from odaf.errors import ConfigError
from odaf.evaluation.across_tasks import (
    improvement_over_tasks,
    interquartile_mean_over_tasks,
    performance_profile,
    probability_of_gain,
)

FIRST = {"a": [1.0, 3.0], "b": [10.0, 30.0]}
SECOND = {"b": [20.0, 40.0], "a": [0.0, 2.0]}


def test_the_interquartile_mean_is_of_all_runs_and_its_interval_keeps_the_tasks():
    found = interquartile_mean_over_tasks(FIRST)
    assert found.mean == (3.0 + 10.0) / 2 and found.count == 4
    # The lowest resample is 1 1 10 10, the highest 3 3 30 30; their middle halves are 1 10 and 3 30.
    assert (found.low, found.high) == (5.5, 16.5)


def test_a_probability_of_improvement_is_the_mean_over_tasks():
    # a: 1 beats 0, loses to 2; 3 beats both: 3/4. b: 10 loses twice, 30 beats 20 only: 1/4.
    found = improvement_over_tasks(FIRST, SECOND)
    assert found.probability == pytest.approx(0.5)
    assert 0.0 <= found.low <= 0.5 <= found.high <= 1.0
    alone = improvement_over_tasks({"a": [1.0]}, {"a": [1.0]})
    assert alone.probability == 0.5 and np.isnan(alone.low)


def test_a_profile_counts_every_task_alike():
    shares, low, high = performance_profile({"a": [1.0, 3.0], "b": [3.0]}, [0.0, 1.0, 2.0, 3.0])
    assert shares.tolist() == [1.0, 0.75, 0.75, 0.0]
    assert (low <= shares).all() and (shares <= high).all() and low[1] == 0.5 and high[1] == 1.0


def test_the_paired_bootstrap_draws_tasks():
    share, gains = probability_of_gain({"a": [2.0], "b": [5.0]}, {"a": [1.0], "b": [9.0]})
    assert gains == {"a": 1.0, "b": -4.0}
    assert share == pytest.approx(0.25, abs=0.02)  # only a and a is above zero
    assert probability_of_gain({"a": [2.0]}, {"a": [1.0]})[0] == 1.0


@pytest.mark.parametrize("statistic", [improvement_over_tasks, probability_of_gain])
def test_sides_with_different_tasks_are_refused(statistic):
    with pytest.raises(ConfigError, match=r"\['b', 'c'\] are on one side only"):
        statistic({"a": [1.0], "b": [1.0]}, {"a": [1.0], "c": [1.0]})


def test_empty_and_infinite_scores_are_refused():
    with pytest.raises(ConfigError, match="expected one or more tasks"):
        interquartile_mean_over_tasks({})
    with pytest.raises(ConfigError, match="scores of a"):
        interquartile_mean_over_tasks({"a": [np.inf]})
