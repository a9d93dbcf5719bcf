"""Leading an ant that can walk through a maze: the way over its cells, waypoints on it, and the walker's input.

Source: the controller that D4RL's ant-maze data were recorded with (Fu et al. 2020, and its code). Where two ways are
equally short ours prefers right, left, up, down; D4RL's choice depends on the order of its search.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from odaf.environments.ant_maze_map import CELL, AntMazeMap
from odaf.environments.maze import Cell

WAYPOINT_NOISE = 1.0  # metres
DIRECTION_NORM = 10.0  # what a walker was trained on, whatever the distance

Walk = Callable[[np.ndarray], np.ndarray]


def walker_inputs(observations: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """What a walker is shown: [ants, 29], 27 numbers of the body and the direction, two of norm 10.

    Args:
        observations: [ants, 29] of `AntMaze`.
        directions: [ants, 2] to go in, of any length.
    """
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    norms = np.maximum(norms, 1e-9)  # who stands on the waypoint has no direction
    return np.concatenate([observations[:, 2:], DIRECTION_NORM * directions / norms], axis=1)


class WaypointController:
    """Walks ants to their goals, cell by cell.

    A position's cell is told by the centres: it counts for the cell whose centre was passed last, to the right and
    downwards, so that an ant crosses a cell to its middle before it turns. The waypoint is the centre of the next cell
    of a shortest way plus U(0, 1) in x and y, drawn anew for every step; the goal itself where the next cell is the
    goal's.
    """

    def __init__(self, maze: AntMazeMap, walk: Walk):
        """
        Args:
            maze: where the ants are.
            walk: a policy that walks: [ants, 29] to actions [ants, 8]. Its input is the observation without x and y (27
                numbers), then the direction to go in, two numbers of norm 10.
        """
        self.maze, self.walk = maze, walk
        self._distances = lru_cache(maxsize=None)(maze.grid.distances)

    def act(self, observations: np.ndarray, goals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Actions [ants, 8] for observations [ants, 29] of `AntMaze` and goals [ants, 2], as the walker gives them."""
        return self.walk(self.inputs(observations, goals, rng))

    def inputs(self, observations: np.ndarray, goals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What the walker is shown on its way to its goal, see `walker_inputs`."""
        positions = observations[:, :2]
        return walker_inputs(observations, self.waypoints(positions, goals, rng) - positions)

    def waypoints(self, positions: np.ndarray, goals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """[ants, 2] where ants at `positions` [ants, 2] are to go next on their ways to `goals` [ants, 2], metres."""
        points = np.array(goals, np.float64)
        for ant, (position, goal) in enumerate(zip(positions.tolist(), goals.tolist(), strict=True)):
            target = self._cell(position)
            last = self._cell(goal)
            if target != last:
                target = self._next(target, last)
            if target != last:
                points[ant] = self.maze.centre(target) + rng.uniform(0.0, WAYPOINT_NOISE, 2)
        return points

    def _cell(self, position: list[float]) -> Cell:
        """The cell whose centre lies last before a position, to the left and above, inside the border."""
        row = math.floor(position[1] / CELL) + self.maze.start[0]
        column = math.floor(position[0] / CELL) + self.maze.start[1]
        return min(max(row, 1), len(self.maze.rows) - 2), min(max(column, 1), len(self.maze.rows[0]) - 2)

    def _next(self, cell: Cell, last: Cell) -> Cell:
        """The neighbour of `cell` that is nearest to `last`; `cell` may be a wall, at whose lower right an ant is."""
        distances, (row, column) = self._distances(last), cell
        beside = ((row, column + 1), (row, column - 1), (row - 1, column), (row + 1, column))
        return min((each for each in beside if each in distances), key=distances.__getitem__, default=last)
