"""A scripted driver: it plans over cells and steers from waypoint to waypoint like a damped spring."""

import math

import numpy as np

from odaf.environments.maze import Cell, Maze

POSITION_GAIN = 10.0
DAMPING = 1.0
WAYPOINT_RADIUS = 0.1  # closer than this to a waypoint, the next one becomes current
WAYPOINT_NOISE = 0.2  # intermediate waypoints lie up to this far below and left of the cell's centre
GOAL_MOVED = 1e-3  # a goal that moved further than this is a new goal

Point = tuple[float, float]


class WaypointController:
    """Steers a point through the cells of a shortest path to a goal.

    The rules are those of the scripted driver that comes with the PointMaze environments: the first waypoint is the
    exact centre of the next cell, later ones are a centre minus U(0, 0.2) in x and y, the last is the goal itself. One
    consequence is kept: where the goal lies in the very next cell, the driver stays at that cell's centre, since the
    first waypoint is already in the goal's cell. One rule is ours: standing in the goal's cell, it steers to the goal.

    The plan is remembered between calls and renewed when the goal moves. Positions are plain floats: for two numbers
    array arithmetic costs more than the simulation.

    Args:
        maze: where it drives.
        rng: draws where waypoints lie.
        gain: force for a distance of one cell to the waypoint.
        damping: force against a velocity of one cell a second.
    """

    def __init__(self, maze: Maze, rng: np.random.Generator, gain: float = POSITION_GAIN, damping: float = DAMPING):
        self._maze = maze
        self._rng = rng
        self._gain, self._damping = gain, damping
        self._goal: Point | None = None
        self._cells: list[Cell] = []  # what is left of the path, the current waypoint's cell first
        self._waypoint: Point = (0.0, 0.0)

    def act(self, state: tuple[float, float, float, float], goal: Point) -> Point:
        """Force (along x, along y) in [-1, 1] in `state` = (x, y, vx, vy), heading for `goal` = (x, y)."""
        x, y, vx, vy = state
        if self._goal is None or math.dist(self._goal, goal) > GOAL_MOVED:
            self._plan((x, y), goal)
        if len(self._cells) > 1 and math.dist(self._waypoint, (x, y)) <= WAYPOINT_RADIUS:
            self._cells.pop(0)
            if len(self._cells) == 1:
                self._waypoint = goal
            else:
                centre, noise = self._maze.centre(self._cells[0]), self._rng.uniform(0.0, WAYPOINT_NOISE, 2).tolist()
                self._waypoint = (centre[0] - noise[0], centre[1] - noise[1])
        return (
            _clip(self._gain * (self._waypoint[0] - x) - self._damping * vx),
            _clip(self._gain * (self._waypoint[1] - y) - self._damping * vy),
        )

    def _plan(self, position: Point, goal: Point) -> None:
        self._goal = goal
        path = self._maze.path(self._maze.cell(position), self._maze.cell(goal))
        if len(path) == 1:
            self._cells, self._waypoint = path, goal
        else:
            self._cells, self._waypoint = path[1:], self._maze.centre(path[1])


def _clip(force: float) -> float:
    return max(-1.0, min(1.0, force))
