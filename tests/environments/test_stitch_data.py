"""The scripted logs: their statistics, their rules, their configuration, and that a seed fixes every bit."""

import dataclasses
import json

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.environments.controller import WaypointController
from odaf.environments.maze import STITCH
from odaf.environments.point_maze import PointMaze
from odaf.environments.stitch_config import BROAD
from odaf.environments.stitch_data import CONFIGS, Driver, Route, StitchConfig, direct_controller_return, generate
from odaf.errors import ConfigError

PAPER = CONFIGS["stitch"]


@pytest.fixture(scope="module")
def tenth():
    """A tenth of the paper's log: 25 episodes of each kind."""
    return generate(PAPER.with_repeats(25), seed=0)


def by_route(dataset, repeats):
    return dataset.episode_returns().reshape(-1, repeats)


def test_statistics_of_a_tenth(tenth):
    """Limits: the full log's figures widened to five standard errors of the smaller sample."""
    returns = by_route(tenth, 25)
    assert returns.shape == (4, 25)
    assert abs(returns.mean() - 40.8) < 5 * 0.45
    assert returns[:2].max() < 36.5
    assert ((returns[2:].mean(axis=1) > 49) & (returns[2:].mean(axis=1) < 61)).all()
    assert 62 < returns.max() < 76


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGS)
def test_acceptance_at_full_size(name):
    config = CONFIGS[name]
    dataset = generate(config, seed=0)
    acceptance = dataset.provenance["acceptance"]
    assert acceptance["passed"] and len(acceptance["checks"]) == len(config.accept) > 0
    returns = by_route(dataset, 250)
    statistics = dataset.provenance["statistics"]
    np.testing.assert_allclose([statistics["mean"], statistics["best"]], [returns.mean(), returns.max()], rtol=1e-6)
    if name == "stitch":
        assert len(dataset) == 200_000
        assert 40.2 <= returns.mean() <= 41.2 and 70 <= returns.max() <= 75
        assert returns[:2].max() < 36
        assert ((returns[2:].mean(axis=1) >= 51) & (returns[2:].mean(axis=1) <= 59)).all()
    best = int(np.argmax(dataset.episode_returns()))
    cells = {config.maze.cell((float(x), float(y))) for x, y in dataset.observations[dataset.episode(best), :2]}
    assert cells & set(config.maze.avoid), "the best logged episode takes the detour"


@pytest.mark.parametrize(("name", "ratio"), [("stitch", 1.8), ("crossroads", 2.6), ("ladder", 2.0)])
def test_a_direct_drive_beats_the_log_by_far(name, ratio):
    config = CONFIGS[name]
    log = generate(config.with_repeats(5), seed=1)
    knowing = direct_controller_return(config, episodes=6, seed=0)
    blind = direct_controller_return(config, episodes=6, seed=0, knows_target=False)
    assert knowing.mean() > ratio * log.episode_returns().max()
    assert log.episode_returns().max() < blind.mean() < knowing.mean()
    if name == "stitch":
        assert 128 < knowing.mean() < 144  # 136 over many episodes, spread 4
    for index in range(log.num_episodes):
        rows = log.episode(index)
        cells = {config.maze.cell((x, y)) for x, y in log.observations[rows, :2].astype(float).tolist()}
        assert cells & set(config.maze.avoid) or config.maze.goal not in cells, "somebody logged the good path"


def test_no_logged_episode_is_stitched(tenth):
    """Nobody who ends at the goal has kept off the detour, and half never get there."""
    goal, avoid = np.array(STITCH.centre(STITCH.goal)), set(STITCH.avoid)
    arrived = 0
    for index in range(tenth.num_episodes):
        rows = tenth.episode(index)
        positions = tenth.observations[rows, :2].astype(float)
        if np.hypot(*(tenth.next_observations[rows.stop - 1, :2] - goal)) <= 0.45:
            arrived += 1
            assert {STITCH.cell((x, y)) for x, y in positions.tolist()} & avoid
    assert 30 < arrived <= 50


def test_rows_are_whole_episodes_with_true_successors(tenth):
    assert len(tenth) == 100 * 200
    assert not tenth.terminated.any()
    np.testing.assert_array_equal(np.flatnonzero(tenth.truncated), np.arange(199, 20_000, 200))
    assert tenth.provenance["findings"] == []  # every successor is the next row's observation, every row kept
    assert tenth.observation_names == ("x", "y", "vx", "vy")
    assert np.abs(tenth.actions).max() <= 1.0
    assert tenth.environment == {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 200}


