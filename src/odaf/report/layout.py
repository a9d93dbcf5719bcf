"""A maze as a drawing needs it: walls, letters and places in the plane."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from odaf.environments.ant_maze_map import CELL, GOAL_OFFSET, AntMazeMap, map_of
from odaf.environments.maze import Cell, Maze

Point = tuple[float, float]

# S, G and M are start, goal and meeting point.
_LETTERS = "ABCDEFHIJKLNOPQRTUVWXYZ"
_REACHED = 0.45, 0.5 + GOAL_OFFSET  # from the middle of the goal, in a point maze and in an ant maze


@dataclass(frozen=True)
class Layout:
    """Where things are in the plane.

    Attributes:
        name: the maze's name.
        walls: centres of the wall cells.
        names: letter to centre: S the start, G the goal, M where the logged detour comes back to the direct way, and A,
            B, ... the detour's cells.
        start: centre of the start's cell.
        goal: where the goal is, or the middle of where goals are drawn; None in a maze with goals in several cells.
        view: left, right, bottom and top of what is worth drawing: the free cells and a rim of wall. Where y points
            downwards, bottom is above top.
        cell: width of a cell.
        reached: how far from `goal` an episode may have reached it.
        hidden: whether each episode has a goal of its own around `goal`.
    """

    name: str
    walls: tuple[Point, ...]
    names: Mapping[str, Point]
    start: Point
    goal: Point | None
    view: tuple[float, float, float, float]
    cell: float = 1.0
    reached: float = _REACHED[0]
    hidden: bool = False

    @property
    def aspect(self) -> float:
        """Height of the view, over its width."""
        left, right, bottom, top = self.view
        return abs(top - bottom) / (right - left)


def maze_layout(environment: Mapping[str, Any] | None) -> Layout | None:
    """The maze of an environment as `data.json` describes it; `None` where it is none.

    Raises:
        ConfigError: it calls itself a maze, but the map makes no sense.
    """
    if environment is None:
        return None
    if (ants := map_of(environment)) is not None:
        return _ant_maze(ants)
    if environment.get("name") != "pointmaze" or not isinstance(environment.get("maze"), Mapping):
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


def _ant_maze(maze: AntMazeMap) -> Layout:
    goals = () if maze.goals == maze.free else maze.goals  # none is marked where every cell may be one
    names = {"S": maze.centre(maze.start)}
    for number, cell in enumerate(goals, 1):
        names["G" if len(goals) == 1 else f"G{number}"] = maze.centre(cell)
    left, right, low, high = _view([maze.centre(cell) for cell in maze.free], CELL)
    return Layout(
        name=maze.name,
        walls=tuple(maze.centre(cell) for cell in maze.walls),
        names=names,
        start=names["S"],
        goal=(names["G"][0] + GOAL_OFFSET, names["G"][1] + GOAL_OFFSET) if "G" in names else None,
        view=(left, right, high, low),
        cell=CELL,
        reached=_REACHED[1],
        hidden=True,
    )


def meeting_cell(maze: Maze) -> Cell | None:
    """The last cell of the direct way, ends left out, beside which the logged detour passes."""
    way = maze.path(maze.start, maze.goal)[1:-1]
    beside = {
        (row + down, column + right) for row, column in maze.avoid for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    cells = [cell for cell in way if cell in beside and cell not in maze.avoid]
    return cells[-1] if cells else None


def _view(free: Sequence[Point], cell: float = 1.0, rim: float = 0.3) -> tuple[float, float, float, float]:
    across, up = [x for x, _ in free], [y for _, y in free]
    reach = (0.5 + rim) * cell
    return min(across) - reach, max(across) + reach, min(up) - reach, max(up) + reach


def _point(maze: Maze, cell: Cell) -> Point:
    x, y = maze.centre(cell)
    return float(x), float(y)
