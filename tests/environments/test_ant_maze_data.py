"""Recorded ant-maze sets: their rows, their ends, that they are attempts at one goal, and what acceptance notices."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.environments.ant_maze import AntMaze
from odaf.environments.ant_maze_acceptance import (
    LIMITS,
    acceptance_of,
    findings_of,
    statistics_of,
)
from odaf.environments.ant_maze_data import columns_of, generate
from odaf.environments.ant_maze_map import ANT_MAZES
from odaf.environments.ant_maze_recorder import Walk, ants_for, record
from odaf.environments.ant_maze_sets import NAMES, SETS, MazeSet
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.shipped_policies import Walker
from odaf.errors import ConfigError


def walker_of(mean: float = 0.0, log_std: float = -5.0) -> Walker:
    """Acts around tanh(mean), whatever it is shown."""
    bias = np.r_[np.full(8, mean), np.full(8, log_std)].astype(np.float32)
    return Walker(GaussianPolicy([np.zeros((29, 16), np.float32)], [bias]), {"walker": {"step": 1}})


def walk_of(places: Any, goal: Any, arrived: bool = False, finished: bool = True) -> Walk:
    """A walk over given places [T + 1, 2], upright."""
    places = np.asarray(places, float)
    bodies = np.zeros((len(places), 29))
    bodies[:, :2], bodies[:, 3] = places, 1.0
    steps = len(places) - 1
    return Walk(bodies, np.zeros((steps, 8), np.float32), np.asarray(goal, float), steps, finished, arrived)


@pytest.fixture(scope="module")
def recorded() -> Dataset:
    """A walk and a piece of another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SETS, "antmaze-umaze", _short(SETS["antmaze-umaze"]))
        return generate("antmaze-umaze", 50, seed=3, walker=walker_of())


def _short(chosen: MazeSet, steps: int = 30) -> MazeSet:
    return MazeSet(chosen.maze, chosen.evaluation, chosen.environment, chosen.random_start, steps)


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
    walks = record(ants, walker_of(mean=0.5).policy, 81, 40, np.random.default_rng(0))
    assert [len(walk.actions) for walk in walks] == [40, 40, 1] and [len(walk.bodies) for walk in walks] == [41, 41, 2]
    assert [walk.finished for walk in walks] == [True, True, False]
    actions = np.concatenate([walk.actions for walk in walks])
    assert actions.mean() == pytest.approx(np.tanh(0.5), abs=0.03)
    assert actions.std() == pytest.approx(0.2, abs=0.02)
    (loud,) = record(ants[:1], walker_of(mean=2.0).policy, 20, 20, np.random.default_rng(0), noise=1.0)
    assert np.abs(loud.actions).max() == 1.0


def test_one_seed_gives_the_same_bits_and_another_does_not(recorded, monkeypatch):
    monkeypatch.setitem(SETS, "antmaze-umaze", _short(SETS["antmaze-umaze"]))
    again, other = (generate("antmaze-umaze", 50, seed=seed, walker=walker_of()) for seed in (3, 4))
    assert again.fingerprint() == recorded.fingerprint()
    assert (other.observations != recorded.observations).any()


def test_a_walk_ends_at_the_goal_of_evaluation_and_the_next_begins_elsewhere():
    """Ants begin anywhere in the small maze, its goal's cell included; the place where walks end is all of a cell."""
    ants = [AntMaze("umaze-diverse", "collection", random_start=True) for _ in range(3)]
    end, everywhere = (4.75, 0.75), record(ants, walker_of().policy, 120, 4, np.random.default_rng(1))
    assert len(everywhere) == 30 and any(ant_cell(walk) == (1, 2) for walk in everywhere)
    away = record(ants, walker_of().policy, 120, 4, np.random.default_rng(1), end=end)
    assert not any(ant_cell(walk) == (1, 2) for walk in away) and not any(walk.arrived for walk in away)
    fixed = [AntMaze("umaze", "collection")]
    walks = record(fixed, walker_of().policy, 3, 4, np.random.default_rng(1), end=(0.0, 0.0))
    assert [(walk.length, walk.arrived, walk.finished, len(walk.bodies)) for walk in walks] == [(1, True, True, 2)] * 3


def ant_cell(walk: Walk) -> tuple[int, int]:
    return ANT_MAZES["umaze"].cell((walk.bodies[0, 0], walk.bodies[0, 1]))


