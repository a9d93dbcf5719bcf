"""A maze as a drawing needs it: walls, letters and places in the plane."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from odaf.environments.maze import Cell, Maze

Point = tuple[float, float]

# S, G and M are start, goal and meeting point.
_LETTERS = "ABCDEFHIJKLNOPQRTUVWXYZ"


@dataclass(frozen=True)
class Layout:
    """Where things are in the plane; a cell is one unit wide and the origin is the centre of the map.

    Attributes:
        name: the maze's name.
        walls: centres of the wall cells.
        names: letter to centre: S the start, G the goal, M where the logged detour comes back to the direct way, and A,
            B, ... the detour's cells.
        start: centre of the start's cell.
        goal: centre of the goal's cell.
        view: left, right, bottom and top of what is worth drawing: the free cells and a rim of wall.
    """

    name: str
    walls: tuple[Point, ...]
    names: Mapping[str, Point]
    start: Point
    goal: Point
    view: tuple[float, float, float, float]


def maze_layout(environment: Mapping[str, Any] | None) -> Layout | None:
    """The maze of an environment as `data.json` describes it; `None` where it is none.

    Raises:
        ConfigError: it calls itself a maze, but the map makes no sense.
    """
    if (
        environment is None
        or environment.get("name") != "pointmaze"
        or not isinstance(environment.get("maze"), Mapping)
    ):
        return None
    maze = Maze.from_dict(environment["maze"])
    rows, columns = len(maze.rows), len(maze.rows[0])
    every = [(row, column) for row in range(rows) for column in range(columns)]
    lettered = {"S": maze.start, "G": maze.goal} | dict(zip(_LETTERS, maze.avoid, strict=False))
    meeting = meeting_cell(maze)
    if meeting is not None:
        lettered["M"] = meeting
    return Layout(
        name=maze.name,
        walls=tuple(_point(maze, cell) for cell in every if not maze.is_free(cell)),
        names={letter: _point(maze, cell) for letter, cell in lettered.items()},
        start=_point(maze, maze.start),
        goal=_point(maze, maze.goal),
        view=_view([_point(maze, cell) for cell in every if maze.is_free(cell)]),
    )


def meeting_cell(maze: Maze) -> Cell | None:
    """The last cell of the direct way, ends left out, beside which the logged detour passes."""
    way = maze.path(maze.start, maze.goal)[1:-1]
    beside = {
        (row + down, column + right) for row, column in maze.avoid for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    cells = [cell for cell in way if cell in beside and cell not in maze.avoid]
    return cells[-1] if cells else None


def _view(free: Sequence[Point], rim: float = 0.3) -> tuple[float, float, float, float]:
    across, up = [x for x, _ in free], [y for _, y in free]
    reach = 0.5 + rim
    return min(across) - reach, max(across) + reach, min(up) - reach, max(up) + reach


def _point(maze: Maze, cell: Cell) -> Point:
    x, y = maze.centre(cell)
    return float(x), float(y)
