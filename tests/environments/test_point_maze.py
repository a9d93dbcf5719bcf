"""The point maze against the package it takes its physics from, against hand-worked numbers, and its flags."""

import math

import gymnasium
import numpy as np
import pytest

from odaf.environments.maze import CROSSROADS, STITCH, Maze
from odaf.environments.point_maze import PointMaze


def packaged(maze):
    rows = [[int(character) for character in row] for row in maze.rows]
    rows[maze.start[0]][maze.start[1]] = "r"  # type: ignore[call-overload]
    rows[maze.goal[0]][maze.goal[1]] = "g"  # type: ignore[call-overload]
    return gymnasium.make("PointMaze_UMazeDense-v3", maze_map=rows, continuing_task=False).unwrapped


@pytest.mark.parametrize("maze", [STITCH, CROSSROADS], ids=["stitch", "crossroads"])
def test_same_bits_as_the_package(maze):
    """Same seeds and forces, walls included: states, rewards and success agree exactly with `PointMazeEnv`."""
    reference, environment = packaged(maze), PointMaze(maze)
    rng = np.random.default_rng(0)
    push, bumps = np.zeros(2), 0
    for seed in (0, 1, 999):
        theirs, _ = reference.reset(seed=seed)
        environment.reset(seed=seed)
        np.testing.assert_array_equal(theirs["observation"], environment.state)
        np.testing.assert_array_equal(theirs["desired_goal"], environment.target)
        for step in range(200):
            if step % 25 == 0:
                push = rng.uniform(-1.5, 1.5, 2)  # held long enough to hit walls, and beyond the limits
            theirs, reward, _, _, info = reference.step(push)
            ours = environment.step(push)
            np.testing.assert_array_equal(theirs["observation"], environment.state)
            assert ours[1] == pytest.approx(float(reward), rel=1e-14)
            assert ours[4]["success"] == info["success"]
            bumps += abs(environment.state[2]) < 0.1 and abs(push[0]) > 0.5
    assert bumps > 10
    reference.close()


def test_first_step_by_hand():
    """A ball of radius 0.1 and density 1000, pushed by 100 N, damping 1, semi-implicit Euler steps of 0.01 s."""
    environment = PointMaze(STITCH)
    environment.reset(seed=0)
    x, y, vx, vy = environment.state
    assert vx == vy == 0.0
    mass = 1000 * 4 / 3 * math.pi * 0.1**3
    speed = 0.01 * 100 / (mass + 0.01 * 1)
    observation, reward, terminated, truncated, _ = environment.step([1.0, -0.5])
    expected = [x + 0.01 * speed, y - 0.005 * speed, speed, -0.5 * speed]
    np.testing.assert_allclose(environment.state, expected, rtol=1e-12)
    np.testing.assert_array_equal(observation, np.array(environment.state, np.float32))
    assert observation.dtype == np.float32 and environment.observation_space.contains(observation)
    distance = math.hypot(x + 0.01 * speed - environment.target[0], y - 0.005 * speed - environment.target[1])
    assert reward == pytest.approx(math.exp(-distance), rel=1e-12)
    assert not terminated and not truncated


def test_start_and_target_noise():
    environment = PointMaze(STITCH)
    starts, targets = [], []
    for seed in range(300):
        observation, info = environment.reset(seed=seed)
        assert not info["success"] and not info["stitched"]
        starts.append(observation[:2] - np.array([-0.5, 0.5]))
        targets.append(np.array(environment.target) - [1.5, -0.5])
    for noise in (np.array(starts), np.array(targets)):
        assert np.abs(noise).max() <= 0.25
        assert np.abs(noise).max() > 0.24
        # Uniform on [-0.25, 0.25]: standard deviation 0.144; limits are 5 standard errors wide (1 false alarm in 1e6).
        np.testing.assert_allclose(noise.mean(axis=0), 0, atol=5 * 0.144 / math.sqrt(300))
    assert abs(np.corrcoef(np.array(starts).T, np.array(targets).T)[0, 2]) < 0.3


def test_seeds_repeat_and_an_unseeded_reset_goes_on():
    environment = PointMaze(STITCH)
    first, _ = environment.reset(seed=5)
    second, _ = environment.reset()
    assert (first != second).any()
    np.testing.assert_array_equal(environment.reset(seed=5)[0], first)
    np.testing.assert_array_equal(PointMaze(STITCH).reset(seed=5)[0], first)