def test_walks_are_told_as_attempts_at_the_goal_of_evaluation():
    """The first walk arrives, the second has its time up, the third is still going."""
    walks = [
        walk_of([(8, 0), (9, 0), (9.6, 0)], (50.0, 0.0), arrived=True),
        walk_of([(0, 0), (1, 0), (2, 0), (3, 0)], (60.0, 0.0)),
        walk_of([(0, 0), (1, 0), (2, 0)], (70.0, 0.0), finished=False),
    ]
    columns = columns_of(walks, 6)
    assert columns["rewards"].tolist() == [0, 1, 0, 0, 0, 0]
    assert np.flatnonzero(columns["terminated"]).tolist() == [1]
    assert np.flatnonzero(columns["truncated"]).tolist() == [4, 5]
    assert columns["goal"][:, 0].tolist() == [50.0] * 2 + [60.0] * 3 + [70.0]
    assert columns["walk"].tolist() == [0, 0, 1, 1, 1, 2] and columns["next_observations"][1, 0] == np.float32(9.6)
    assert {len(column) for column in columns.values()} == {6}
    assert np.flatnonzero(columns_of(walks[:1], 2)["truncated"]).tolist() == []
    assert np.flatnonzero(columns_of(walks[:1], 1)["truncated"]).tolist() == [0]


def test_figures_say_who_reached_their_goal_who_fell_and_where_they_were():
    maze = ANT_MAZES["umaze"]
    walks = [
        walk_of([(0, 0), (4, 0), (8, 0)], (8.3, 0.3)),
        walk_of([(0, 0), (0, 1), (0, 0)], (8.0, 0.0)),
        walk_of([(8, 4), (8, 8), (4, 8)], (8.0, 8.0)),
        walk_of([(8, 8), (4, 8)], (0.0, 8.0), arrived=True),
        walk_of([(8, 8), (4, 8), (4, 9)], (0.0, 8.0), finished=False),
    ]
    walks[1].bodies[2, 3:7] = 0.0, 1.0, 0.0, 0.0
    figures = statistics_of(walks, columns_of(walks, 9), maze)
    assert (figures["reached_share"], figures["flipped_share"]) == (pytest.approx(3 / 4), pytest.approx(1 / 4))
    assert figures["steps_to_goal"] == pytest.approx((2 + 1 + 1) / 3) and figures["whole_walks"] == 4
    assert (figures["goal_walks"], figures["shortest_walk"], figures["mean_walk"]) == (1, 1, 1.75)
    assert figures["visited_share"] == pytest.approx(5 / 7), "of seven free cells"
    assert statistics_of(walks, columns_of(walks, 6), maze)["whole_walks"] == 3


def test_acceptance_notices_walkers_that_do_not_arrive_and_walks_of_one_row():
    good = {name: low for name, (low, _) in LIMITS.items()} | {"whole_walks": 20}
    assert acceptance_of(good)["passed"] is True and findings_of(acceptance_of(good)) == []
    wrong = {"reached_share": 0.5, "flipped_share": 0.5, "visited_share": 0.9, "goal_walks": 0, "shortest_walk": 1}
    for name, value in wrong.items():
        judged = acceptance_of(good | {name: value})
        assert judged["passed"] is False
        assert [check["figure"] for check in judged["checks"] if not check["passed"]] == [name]
        assert findings_of(judged)[0]["message"].startswith(f"{name} is ")


@pytest.mark.parametrize("name", NAMES)
def test_rewards_refer_to_a_goal_in_the_middle_of_those_that_evaluation_draws(name):
    chosen: MazeSet = SETS[name]
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


def test_walks_of_the_shipped_walker_end_at_the_goal_as_episodes_of_evaluation_do():
    """In the small maze two corners lie between start and goal, some 20 m of way."""
    dataset = generate("antmaze-umaze", 2000)
    lengths, returns = dataset.episode_lengths(), dataset.episode_returns()
    assert lengths[:-1].min() > 60, "no ant is that fast"
    assert 0 < dataset.terminated.sum() == returns.sum() and set(returns.tolist()) <= {0.0, 1.0}
    assert dataset.provenance["statistics"]["goal_walks"] == dataset.terminated.sum()
    distances = np.linalg.norm(dataset.next_observations[:, :2] - SETS["antmaze-umaze"].goal, axis=1)
    np.testing.assert_array_equal(distances <= 0.5, dataset.terminated)


def test_ants_walk_side_by_side_where_many_walks_are_wanted():
    assert [ants_for(rows, 1000) for rows in (1, 9_999, 100_000, 1_000_000)] == [1, 1, 20, 50]


def test_every_set_has_a_map_to_collect_on():
    known: Mapping[str, Any] = ANT_MAZES
    assert len(NAMES) == 6 and all(each.maze in known and each.evaluation in known for each in SETS.values())
    assert not SETS["antmaze-umaze"].random_start and SETS["antmaze-umaze-diverse"].random_start
