"""Lists of episodes: exact successors from T + 1 observations, ends, and what is wrong with an episode."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odaf.data import Dataset
from odaf.errors import DatasetError


def episode(steps, first=0.0, extra=1, **more):
    """Observations count from `first`; `extra` says whether the one after the last action is there."""
    observations = first + np.arange(steps + extra, dtype=np.float64)[:, None]
    return {"observations": observations, "actions": np.zeros((steps, 1)), "rewards": np.ones(steps), **more}


def build(*episodes, **options):
    return Dataset.from_episodes(episodes, action_bounds=(-1.0, 1.0), **options)


def findings(dataset):
    return {finding["finding"]: finding["count"] for finding in dataset.provenance["findings"]}


def test_exact_successors_and_names():
    dataset = build(
        episode(2, 0.0, terminated=True),
        episode(3, 10.0, truncated=True),
        observation_names=["level"],
        action_names=["valve"],
        observation_units=["m"],
        action_units=["%"],
        provenance={"by": "hand"},
    )
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 10, 11, 12])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 11, 12, 13])
    np.testing.assert_array_equal(dataset.terminated, [False, True, False, False, False])
    np.testing.assert_array_equal(dataset.truncated, [False, False, False, False, True])
    assert dataset.observation_names == ("level",) and dataset.action_units == ("%",)
    assert findings(dataset) == {} and dataset.provenance["by"] == "hand" and dataset.provenance["format"] == "episodes"


def test_without_the_last_observation_a_cut_row_is_dropped():
    dataset = build(episode(3, 0.0, extra=0, terminated=True), episode(3, 10.0, extra=0))
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 10, 11])
    assert findings(dataset)["dropped-without-successor"] == 1


def test_lists_and_flags_a_step_will_do():
    first = {"observations": [[0], [1], [2]], "actions": [[0], [0]], "rewards": [1, 2], "terminated": [0, 1]}
    dataset = build(first, {**first, "terminated": [[False], [False]], "truncated": np.bool_(True)})
    np.testing.assert_array_equal(dataset.terminated, [False, True, False, False])
    np.testing.assert_array_equal(dataset.rewards, [1, 2, 1, 2])


@given(
    plan=st.lists(st.tuples(st.integers(1, 5), st.booleans(), st.booleans()), min_size=1, max_size=6),
)
def test_any_mixture_has_the_recorded_successors(plan):
    episodes = [episode(steps, 100.0 * n, int(extra), terminated=end) for n, (steps, extra, end) in enumerate(plan)]
    rows = [
        100.0 * n + step
        for n, (steps, extra, end) in enumerate(plan)
        for step in range(steps)
        if extra or end or step < steps - 1
    ]
    if not rows:
        with pytest.raises(DatasetError, match="none has a successor"):
            build(*episodes)
        return
    dataset = build(*episodes)
    level, after = dataset.observations[:, 0], dataset.next_observations[:, 0]
    np.testing.assert_array_equal(level, rows)
    np.testing.assert_array_equal(after[~dataset.terminated], level[~dataset.terminated] + 1)
    assert dataset.terminated.sum() == sum(end for _, _, end in plan)
    lost = sum(not extra and not end for _, extra, end in plan)
    assert findings(dataset).get("dropped-without-successor", 0) == lost


@pytest.mark.parametrize(
    ("episodes", "message"),
    [
        ([], "from_episodes: the list is empty"),
        ([episode(2), {"observations": 1}], "episode 1: field 'actions' is missing; it has 'observations'"),
        ([episode(2, reward=1)], "episode 0: field 'reward' is unknown; did you mean 'rewards'"),
        ([episode(2), episode(2, extra=3)], r"episode 1: field 'observations' has 5 rows for 2 actions; give 2, or 3"),
        ([episode(2, rewards=np.ones(3))], r"episode 0: field 'rewards' has shape \(3,\) for 2 actions"),
        ([episode(2, terminated=[True])], r"episode 0: field 'terminated' has shape \(1,\) for 2 actions"),
        ([episode(2, terminated=2)], "episode 0: field 'terminated' must hold only true and false"),
        ([episode(2, actions=np.zeros(2))], r"episode 0: field 'actions' has shape \(2,\); it must be \[steps, dim"),
        ([episode(0)], "episode 0: has no actions; leave empty episodes out"),
        ([episode(2), episode(2, actions=np.zeros((2, 3)))], "episode 1: field 'actions' has 3 columns, in episode 0"),
        ([episode(2, observations=[["a"], ["b"]])], "episode 0: field 'observations' holds <U1 values"),
        ([episode(1, extra=0), episode(2, terminated=[True, False])], "'terminated' marks an end inside an episode"),
        ([episode(2, rewards=[np.nan, 1.0])], "field 'rewards' holds NaN"),
    ],
)
def test_trouble_names_the_episode_and_field(episodes, message):
    with pytest.raises(DatasetError, match=message):
        build(*episodes)


def test_episodes_that_lose_their_only_row():
    dataset = build(episode(1, 0.0, extra=0), episode(2, 10.0))
    np.testing.assert_array_equal(dataset.observations[:, 0], [10, 11])
    assert dataset.num_episodes == 1
