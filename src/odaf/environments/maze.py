"""Mazes on a grid of unit cells: walls, start, goal, the cells of the detour, and coordinates."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from odaf.errors import ConfigError

Cell = tuple[int, int]

_MOVES = ((0, 1), (0, -1), (-1, 0), (1, 0))  # right, left, up, down: the order of preference among equals


@dataclass(frozen=True)
class Maze:
    """A walled grid. Cell (i, j) is row i from the top, column j from the left, one unit wide.

    The origin of the plane is the centre of the grid, x to the right and y upwards, so the centre of cell (i, j) is
    x = j + 0.5 - columns / 2, y = rows / 2 - i - 0.5.

    Attributes:
        name: how reports call it.
        rows: one string per row, "1" a wall and "0" free; the border must be wall.
        start: where episodes begin.
        goal: where the reward's target lies.
        avoid: cells of the logged detour; a path that visits none of them and ends at the goal has been stitched.
    """

    name: str
    rows: tuple[str, ...]
    start: Cell
    goal: Cell
    avoid: tuple[Cell, ...] = ()

    def __post_init__(self):
        title = f"maze '{self.name}'"
        widths = {len(row) for row in self.rows}
        if len(widths) != 1 or widths == {0} or set("".join(self.rows)) - {"0", "1"}:
            raise ConfigError(
                f"{title}: rows must be equally long strings of '1' (wall) and '0' (free); got {self.rows}"
            )
        border = [self.rows[0], self.rows[-1], *(row[0] + row[-1] for row in self.rows)]
        if "0" in "".join(border):
            raise ConfigError(f"{title}: the border must be wall ('1') all around; got {self.rows}")
        for field, cell in (("start", self.start), ("goal", self.goal), *(("avoid", cell) for cell in self.avoid)):
            if not self.is_free(cell):
                raise ConfigError(f"{title}: {field} cell {cell} is a wall or outside the map {self.rows}")
        self.path(self.start, self.goal)

    def is_free(self, cell: Cell) -> bool:
        """Whether `cell` is inside the map and not a wall."""
        row, column = cell
        return 0 <= row < len(self.rows) and 0 <= column < len(self.rows[0]) and self.rows[row][column] == "0"

    def centre(self, cell: Cell) -> tuple[float, float]:
        """(x, y) of the middle of `cell`."""
        row, column = cell
        return column + 0.5 - len(self.rows[0]) / 2, len(self.rows) / 2 - row - 0.5

    def cell(self, position: tuple[float, float]) -> Cell:
        """The cell that (x, y) lies in; on an edge, the one below or to the right."""
        x, y = position
        return math.floor(len(self.rows) / 2 - y), math.floor(x + len(self.rows[0]) / 2)

    def distances(self, goal: Cell) -> dict[Cell, int]:
        """Steps to `goal` from every free cell that is connected with it, nearest first."""
        distance = {goal: 0}
        queue = deque([goal])
        while queue:
            cell = queue.popleft()
            for neighbour in _neighbours(cell):
                if self.is_free(neighbour) and neighbour not in distance:
                    distance[neighbour] = distance[cell] + 1
                    queue.append(neighbour)
        return distance

    def path(self, start: Cell, goal: Cell) -> list[Cell]:
        """A shortest path of neighbouring free cells, both ends included; ties go right, left, up, down.

        Raises:
            ConfigError: no free cells connect the two.
        """
        distance = self.distances(goal)
        if start not in distance:
            raise ConfigError(f"maze '{self.name}': no free cells connect {start} with {goal} in {self.rows}")
        path = [start]
        while path[-1] != goal:
            nearer = [cell for cell in _neighbours(path[-1]) if distance.get(cell) == distance[path[-1]] - 1]
            path.append(nearer[0])
        return path

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores an equal `Maze`."""
        fields = asdict(self)
        return {
            **fields,
            "rows": list(self.rows),
            "start": list(self.start),
            "goal": list(self.goal),
            "avoid": [list(cell) for cell in self.avoid],
        }

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "Maze":
        """Inverse of `to_dict`; `ConfigError` names fields that are missing or unknown."""
        known = {"name", "rows", "start", "goal", "avoid"}
        missing, unknown = {"rows", "start", "goal"} - set(fields), set(fields) - known
        if missing or unknown:
            raise ConfigError(f"maze: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")
        name = str(fields.get("name", "custom"))
        title = f"maze '{name}'"
        rows, avoid = fields["rows"], fields.get("avoid", ())
        if not isinstance(rows, (list, tuple)) or not all(isinstance(row, str) for row in rows):
            raise ConfigError(f"{title}: rows must be a list of strings such as '1001'; got {rows!r}")
        if not isinstance(avoid, (list, tuple)):
            raise ConfigError(f"{title}: avoid must be a list of cells (row, column); got {avoid!r}")
        return cls(
            name=name,
            rows=tuple(rows),
            start=as_cell(title, "start", fields["start"]),
            goal=as_cell(title, "goal", fields["goal"]),
            avoid=tuple(as_cell(title, "avoid", cell) for cell in avoid),
        )


def _neighbours(cell: Cell) -> list[Cell]:
    return [(cell[0] + down, cell[1] + right) for down, right in _MOVES]


def as_cell(title: str, field: str, value: Any) -> Cell:
    """`value` as (row, column); `ConfigError` begins with `title` and names `field`."""
    try:
        row, column = (int(part) for part in value)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{title}: {field} must be a cell (row, column); got {value!r}") from error
    return row, column


# The paper's: from the start down to the junction (2, 2) and right to the goal; the detour goes round by the left.
STITCH = Maze(
    name="stitch",
    rows=("111111", "100111", "100001", "111111"),
    start=(1, 2),
    goal=(2, 4),
    avoid=((1, 1), (2, 1)),
)

# Four arms meet at (3, 3): start in the south, goal in the east, dead end in the north; the detour leaves the start to
# the left and comes back to the crossing along the western arm.
CROSSROADS = Maze(
    name="crossroads",
    rows=("1111111", "1110111", "1110111", "1000001", "1010111", "1000111", "1111111"),
    start=(5, 3),
    goal=(3, 5),
    avoid=((5, 2), (5, 1), (4, 1), (3, 1), (3, 2)),
)

# A shaft: the good path falls straight from the start past the junction (2, 1) and turns at the bottom; the detour
# leaves the start to the right and comes back into the junction.
SHAFT = Maze(
    name="shaft",
    rows=("11111", "10011", "10011", "10111", "10011", "11111"),
    start=(1, 1),
    goal=(4, 2),
    avoid=((1, 2), (2, 2)),
)

# A ladder with three rungs: the good path is its lower side, from end to end. Drivers go round one of its two loops;
# those who go round the first come down the middle rung, those who go round the second climb it.
LADDER = Maze(
    name="ladder",
    rows=("1111111", "1000001", "1010101", "1000001", "1111111"),
    start=(3, 1),
    goal=(3, 5),
    avoid=((2, 1), (1, 1), (1, 2), (1, 3), (2, 3), (1, 4), (1, 5), (2, 5)),
)

MAZES: Mapping[str, Maze] = {maze.name: maze for maze in (STITCH, SHAFT, CROSSROADS, LADDER)}
