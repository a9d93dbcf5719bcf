"""The walker of the ant mazes: what it is shown and paid, that its runs resume, and how it is judged."""

import dataclasses
import json

import numpy as np
import pytest

from odaf.behaviour import export_walker as exporting
from odaf.behaviour import online
from odaf.behaviour.ant_task import AntTask, walk
from odaf.behaviour.export_walker import Look, export_walker
from odaf.behaviour.online import OnlineRun, load_policy, train
from odaf.behaviour.replay import Replay
from odaf.environments.ant_maze_controller import WaypointController
from odaf.environments.ant_maze_map import AntMazeMap
from odaf.environments.ant_walker import AntWalker, uprightness
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.shipped_policies import shipped_walker
from odaf.errors import ConfigError

TINY = OnlineRun(
    "ant",
    "v0",
    steps=160,
    random_steps=80,
    batch_size=8,
    stretch=40,
    evaluate_every=80,
    episodes=2,
    snapshot_every=40,
    checkpoint_every=40,
)
ON_ITS_BACK = np.array([0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0])


@pytest.fixture(scope="module", autouse=True)
def small_networks():
    """Learners of a few units, so that a run takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        whole = OnlineRun.algorithm
        patch.setattr(OnlineRun, "algorithm", lambda run: dataclasses.replace(whole(run), hidden_sizes=(8, 8)))
        yield


def still():
    """A policy that keeps all motors off."""
    return GaussianPolicy([np.zeros((29, 16), np.float32)], [np.r_[np.zeros(8), np.full(8, -5.0)].astype(np.float32)])


def test_a_walker_is_shown_in_training_what_the_controller_shows_it():
    walker = AntWalker()
    shown = walker.reset(3, direction=np.array([0.0, 2.0]))
    maze = AntMazeMap.of(["11111", "1r0g1", "11111"])
    observation, goal = walker.body(), walker.position + np.array([0.0, 0.3])
    inputs = WaypointController(maze, lambda inputs: inputs).inputs(
        observation[None], goal[None], np.random.default_rng(0)
    )
    np.testing.assert_allclose(shown, inputs[0], atol=1e-12)
    np.testing.assert_allclose(shown[-2:], [0.0, 10.0])


def test_a_walker_is_paid_for_its_way_along_the_direction_and_pays_for_a_tilt():
    walker, rng = AntWalker(), np.random.default_rng(0)
    walker.reset(5)
    actions, directions, places = rng.uniform(-1, 1, (201, 8)), [], [walker.position]
    paid, uprights = [], []
    direction = walker.towards(np.array([1.0, 1.0]))[-2:] / 10.0
    shown = walker.reset(5)
    for action in actions:
        directions.append(shown[-2:] / 10.0)
        shown, reward, _ = walker.step(action)
        paid.append(reward)
        uprights.append(uprightness(walker.body()))
        places.append(walker.position)
    speeds = np.sum(np.diff(places, axis=0) * directions, axis=1) / 0.1
    tilts = np.maximum(0.0, 0.9 - np.array(uprights))
    np.testing.assert_allclose(speeds - 10.0 * tilts, paid, atol=1e-9)
    assert (tilts == 0.0).any()
    changes = np.flatnonzero(np.any(np.diff(directions, axis=0) != 0.0, axis=1)) + 1
    assert changes.tolist() == [100, 200], "one direction for a hundred steps"
    np.testing.assert_allclose(direction, np.sqrt([0.5, 0.5]))
    walker.towards(np.array([1.0, 1.0]))
    assert all((walker.step(action)[0][-2:] > 7.0).all() for action in actions), "a given direction stays"


def test_an_ant_on_its_back_has_turned_over_and_one_on_its_side_not_yet():
    tilted = np.array([[1.0, 0, 0, 0], [1.0, 1, 0, 0], [0.0, 0, 2, 0], [0.5, 0, 0, 0.5]])
    poses = np.concatenate([np.zeros((4, 3)), tilted], axis=1)
    np.testing.assert_allclose(uprightness(poses), [1.0, 0.0, -1.0, 1.0], atol=1e-12)
    walker = AntWalker()
    walker.reset(0)
    assert not walker.step(np.zeros(8))[2]
    walker._data.qpos[:7] = ON_ITS_BACK
    _, reward, flipped = walker.step(np.zeros(8))
    assert flipped and reward < -10.0


def test_walks_end_at_the_waypoint_or_with_the_steps(monkeypatch):
    ants = [AntWalker() for _ in range(4)]
    walked = walk(still(), ants, seed=0, noise=0.0, most_steps=3)
    assert walked.steps.tolist() == [3] * 4 and not walked.flipped.any() and not walked.reached.any()
    assert np.abs(walked.speeds).max() < 1.0
    monkeypatch.setattr("odaf.behaviour.ant_task.DISTANCE", 0.3)
    near = walk(still(), ants, seed=0, noise=0.0, most_steps=3)
    assert near.steps.tolist() == [1] * 4 and near.reached.all()
    ants[1].step = lambda action: (np.zeros(29), 0.0, True)
    monkeypatch.setattr("odaf.behaviour.ant_task.DISTANCE", 8.0)
    assert walk(still(), ants, seed=0, noise=0.0, most_steps=3).flipped.tolist() == [False, True, False, False]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run that was never stopped."""
    directory = tmp_path_factory.mktemp("ants") / "unbroken"
    train(TINY, directory)
    return directory