def test_replaying_the_logged_actions_gives_the_logged_rows(tenth):
    """The first episode again: its seed is the first draw of its route's stream, as the generator documents."""
    rng = np.random.default_rng(np.random.SeedSequence(0).spawn(4)[0])
    environment = PointMaze(STITCH)
    observation, _ = environment.reset(seed=int(rng.integers(1000)))
    rows = tenth.episode(0)
    np.testing.assert_array_equal(observation, tenth.observations[0])
    # Logged actions are rounded to single precision, so the replay drifts by rounding only.
    for row in range(rows.start, rows.stop):
        observation, reward, _, _, _ = environment.step(tenth.actions[row])
        np.testing.assert_allclose(observation, tenth.next_observations[row], atol=2e-5)
        assert reward == pytest.approx(tenth.rewards[row], abs=2e-5)


def test_one_seed_gives_the_same_bits_and_another_does_not(tmp_path):
    config = PAPER.with_repeats(2)
    first, again, other = generate(config, 3), generate(config, 3), generate(config, 4)
    assert first.fingerprint() == again.fingerprint()
    assert (first.observations != other.observations).any()
    first.save(tmp_path / "stitch.h5")
    loaded = Dataset.load(tmp_path / "stitch.h5")
    assert loaded.fingerprint() == first.fingerprint()
    assert StitchConfig.from_dict(loaded.provenance["config"]) == config


def test_more_repeats_of_one_route_leave_the_others_alone():
    few = generate(PAPER.with_repeats(1), 0)
    routes = tuple(dataclasses.replace(route, repeats=1 + (index == 0)) for index, route in enumerate(PAPER.routes))
    more = generate(dataclasses.replace(PAPER, routes=routes, accept=()), 0)
    np.testing.assert_array_equal(more.select([0, 2, 3, 4]).observations, few.observations)


def test_drivers_take_turns_and_a_part_is_the_beginning_of_every_route():
    two = PAPER.with_repeats(4).driven_by((Driver(), Driver(gain=3.0, damping=2.0, noise=0.5)))
    broad, usual = generate(two, 0), generate(PAPER.with_repeats(4), 0)
    forces = broad.actions[broad.episode(1)]
    assert np.abs(np.diff(forces, axis=0)).mean() > 0.3  # an unsteady hand
    np.testing.assert_array_equal(broad.select([0]).actions, usual.select([0]).actions)  # the first hand is the usual
    assert StitchConfig.from_dict(json.loads(json.dumps(two.to_dict()))) == two
    assert "drivers" not in PAPER.to_dict()  # logs of one hand are what they were
    half = generate(two.part(50), 0)
    np.testing.assert_array_equal(half.observations, broad.select([0, 1, 4, 5, 8, 9, 12, 13]).observations)
    assert two.part(100) == two and PAPER.part(100) == PAPER and len(BROAD) == 9


def test_random_walk_begins_after_the_last_goal_was_reached():
    config = dataclasses.replace(PAPER, routes=(Route("walk", ((2, 2),), 3, "random"),), accept=())
    log = generate(config, 0)
    for index in range(3):
        rows = log.episode(index)
        position, force = log.observations[rows, :2], log.actions[rows]
        # The driver brakes and then pushes hardly at all; uniform forces have mean size 0.5.
        arrived = int(np.argmax(np.hypot(*(position - [-0.5, -0.5]).T) < 0.2))
        assert 0 < arrived < 60
        assert 0.4 < np.abs(force[arrived:]).mean() < 0.6
        assert abs(np.corrcoef(force[arrived:-1, 0], force[arrived + 1 :, 0])[0, 1]) < 0.4


def test_a_failed_figure_is_reported_not_hidden():
    config = dataclasses.replace(
        PAPER.with_repeats(1), accept=(("mean", 90.0, 99.0), ("junction-1/best", 0.0, 36.0), ("best", 0.0, 200.0))
    )
    provenance = generate(config, 0).provenance
    assert provenance["acceptance"]["passed"] is False
    assert [check["passed"] for check in provenance["acceptance"]["checks"]] == [False, True, True]
    (finding,) = provenance["findings"]
    assert finding["finding"] == "acceptance-failed" and "return mean is" in finding["message"]
    assert generate(PAPER.with_repeats(1), 0).provenance["acceptance"]["passed"] is None


