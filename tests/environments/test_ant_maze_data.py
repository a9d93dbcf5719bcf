"""Recorded ant-maze sets: their rows, their ends, that they are attempts at one goal, and what acceptance notices."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.environments import ant_maze_data
from odaf.environments.ant_maze import AntMaze
from odaf.environments.ant_maze_acceptance import (
    LIMITS,
    acceptance_of,
    findings_of,
    reached_and_flipped,
    statistics_of,
)
from odaf.environments.ant_maze_data import NAMES, SETS, columns_of, generate
from odaf.environments.ant_maze_map import ANT_MAZES
from odaf.environments.ant_maze_recorder import Walks, record
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.shipped_policies import Walker, shipped_walker
from odaf.errors import ConfigError


def walker_of(mean: float = 0.0, log_std: float = -5.0) -> Walker:
    """Acts around tanh(mean), whatever it is shown."""
    bias = np.r_[np.full(8, mean), np.full(8, log_std)].astype(np.float32)
    return Walker(GaussianPolicy([np.zeros((29, 16), np.float32)], [bias]), {"walker": {"step": 1}})


def walks_of(places: Any, goals: Any) -> Walks:
    """Walks over given places [W, T + 1, 2], upright."""
    places = np.asarray(places, float)
    bodies = np.zeros((*places.shape[:2], 29))
    bodies[:, :, :2], bodies[:, :, 3] = places, 1.0
    return Walks(bodies, np.zeros((len(places), places.shape[1] - 1, 8), np.float32), np.asarray(goals, float))


@pytest.fixture(scope="module")
def recorded() -> Dataset:
    """A walk and a piece of another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ant_maze_data.SETS, "antmaze-umaze", _short(SETS["antmaze-umaze"]))
        return generate("antmaze-umaze", 50, seed=3, walker=walker_of())


def _short(chosen: ant_maze_data.MazeSet, steps: int = 30) -> ant_maze_data.MazeSet:
    return ant_maze_data.MazeSet(chosen.maze, chosen.evaluation, chosen.environment, chosen.random_start, steps)


def test_rows_are_exact_and_follow_one_another_up_to_the_end_of_their_walk(recorded):
    assert len(recorded) == 50 and recorded.obs_dim == 29 and recorded.act_dim == 8
    assert np.flatnonzero(recorded.truncated).tolist() == [29, 49] and not recorded.terminated.any()
    inner = np.setdiff1d(np.arange(49), [29])
    np.testing.assert_array_equal(recorded.next_observations[inner], recorded.observations[inner + 1])
    bodies = np.concatenate([recorded.infos["qpos"], recorded.infos["qvel"]], axis=1)
    np.testing.assert_array_equal(bodies.astype(np.float32), recorded.observations)
    assert recorded.infos["walk"].tolist() == [0] * 30 + [1] * 20
    assert len(np.unique(recorded.infos["goal"], axis=0)) == 2, "a goal for each walk"
    assert recorded.environment == {
        "name": "gymnasium",
        "id": "odaf/AntMaze-UMaze-v0",
        "kwargs": {},
        "contact_margins": "larger",
    }
    assert recorded.provenance["name"] == "antmaze-umaze"
    assert recorded.provenance["acceptance"]["passed"] is None
    assert recorded.provenance["findings"][0]["finding"] == "acceptance-unknown"


def test_the_stored_bodies_give_the_stored_rows_back(recorded):
    ant = AntMaze("umaze", "collection")
    ant.reset(seed=0)
    for row in (0, 13, 37):
        ant.place(recorded.infos["qpos"][row], recorded.infos["qvel"][row])
        np.testing.assert_allclose(ant.step(recorded.actions[row])[0], recorded.next_observations[row], atol=1e-3)


def test_actions_are_the_walkers_with_noise_and_within_bounds():
    ants = [AntMaze("umaze", "collection") for _ in range(2)]
    walks = record(ants, walker_of(mean=0.5).policy, 3, 40, np.random.default_rng(0))
    assert walks.actions.shape == (3, 40, 8) and walks.bodies.shape == (3, 41, 29)
    assert walks.actions.mean() == pytest.approx(np.tanh(0.5), abs=0.03)
    assert walks.actions.std() == pytest.approx(0.2, abs=0.02)
    loud = record(ants, walker_of(mean=2.0).policy, 1, 20, np.random.default_rng(0), noise=1.0)
    assert np.abs(loud.actions).max() == 1.0


def test_one_seed_gives_the_same_bits_and_another_does_not(recorded, monkeypatch):
    monkeypatch.setitem(ant_maze_data.SETS, "antmaze-umaze", _short(SETS["antmaze-umaze"]))
    again, other = (generate("antmaze-umaze", 50, seed=seed, walker=walker_of()) for seed in (3, 4))
    assert again.fingerprint() == recorded.fingerprint()
    assert (other.observations != recorded.observations).any()


