"""Grids in which every move leads where it points, and a log of one path through them."""

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from odaf.theory.mdp import TabularMDP

Cell = tuple[int, int]
"""Row and column."""

MOVES: tuple[Cell, ...] = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""The actions in their order: north, east, south, west."""


@dataclass(frozen=True)
class Grid:
    """A map of `S` start, `G` goal, `X` trap, `.` free cells and `#` walls. A move into a wall stays where it is.

    Whoever is on the goal or in a trap stays there.

    Attributes:
        rows: the map, a text a row.
    """

    rows: tuple[str, ...]

    @property
    def cells(self) -> list[Cell]:
        """The states in their order: all cells but walls, row by row."""
        return [(r, c) for r, row in enumerate(self.rows) for c, sign in enumerate(row) if sign != "#"]

    def sign(self, cell: Cell) -> str:
        """What the map has there; a wall beyond its edges."""
        row, column = cell
        inside = 0 <= row < len(self.rows) and 0 <= column < len(self.rows[row])
        return self.rows[row][column] if inside else "#"

    def state(self, sign: str) -> int:
        """The state of the one cell with this sign."""
        (found,) = (state for state, cell in enumerate(self.cells) if self.sign(cell) == sign)
        return found

    def successors(self) -> Int[np.ndarray, "states actions"]:
        """The state where each move leads."""
        state = {cell: number for number, cell in enumerate(self.cells)}
        found = np.empty((len(state), len(MOVES)), int)
        for (row, column), number in state.items():
            stays = self.sign((row, column)) in "GX"
            for action, (down, right) in enumerate(MOVES):
                there = (row + down, column + right)
                found[number, action] = number if stays or self.sign(there) == "#" else state[there]
        return found

    def mdp(self, discount: float, trap_reward: float = 0.0) -> TabularMDP:
        """The decision problem: 1 for the move onto the goal, nothing for others.

        Args:
            discount: gamma.
            trap_reward: for the move into a trap; what a learner may wrongly believe of it.
        """
        to = self.successors()
        paid = np.array([{"G": 1.0, "X": trap_reward}.get(self.sign(cell), 0.0) for cell in self.cells])
        moved = to != np.arange(len(to))[:, None]
        return TabularMDP(np.eye(len(to))[to], np.where(moved, paid[to], 0.0), discount)


def snake(rows: int, columns: int) -> list[Cell]:
    """A path through every cell of a rectangle: east along the first row, west along the next, and so on."""
    return [(r, c) for r in range(rows) for c in (range(columns) if r % 2 == 0 else reversed(range(columns)))]


def logged_moves(
    grid: Grid, path: list[Cell]
) -> tuple[Bool[np.ndarray, "states actions"], Bool[np.ndarray, " states"]]:
    """What a log of one path holds: the moves that were made, and the states that were visited."""
    cells = grid.cells
    moves, visited = np.zeros((len(cells), len(MOVES)), bool), np.zeros(len(cells), bool)
    for before, after in itertools.pairwise(path):
        moves[cells.index(before), MOVES.index((after[0] - before[0], after[1] - before[1]))] = True
    visited[[cells.index(cell) for cell in path]] = True
    return moves, visited


def walk(grid: Grid, policy: Int[np.ndarray, " states"]) -> list[Cell]:
    """The cells that a policy visits from the start until it stays where it is or comes back to where it was."""
    to, state, visited = grid.successors(), grid.state("S"), []
    while state not in visited:
        visited.append(state)
        state = int(to[state, policy[state]])
    return [grid.cells[each] for each in visited]


def start_value(grid: Grid, values: Float[np.ndarray, " states"]) -> float:
    """The value at the start."""
    return float(values[grid.state("S")])
