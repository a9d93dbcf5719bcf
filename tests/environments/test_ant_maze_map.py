"""Maps for the ant against published ones, hand-worked coordinates, and refusals of what is no maze."""

import json

import numpy as np
import pytest
from gymnasium_robotics.envs.maze import maps

from odaf.environments.ant_maze_map import ANT_MAZES, AntMazeMap
from odaf.errors import ConfigError

MARKED = {
    "umaze": [(3, 1)],
    "medium": [(6, 6)],
    "large": [(7, 9)],
    "medium-play": [(2, 6), (5, 1), (6, 5)],
    "large-play": [(1, 6), (3, 5), (3, 10), (5, 2), (7, 4), (7, 6), (7, 9)],
}


@pytest.mark.parametrize("name", list(ANT_MAZES))
def test_walls_are_those_of_gymnasium_robotics_and_the_marks_those_of_d4rl(name):
    maze = ANT_MAZES[name]
    published = {"umaze": maps.U_MAZE, "medium": maps.MEDIUM_MAZE, "large": maps.LARGE_MAZE}[name.split("-")[0]]
    assert maze.walls == tuple((int(i), int(j)) for i, j in np.argwhere(np.array(published) == 1))
    assert maze.start == (1, 1)
    assert list(maze.goals) == MARKED.get(name, list(maze.free))
    assert set(maze.starts) == set(maze.free) - set(MARKED.get(name, ()))


def test_the_plane_has_its_origin_at_the_start_and_y_downwards():
    large = ANT_MAZES["large"]
    assert large.centre((1, 1)) == (0.0, 0.0) and large.centre((7, 9)) == (32.0, 24.0)
    moved = AntMazeMap.of(["11111", "10001", "1g0r1", "11111"])
    assert moved.centre((2, 3)) == (0.0, 0.0) and moved.centre((1, 1)) == (-8.0, -4.0)
    for i, j in moved.free:
        x, y = moved.centre((i, j))
        for dx, dy in ((0.0, 0.0), (1.99, 1.99), (-1.99, 1.99), (1.99, -1.99)):
            assert moved.cell((x + dx, y + dy)) == (i, j)


def test_rows_may_be_texts_lists_or_an_array():
    texts = AntMazeMap.of(["1111", "1rg1", "1111"])
    assert AntMazeMap.of([[1, 1, 1, 1], [1, "r", "G", 1], [1, 1, 1, 1]]) == texts == AntMazeMap.of(texts)
    assert AntMazeMap.of(np.array([list(row) for row in texts.rows])) == texts
    assert AntMazeMap.of(json.loads(json.dumps(texts.rows))) == texts
    assert AntMazeMap.of("medium") is ANT_MAZES["medium"]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("tiny", "'tiny': is not known; known are umaze, umaze-diverse, medium"),
        (7, "expected a name or a list of rows such as '1r0g1', got 7"),
        ([1, 1, 1], "expected a name or a list of rows"),
        ([], "has no cells"),
        (["1111", "1rg1", "111"], "row 2 has 3 cells and row 0 has 4"),
        (["1111", "1rx1", "1111"], r"cell \(1, 2\) is 'x'; cells are '1' \(wall\), '0' \(free\)"),
        ([[1, 1, 1], [1, 2, 1], [1, 1, 1]], r"cell \(1, 1\) is '2'"),
        (["1111", "1rg0", "1111"], r"cell \(1, 3\) on the border is '0'; close it"),
        (["1g11", "1r01", "1111"], r"cell \(0, 1\) on the border is 'g'; close it"),
        (["111", "111", "111"], "has no free cell"),
        (["1111", "10g1", "1111"], "has 0 cells 'r'"),
        (["1111", "1rr1", "1111"], "has 2 cells 'r'"),
        (["11111", "1r1g1", "11111"], r"goal \(1, 3\) cannot be reached from the start \(1, 1\)"),
        (["111111", "1rg101", "111111"], r"free cell \(1, 4\) cannot be reached"),
    ],
)
def test_what_is_no_maze_is_refused(rows, message):
    with pytest.raises(ConfigError, match=f"ant maze.*{message}"):
        AntMazeMap.of(rows)