def test_walks_are_told_as_attempts_at_the_goal_of_evaluation():
    """The first walk passes the goal in its second and third step, the second reaches it with its last row."""
    goal = (10.0, 0.0)
    places = [[(8, 0), (9, 0), (9.6, 0), (10.5, 0), (11, 0)], [(0, 0), (1, 0), (2, 0), (3, 0), (10, 0.4)]]
    walks = walks_of(places, [(50.0, 0.0), (60.0, 0.0)])
    columns = columns_of(walks, goal, 8)
    assert columns["rewards"].tolist() == [0, 1, 1, 0, 0, 0, 0, 1]
    assert np.flatnonzero(columns["terminated"]).tolist() == [1, 2, 7]
    assert np.flatnonzero(columns["truncated"]).tolist() == [3]
    assert columns["goal"][:, 0].tolist() == [50.0] * 4 + [60.0] * 4
    cut = columns_of(walks, goal, 7)
    assert np.flatnonzero(cut["truncated"]).tolist() == [3, 6] and len(cut["rewards"]) == 7
    assert np.flatnonzero(columns_of(walks, goal, 3)["truncated"]).tolist() == []


def test_figures_say_who_reached_their_goal_who_fell_and_where_they_were():
    maze = ANT_MAZES["umaze"]
    places = [[(0, 0), (4, 0), (8, 0)], [(0, 0), (0, 1), (0, 0)], [(8, 4), (8, 8), (4, 8)]]
    walks = walks_of(places, [(8.3, 0.3), (8.0, 0.0), (8.0, 8.0)])
    walks.bodies[1, 2, 3:7] = 0.0, 1.0, 0.0, 0.0
    figures = statistics_of(walks, columns_of(walks, (4.0, 8.0), 6), maze)
    assert (figures["reached_share"], figures["flipped_share"]) == (pytest.approx(2 / 3), pytest.approx(1 / 3))
    assert figures["steps_to_goal"] == 1.5 and figures["whole_walks"] == 3
    assert (figures["goal_rows"], figures["goal_walks"]) == (1, 1)
    assert figures["visited_share"] == pytest.approx(4 / 7), "of seven free cells"


def test_acceptance_notices_walkers_that_do_not_arrive():
    good = {name: low for name, (low, _) in LIMITS.items()} | {"whole_walks": 20}
    assert acceptance_of(good)["passed"] is True and findings_of(acceptance_of(good)) == []
    for name, value in (("reached_share", 0.5), ("flipped_share", 0.5), ("visited_share", 0.9), ("goal_rows", 0)):
        judged = acceptance_of(good | {name: value})
        assert judged["passed"] is False
        assert [check["figure"] for check in judged["checks"] if not check["passed"]] == [name]
        assert findings_of(judged)[0]["message"].startswith(f"{name} is ")


@pytest.mark.parametrize("name", NAMES)
def test_rewards_refer_to_a_goal_in_the_middle_of_those_that_evaluation_draws(name):
    chosen: ant_maze_data.MazeSet = SETS[name]
    environment = AntMaze(chosen.evaluation)
    goals = np.array([environment.reset(seed=seed)[1]["goal"] for seed in range(40)])
    np.testing.assert_allclose(goals.mean(axis=0), chosen.goal, atol=0.25)
    assert chosen.environment.lower().endswith(f"{chosen.evaluation}-v0")
    assert chosen.steps == (700 if "umaze" in name else 1000)


def test_what_is_missing_is_explained(monkeypatch, tmp_path):
    with pytest.raises(ConfigError, match="antmaze-tiny.*not known.*antmaze-large-play"):
        generate("antmaze-tiny", 10)
    with pytest.raises(ConfigError, match="transitions=0"):
        generate("antmaze-umaze", 0)
    monkeypatch.setattr("odaf.environments.shipped_policies.files", lambda package: tmp_path)
    with pytest.raises(ConfigError, match="odaf behaviour train ant.*odaf behaviour export"):
        generate("antmaze-umaze", 10)


def test_the_shipped_walker_leads_ants_to_goals_around_a_corner():
    """In the small maze two corners lie between start and goal, some 20 m of way."""
    ants = [AntMaze("umaze", "collection") for _ in range(6)]
    walks = record(ants, shipped_walker().policy, 6, 300, np.random.default_rng(0))
    reached, _ = reached_and_flipped(walks)
    assert reached.mean() >= 0.5


def test_every_set_has_a_map_to_collect_on():
    known: Mapping[str, Any] = ANT_MAZES
    assert len(NAMES) == 6 and all(each.maze in known and each.evaluation in known for each in SETS.values())
    assert not SETS["antmaze-umaze"].random_start and SETS["antmaze-umaze-diverse"].random_start
