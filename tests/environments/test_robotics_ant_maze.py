"""Ant mazes of gymnasium-robotics as a place to evaluate in: settings, order of the observation, name of the score."""

import numpy as np
import pytest

from odaf.data.spec import Spec
from odaf.environments import make
from odaf.environments.reference_returns import reference_of
from odaf.environments.robotics_ant_maze import evaluation_settings, is_one, reading_of_scores
from odaf.errors import ConfigError
from odaf.evaluation import Rollouts
from odaf.evaluation.examination import examine

ID = "AntMaze_UMaze-v5"


def spec(obs_dim: int) -> Spec:
    return Spec(obs_dim, 8, (-1.0,) * 8, (1.0,) * 8, 0.0, 1.0, False, 20)


def names(obs_dim: int) -> list[str]:
    return [f"observation_{index}" for index in range(obs_dim)]


def test_an_id_alone_is_played_as_a_task_that_ends_at_the_goal():
    resolved = Rollouts(ID).resolved(None)
    assert resolved.environment == {
        "name": "gymnasium",
        "id": ID,
        "kwargs": {"continuing_task": False, "include_cfrc_ext_in_observation": False},
    }
    assert evaluation_settings("AntMaze_Large_Diverse_GR-v4") == {"continuing_task": False}
    assert evaluation_settings("Ant-v5") == evaluation_settings("odaf/AntMaze-UMaze-v0") == {}
    assert is_one(f"gymnasium_robotics:{ID}") and not is_one("odaf/AntMaze-UMaze-v0") and not is_one(None)
    given = {"name": "gymnasium", "id": ID, "kwargs": {"continuing_task": True}}
    assert Rollouts(given).resolved(None).environment == given


def test_observations_are_joined_as_in_d4rls_data_with_the_goal_or_without():
    rollouts = Rollouts(ID).resolved(None)
    raw = rollouts.maker()()
    seen = raw.reset(seed=5)[0]
    for obs_dim, parts in (
        (29, ["achieved_goal", "observation"]),
        (31, ["achieved_goal", "observation", "desired_goal"]),
    ):
        found = examine(rollouts.maker(), ID, spec(obs_dim), names(obs_dim))
        observation = found.make_env().reset(seed=5)[0]
        np.testing.assert_array_equal(observation, np.concatenate([seen[part] for part in parts]))
        assert "has no place beside scores of antmaze-*" in found.warnings["reading-of-scores"]
        assert not found.ignores_seed
    with pytest.raises(ConfigError, match="do not say which is which"):
        examine(rollouts.maker(), ID, spec(30), names(30))


def test_only_the_mazes_of_d4rl_have_a_normalised_score():
    assert reference_of(ID) is None and reading_of_scores("odaf/AntMaze-UMaze-v0") == ""
    assert reference_of("odaf/AntMaze-v0") is None  # maps of one's own
    for size in ("UMaze", "Medium", "Large"):
        reference = reference_of(f"odaf/AntMaze-{size}-v0")
        assert reference is not None and reference.normalise(0.35) == pytest.approx(35.0)


def test_the_ants_of_this_package_are_examined_without_a_word():
    found = examine(make({"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0"}), "ant", spec(29), names(29))
    assert found.warnings == {} and found.simulator is not None and found.simulator["contact_margins"] == "larger"
