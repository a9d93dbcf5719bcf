"""Maps that an ant walks through: walls, start and goals on a grid of cells four metres wide.

Source: the maps of D4RL (Fu et al. 2020). Medium and large have one goal where policies are evaluated, and several
where data are collected ("play"); where none is marked, any free cell is a goal ("diverse").
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from odaf.environments.maze import Cell, Maze
from odaf.errors import ConfigError

CELL = 4.0  # metres, along both axes

_LETTERS = "10rg"
_KNOWN = "'1' (wall), '0' (free), 'r' (where the ant is put) and 'g' (a goal)"


@dataclass(frozen=True)
class AntMazeMap:
    """A walled grid. Cell (i, j) is row i from the top, column j from the left, four metres wide.

    The origin of the plane is the centre of the start's cell, x to the right and y downwards, so the centre of cell
    (i, j) is x = 4 (j - start column), y = 4 (i - start row).

    Attributes:
        name: how messages call it.
        rows: one string a row, "1" a wall, "0" free, "r" the one start, "g" a goal; the border is wall. Without any
            "g" every free cell is a goal, the start's included.
    """

    name: str
    rows: tuple[str, ...]

    def __post_init__(self):
        title = f"ant maze '{self.name}'"
        if not self.rows or not self.rows[0]:
            raise ConfigError(f"{title}: has no cells; give a list of rows such as ['1111', '1rg1', '1111']")
        for i, row in enumerate(self.rows):
            if len(row) != len(self.rows[0]):
                raise ConfigError(
                    f"{title}: row {i} has {len(row)} cells and row 0 has {len(self.rows[0])}; rows are equally long"
                )
            for j, letter in enumerate(row):
                if letter not in _LETTERS:
                    raise ConfigError(f"{title}: cell {(i, j)} is {letter!r}; cells are {_KNOWN}")
                if letter != "1" and not (0 < i < len(self.rows) - 1 and 0 < j < len(row) - 1):
                    raise ConfigError(f"{title}: cell {(i, j)} on the border is {letter!r}; close it with a wall, '1'")
        if not self.free:
            raise ConfigError(f"{title}: has no free cell; mark one with 'r', where the ant is put")
        starts = [cell for cell in self.free if self._letter(cell) == "r"]
        if len(starts) != 1:
            raise ConfigError(f"{title}: has {len(starts)} cells 'r'; mark the one where the ant is put")
        within_reach = self.grid.distances(self.start)
        for cell in self.free:
            if cell not in within_reach:
                what = "goal" if self._letter(cell) == "g" else "free cell"
                raise ConfigError(
                    f"{title}: {what} {cell} cannot be reached from the start {self.start}; open a way, or wall it in"
                )

    @classmethod
    def of(cls, maze: Any) -> "AntMazeMap":
        """The map that `maze` names or lists.

        Args:
            maze: a name in `ANT_MAZES`; or rows, each a string or a list of cells, 0 and 1 as numbers or characters; or
                a map, which is returned.

        Raises:
            ConfigError: no maze has that name, or the rows make no maze.
        """
        if isinstance(maze, AntMazeMap):
            return maze
        if isinstance(maze, str):
            if maze not in ANT_MAZES:
                known = ", ".join(ANT_MAZES)
                raise ConfigError(f"ant maze '{maze}': is not known; known are {known}, or give the rows of your own")
            return ANT_MAZES[maze]
        rows = maze.tolist() if hasattr(maze, "tolist") else maze
        if not isinstance(rows, Sequence) or not all(isinstance(row, Sequence) for row in rows):
            raise ConfigError(f"ant maze: expected a name or a list of rows such as '1r0g1', got {maze!r}")
        return cls("custom", tuple("".join(str(cell).lower() for cell in row) for row in rows))

    @cached_property
    def free(self) -> tuple[Cell, ...]:
        """All cells that are no wall, row by row."""
        every = ((i, j) for i, row in enumerate(self.rows) for j in range(len(row)))
        return tuple(cell for cell in every if self._letter(cell) != "1")

    @cached_property
    def walls(self) -> tuple[Cell, ...]:
        """All cells that are wall, row by row."""
        every = ((i, j) for i, row in enumerate(self.rows) for j in range(len(row)))
        return tuple(cell for cell in every if self._letter(cell) == "1")

    @cached_property
    def start(self) -> Cell:
        """The cell at the origin of the plane."""
        return next(cell for cell in self.free if self._letter(cell) == "r")

    @cached_property
    def goals(self) -> tuple[Cell, ...]:
        """Cells that an episode's goal is drawn from: the marked ones, or all free ones where none is marked."""
        return tuple(cell for cell in self.free if self._letter(cell) == "g") or self.free

    @cached_property
    def starts(self) -> tuple[Cell, ...]:
        """Cells that random starts are drawn from: the free ones that are not marked as a goal."""
        return tuple(cell for cell in self.free if self._letter(cell) != "g")

    @cached_property
    def grid(self) -> Maze:
        """The same walls as a `Maze`, for shortest paths; its coordinates are not this map's."""
        plain = tuple("".join("1" if letter == "1" else "0" for letter in row) for row in self.rows)
        return Maze(self.name, plain, self.start, self.start)

    def is_free(self, cell: Cell) -> bool:
        """Whether `cell` is inside the map and not a wall."""
        row, column = cell
        return 0 <= row < len(self.rows) and 0 <= column < len(self.rows[0]) and self._letter(cell) != "1"

    def centre(self, cell: Cell) -> tuple[float, float]:
        """(x, y) of the middle of `cell`, metres."""
        return CELL * (cell[1] - self.start[1]), CELL * (cell[0] - self.start[0])

    def cell(self, position: tuple[float, float]) -> Cell:
        """The cell that (x, y) lies in; on an edge, the one below or to the right."""
        x, y = position
        return math.floor(y / CELL + 0.5) + self.start[0], math.floor(x / CELL + 0.5) + self.start[1]

    def _letter(self, cell: Cell) -> str:
        return self.rows[cell[0]][cell[1]]