def test_another_start_cell():
    observation, _ = PointMaze(STITCH).reset(seed=0, options={"start": (1, 1)})
    assert STITCH.cell((float(observation[0]), float(observation[1]))) == (1, 1)


def test_forces_are_clipped_speed_is_limited_and_nan_is_no_force():
    strong, unit, idle = PointMaze(STITCH), PointMaze(STITCH), PointMaze(STITCH)
    for environment in (strong, unit, idle):
        environment.reset(seed=0)
    np.testing.assert_array_equal(strong.step([1000.0, -1000.0])[0], unit.step([1.0, -1.0])[0])
    np.testing.assert_array_equal(idle.step([np.nan, 1.0])[0][2:], [0.0, 0.0])
    corridor = PointMaze(Maze("corridor", ("1" * 30, "1" + "0" * 28 + "1", "1" * 30), (1, 1), (1, 28)))
    corridor.reset(seed=0)
    speeds = [float(corridor.step([1.0, 0.0])[0][2]) for _ in range(60)]
    # The limit acts before a step, which then adds at most one step's worth of speed.
    assert 5.0 < max(speeds) < 5.0 + 0.2382


def test_episode_is_cut_and_never_terminates():
    environment = PointMaze(STITCH, steps=7)
    environment.reset(seed=0)
    ends = [environment.step([0.0, 0.0])[2:4] for _ in range(7)]
    assert ends == [(False, False)] * 6 + [(False, True)]


def drive(environment, cells, steps=60):
    """Pushes towards the centres of `cells` in turn, with brakes; returns the flags after each step."""
    flags = []
    for cell in cells:
        x, y = environment.maze.centre(cell)
        for _ in range(steps):
            state = environment.state
            _, _, _, _, info = environment.step([4 * (x - state[0]) - state[2], 4 * (y - state[1]) - state[3]])
            flags.append((info["success"], info["stitched"]))
    return flags


@pytest.mark.parametrize(
    ("maze", "direct", "detour"),
    [
        (STITCH, [(2, 2), (2, 3), (2, 4)], [(1, 1), (2, 1), (2, 2), (2, 4)]),
        (CROSSROADS, [(4, 3), (3, 3), (3, 5)], [(5, 1), (3, 1), (3, 3), (3, 5)]),
    ],
    ids=["stitch", "crossroads"],
)
def test_flags_of_a_direct_drive_and_of_the_detour(maze, direct, detour):
    environment = PointMaze(maze)
    environment.reset(seed=0)
    flags = drive(environment, direct)
    assert flags[-1] == (True, True) and not any(stitched for _, stitched in flags[:60])
    environment.reset(seed=0)
    flags = drive(environment, detour)
    assert flags[-1] == (True, False) and not any(stitched for _, stitched in flags)
    # A new episode forgets the old one's detour; leaving the goal takes both flags back.
    environment.reset(seed=1)
    assert drive(environment, direct)[-1][1]
    assert drive(environment, direct[-2:-1])[-1] == (False, False)


def test_success_is_about_the_hidden_target_and_stitched_about_the_cell():
    environment = PointMaze(STITCH)
    environment.reset(seed=0)
    drive(environment, [(2, 2), (2, 3)])
    differing = set()
    for _ in range(100):
        state = environment.state
        _, _, _, _, info = environment.step([1.0 - state[2], -state[3]])
        to_target = math.dist(environment.state[:2], environment.target)
        to_centre = math.dist(environment.state[:2], (1.5, -0.5))
        assert info["success"] == (to_target <= 0.45)
        assert info["stitched"] == (to_centre <= 0.45)
        differing.add((info["success"], info["stitched"]))
    assert len(differing) >= 3


def test_many_environments_share_one_compiled_map():
    environments = [PointMaze(STITCH.to_dict()) for _ in range(3)]
    assert len({id(environment._model) for environment in environments}) == 1
    for seed, environment in enumerate(environments):
        environment.reset(seed=seed)
    environments[0].step([1.0, 1.0])
    assert environments[1].state[2:] == (0.0, 0.0)
