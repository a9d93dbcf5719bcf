"""The way through the ant's mazes by hand, the walker's input, and a point that is led to every goal."""

import math

import numpy as np
import pytest

from odaf.environments.ant_maze_controller import WaypointController
from odaf.environments.ant_maze_map import ANT_MAZES


def controller(name: str) -> WaypointController:
    return WaypointController(ANT_MAZES[name], lambda inputs: inputs[:, -2:] / 10.0)


def waypoints(name: str, position: tuple[float, float], goal: tuple[float, float], draws: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    return controller(name).waypoints(np.tile(position, (draws, 1)), np.tile(goal, (draws, 1)), rng)


@pytest.mark.parametrize(
    ("position", "corner"),
    [
        ((0.0, 0.0), (4.0, 0.0)),  # start: to the right
        ((-1.5, -1.5), (4.0, 0.0)),  # still the start's cell
        ((3.9, 0.5), (4.0, 0.0)),  # the next centre has not been passed
        ((4.1, 0.5), (8.0, 0.0)),
        ((8.2, 0.1), (8.0, 4.0)),  # the corner: downwards
        ((8.2, 8.1), (4.0, 8.0)),  # the lower corner: to the left
        ((5.0, 7.0), (4.0, 8.0)),  # counts for a wall; its nearest neighbour on the way
    ],
)
def test_the_next_cell_of_umaze_by_hand(position, corner):
    offsets = waypoints("umaze", position, (0.7, 8.8)) - corner
    assert offsets.min() >= 0.0 and offsets.max() <= 1.0 and offsets.min() < 0.05 and offsets.max() > 0.95


@pytest.mark.parametrize("position", [(0.1, 8.1), (4.5, 8.2), (0.0, 9.0), (-1.0, 8.5)])
def test_the_goal_is_the_waypoint_once_its_cell_is_next(position):
    np.testing.assert_array_equal(waypoints("umaze", position, (0.7, 8.8), 1), [[0.7, 8.8]])


def test_the_walker_sees_the_body_and_a_direction_of_norm_ten():
    observations = np.random.default_rng(1).normal(size=(3, 29))
    observations[:, :2] = [[0.7, 8.8], [0.7, 5.8], [0.7, 8.8001]]
    goals = np.array([[0.7, 8.8], [3.7, 9.8], [0.7, 8.8]])
    inputs = controller("umaze").inputs(observations, goals, np.random.default_rng(0))
    np.testing.assert_array_equal(inputs[:, :27], observations[:, 2:])
    np.testing.assert_array_equal(inputs[0, 27:], [0.0, 0.0])
    np.testing.assert_allclose(inputs[2, 27:], [0.0, -10.0], atol=1e-9)
    actions = controller("umaze").act(observations, goals, np.random.default_rng(0))
    np.testing.assert_allclose(actions, inputs[:, 27:] / 10.0)


@pytest.mark.parametrize("name", ["umaze-diverse", "medium-diverse", "large-diverse"])
def test_a_point_that_slides_along_walls_is_led_from_everywhere_to_everywhere(name):
    maze, rng, lead = ANT_MAZES[name], np.random.default_rng(0), controller(name)
    starts = [maze.starts[index] for index in rng.integers(len(maze.starts), size=60)]
    goals = [maze.goals[index] for index in rng.integers(len(maze.goals), size=60)]
    positions = np.array([maze.centre(cell) for cell in starts]) + rng.uniform(0.0, 1.0, (60, 2))
    targets = np.array([maze.centre(cell) for cell in goals]) + rng.uniform(0.0, 1.5, (60, 2))
    reached = np.zeros(60, bool)
    for _ in range(500):
        directions = lead.act(np.concatenate([positions, np.zeros((60, 27))], axis=1), targets, rng)
        for point, (right, down) in enumerate(0.3 * directions):
            x, y = positions[point]
            x = x + right if maze.is_free(maze.cell((x + right, y))) else x
            y = y + down if maze.is_free(maze.cell((x, y + down))) else y
            positions[point] = x, y
            reached[point] |= math.dist((x, y), targets[point]) <= 0.5
        if reached.all():
            break
    assert reached.all()