@pytest.mark.parametrize("name", CONFIGS)
def test_configuration_survives_json(name):
    config = CONFIGS[name]
    assert StitchConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert hash(config) == hash(StitchConfig.from_dict(config.to_dict()))


WRONG = {
    "steps": (lambda: dataclasses.replace(PAPER, steps=0), "steps is 0; give the length"),
    "nothing": (lambda: PAPER.with_repeats(0), "ask for no episode at all"),
    "no routes": (lambda: dataclasses.replace(PAPER, routes=()), "ask for no episode at all"),
    "twice": (lambda: dataclasses.replace(PAPER, routes=PAPER.routes[:1] * 2), "route names must differ"),
    "wall": (
        lambda: StitchConfig(STITCH, (Route("a", ((0, 0),), 1),)),
        r"route 'a' visits \(0, 0\), a wall or outside",
    ),
    "figure": (lambda: dataclasses.replace(PAPER, accept=(("median", 0.0, 1.0),)), "accept names 'median'; known are"),
    "no goals": (lambda: Route("a", (), 1), "route 'a': goals is empty"),
    "negative": (lambda: Route("a", ((2, 2),), -1), "route 'a': repeats is -1"),
    "after": (lambda: Route("a", ((2, 2),), 1, "dance"), "after is 'dance'; known are 'hold' and 'random'"),
    "driver": (lambda: Driver(gain=0.0), r"driver: gain 0.0, damping 1.0, noise 0.0; give finite numbers"),
    "no driver": (lambda: PAPER.driven_by(()), "drivers is empty; name at least one"),
    "driver fields": (
        lambda: StitchConfig.from_dict({**PAPER.to_dict(), "drivers": [{"speed": 1.0}]}),
        r"driver: missing fields \[\], unknown fields \['speed'\]",
    ),
    "driver numbers": (
        lambda: StitchConfig.from_dict({**PAPER.to_dict(), "drivers": [{"gain": "much"}]}),
        "must hold numbers",
    ),
    "fields": (lambda: StitchConfig.from_dict({"maze": {}}), r"missing fields \['routes'\]"),
    "route fields": (
        lambda: StitchConfig.from_dict({"maze": STITCH.to_dict(), "routes": [{"name": "a", "goal": [1, 1]}]}),
        r"route: missing fields \['goals', 'repeats'\], unknown fields \['goal'\]",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_impossible_configurations_are_refused(name):
    build, message = WRONG[name]
    with pytest.raises(ConfigError, match=message):
        build()


def test_controller_by_hand():
    """From rest at the start's centre towards G: first waypoint M's centre, force 10 * distance - velocity, clipped."""
    controller = WaypointController(STITCH, np.random.default_rng(0))
    goal = (1.6, -0.4)
    assert controller.act((-0.5, 0.5, 0.0, 0.0), goal) == (0.0, -1.0)
    assert controller.act((-0.52, -0.38, 0.3, -1.0), goal) == pytest.approx((10 * 0.02 - 0.3, 10 * -0.12 + 1.0))
    # Within 0.1 of M the waypoint moves on to (2, 3), whose centre (0.5, -0.5) is missed by up to 0.2, below and left.
    right, up = controller.act((-0.5, -0.45, 0.0, 0.0), goal)
    assert right == 1.0 and -1.0 <= up <= -0.5
    waypoint = controller._waypoint
    assert 0.3 <= waypoint[0] <= 0.5 and -0.7 <= waypoint[1] <= -0.5
    # At that waypoint the goal itself, without noise, is next.
    assert controller.act((*waypoint, 5.0, 0.0), goal)[0] == 1.0
    assert controller.act((1.55, -0.4, 0.0, 0.0), goal) == pytest.approx((0.5, 0.0))


def test_controller_plans_anew_for_a_new_goal_and_inside_the_goal_cell():
    controller = WaypointController(STITCH, np.random.default_rng(0))
    controller.act((-0.5, 0.5, 0.0, 0.0), (1.5, -0.5))
    # A goal in the very next cell: the driver heads for that cell's centre, not for the goal.
    assert controller.act((-0.5, 0.5, 0.0, 0.0), (-1.3, 0.3)) == (-1.0, 0.0)
    # Standing in the goal's cell: straight to the goal.
    assert controller.act((-1.5, 0.5, 0.0, 0.0), (-1.45, 0.52)) == pytest.approx((0.5, 0.2))