def test_an_ants_run_is_judged_by_waypoints_and_goes_on_as_if_it_had_not_been_stopped(finished, tmp_path, monkeypatch):
    """Killed in the middle of a hundred steps, so that the direction must come back too."""
    play = online._play

    def dying(*arguments):
        if arguments[-1].step == 120:
            raise KeyboardInterrupt
        play(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(online, "_play", dying)
        train(TINY, tmp_path / "broken")
    train(TINY, tmp_path / "broken")
    unbroken, broken = (np.load(place / "replay.npy") for place in (finished, tmp_path / "broken"))
    np.testing.assert_array_equal(broken, unbroken)
    columns = Replay(finished / "replay.npy", AntTask(), 160).columns(160)
    np.testing.assert_allclose(columns["qpos"][:, 2:], columns["observations"][:, :13], atol=1e-5)
    np.testing.assert_allclose(columns["qvel"], columns["observations"][:, 13:27], atol=1e-5)
    (line,) = (json.loads(line) for line in (finished / "curve.jsonl").read_text().splitlines())
    assert line["episodes"] == 2 and line["success"] == 0.0 and 0.0 <= line["flipped"] <= 1.0
    assert abs(line["mean_speed"]) < 1.0


def test_the_exported_walker_is_the_snapshot_that_reaches_most_goals(finished, tmp_path, monkeypatch):
    for name, value in (("DIRECTIONS", 2), ("WALKS", 1), ("MAZE_WALKS", 2), ("MAZE_STEPS", 4)):
        monkeypatch.setattr(exporting, name, value)
    looked, made_up = exporting._look, {120: (0.9, 0.0), 160: (0.9, 0.1)}

    def look(step: int, *others) -> Look:
        reached, flipped = made_up[step]
        return dataclasses.replace(looked(step, *others), maze_reached=reached, maze_flipped=flipped)

    monkeypatch.setattr(exporting, "_look", look)
    facts = export_walker(finished, tmp_path / "policies", tmp_path / "ledger")
    assert facts["walker"]["step"] == 120 and len(facts["walker"]["success"]) == 2
    assert facts["training"]["command"] == "odaf behaviour train ant --seed 0 --steps 160 --batch-size 8"
    with np.load(tmp_path / "policies" / "ant.npz", allow_pickle=False) as arrays:
        assert arrays["weight_0"].dtype == np.float16
        ours = load_policy(finished / "snapshots" / "00000120.npz").weights[0]
        np.testing.assert_array_equal(arrays["weight_0"][0], ours.astype(np.float16))
    ledger = json.loads((tmp_path / "ledger" / "ant-seed0.json").read_text())
    assert [line["step"] for line in ledger["curve"]] == [160] and ledger["walker"]["step"] == 120
    assert {line["step"] for line in ledger["close_looks"]} == set(made_up)
    monkeypatch.setattr("odaf.environments.shipped_policies.files", lambda package: tmp_path)
    walker = shipped_walker()
    assert walker.facts["walker"]["step"] == 120 and walker.policy.weights[0].shape == (29, 8)
    with pytest.raises(ConfigError, match="holds no training run"):
        export_walker(tmp_path, tmp_path / "policies", tmp_path / "ledger")


def test_of_the_ant_there_is_one_version():
    with pytest.raises(ConfigError, match="version 'v4' of ant is not supported; supported is v0"):
        OnlineRun("ant")
    with pytest.raises(ConfigError, match="'cat' is not known; known are halfcheetah, hopper, walker2d, ant"):
        OnlineRun("cat")
