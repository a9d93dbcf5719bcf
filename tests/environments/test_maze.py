"""Grid geometry against hand-worked coordinates, shortest paths, and refusals of impossible mazes."""

import dataclasses
import json

import pytest

from odaf.environments.maze import CROSSROADS, MAZES, STITCH, Maze
from odaf.errors import ConfigError


def test_cell_centres_of_the_paper():
    """Cell (i, j) of the 4 x 6 map lies at x = j - 2.5, y = 1.5 - i."""
    centres = {(1, 2): (-0.5, 0.5), (2, 2): (-0.5, -0.5), (2, 4): (1.5, -0.5), (1, 1): (-1.5, 0.5)}
    assert {cell: STITCH.centre(cell) for cell in centres} == centres
    assert STITCH.start == (1, 2) and STITCH.goal == (2, 4) and STITCH.avoid == ((1, 1), (2, 1))


@pytest.mark.parametrize("maze", MAZES.values(), ids=list(MAZES))
def test_every_cell_contains_its_centre_and_its_inside(maze):
    for i in range(len(maze.rows)):
        for j in range(len(maze.rows[0])):
            x, y = maze.centre((i, j))
            for dx, dy in ((0, 0), (0.49, 0.49), (-0.49, 0.49), (0.49, -0.49)):
                assert maze.cell((x + dx, y + dy)) == (i, j)


def test_shortest_paths():
    assert STITCH.path(STITCH.start, STITCH.goal) == [(1, 2), (2, 2), (2, 3), (2, 4)]
    assert STITCH.path((1, 1), (2, 4)) == [(1, 1), (1, 2), (2, 2), (2, 3), (2, 4)]
    assert STITCH.path((2, 3), (2, 3)) == [(2, 3)]
    assert CROSSROADS.path(CROSSROADS.start, CROSSROADS.goal) == [(5, 3), (4, 3), (3, 3), (3, 4), (3, 5)]


def test_ties_go_left_before_down():
    """From (1, 2) to (2, 1) both corners are equally near."""
    assert STITCH.path((1, 2), (2, 1)) == [(1, 2), (1, 1), (2, 1)]


@pytest.mark.parametrize("maze", MAZES.values(), ids=list(MAZES))
def test_the_best_path_avoids_the_detour_and_the_dictionary_restores_the_maze(maze):
    assert not set(maze.path(maze.start, maze.goal)) & set(maze.avoid)
    assert Maze.from_dict(json.loads(json.dumps(maze.to_dict()))) == maze
    assert hash(maze) == hash(Maze.from_dict(maze.to_dict()))


WRONG = {
    "uneven": ({"rows": ("1111", "101")}, "rows must be equally long strings of '1' .wall. and '0'"),
    "letters": ({"rows": ("111", "1r1", "111")}, "rows must be equally long strings"),
    "nothing": ({"rows": ()}, "rows must be equally long strings"),
    "open": ({"rows": ("111111", "100111", "100000", "111111")}, "the border must be wall"),
    "start in a wall": ({"start": (0, 0)}, r"start cell \(0, 0\) is a wall or outside"),
    "goal outside": ({"goal": (9, 9)}, r"goal cell \(9, 9\) is a wall or outside"),
    "goal behind": ({"goal": (-2, -2)}, r"goal cell \(-2, -2\) is a wall or outside"),
    "avoid": ({"avoid": ((3, 3),)}, r"avoid cell \(3, 3\) is a wall"),
    "apart": (
        {"rows": ("11111", "10101", "11111"), "start": (1, 1), "goal": (1, 3), "avoid": ()},
        r"no free cells connect \(1, 1\) with \(1, 3\)",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_impossible_mazes_are_refused(name):
    changes, message = WRONG[name]
    with pytest.raises(ConfigError, match=f"^maze 'stitch': {message}"):
        dataclasses.replace(STITCH, **changes)


def test_dictionary_with_wrong_fields():
    with pytest.raises(ConfigError, match=r"missing fields \['goal', 'rows', 'start'\], unknown fields \['map'\]"):
        Maze.from_dict({"map": []})
    for changes, message in (
        ({"rows": [[1, 1], [1, 1]]}, r"rows must be a list of strings such as '1001'; got \[\[1, 1\]"),
        ({"start": "here"}, r"start must be a cell \(row, column\); got 'here'"),
        ({"avoid": 3}, r"avoid must be a list of cells"),
    ):
        with pytest.raises(ConfigError, match=f"^maze 'stitch': {message}"):
            Maze.from_dict({**STITCH.to_dict(), **changes})
    unnamed = Maze.from_dict({"rows": ["111", "101", "111"], "start": [1, 1], "goal": [1, 1]})
    assert unnamed.name == "custom"