def _marked(name: str, rows: Sequence[str], goals: Sequence[Cell]) -> AntMazeMap:
    cells = [list(row) for row in rows]
    for i, j in goals:
        cells[i][j] = "g"
    return AntMazeMap(name, tuple("".join(row) for row in cells))


_UMAZE = ("11111", "1r001", "11101", "10001", "11111")
_MEDIUM = ("11111111", "1r011001", "10010001", "11000111", "10010001", "10100101", "10001001", "11111111")
_LARGE = (
    "111111111111", "1r0001000001", "101101010101", "100000010001", "101111011101", "100101000001", "110101010111",
    "100100010001", "111111111111",
)  # fmt: skip

ANT_MAZES: Mapping[str, AntMazeMap] = {
    maze.name: maze
    for maze in (
        _marked("umaze", _UMAZE, [(3, 1)]),
        _marked("umaze-diverse", _UMAZE, []),
        _marked("medium", _MEDIUM, [(6, 6)]),
        _marked("medium-play", _MEDIUM, [(2, 6), (5, 1), (6, 5)]),
        _marked("medium-diverse", _MEDIUM, []),
        _marked("large", _LARGE, [(7, 9)]),
        _marked("large-play", _LARGE, [(1, 6), (3, 5), (3, 10), (5, 2), (7, 4), (7, 6), (7, 9)]),
        _marked("large-diverse", _LARGE, []),
    )
}
"""By name: `umaze`, `medium` and `large` are those of evaluation, the others those of collection."""

EVALUATED: Mapping[str, str] = {f"odaf/AntMaze-{name}-v0": name.lower() for name in ("UMaze", "Medium", "Large")}
"""The map of each id that gymnasium knows, those of maps of one's own left out."""

GOAL_OFFSET = 0.75  # metres from the centre of a goal's cell to the mean of the goals that are drawn there, in x and y


def map_of(environment: Mapping[str, Any]) -> AntMazeMap | None:
    """The map of an environment as a data set describes it; None where it is no ant maze of this package.

    Raises:
        ConfigError: its rows make no maze.
    """
    identity = str(environment.get("id")).rpartition(":")[2]
    if environment.get("name") != "gymnasium" or not identity.startswith("odaf/AntMaze-"):
        return None
    maze = (environment.get("kwargs") or {}).get("maze", EVALUATED.get(identity))
    return None if maze is None else AntMazeMap.of(maze)
