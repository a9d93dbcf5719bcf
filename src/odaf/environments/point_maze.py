"""A point mass in a maze, pushed by forces; the physics are those of PointMaze in gymnasium-robotics."""

import contextlib
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from mujoco import mj_forward, mj_step  # pyright: ignore[reportAttributeAccessIssue] (compiled, without stubs)

from odaf.environments.maze import Maze

with contextlib.redirect_stderr(io.StringIO()):  # the package prints a notice about environments we do not use
    from gymnasium_robotics.envs.maze.point_maze import PointMazeEnv

SUCCESS_RADIUS = 0.45
MAX_SPEED = 5.0

State = tuple[float, float, float, float]


class PointMaze(gymnasium.Env):
    """A ball that is pushed through a maze towards a target it cannot see.

    Observation: (x, y, vx, vy) float32; the target is not part of it. Action: force along x and y, clipped to [-1, 1];
    where either is NaN there is no force, as the simulator itself decides. One step is 0.01 s; velocity is limited to 5
    along each axis before each step. Start and target are the centres of their cells plus U(-0.25, 0.25) in x and y,
    drawn anew by every `reset`; a seed fixes both.

    Reward: exp(-distance to the target after the step), in (0, 1]. The task never terminates, reaching the target
    included; it is truncated after `steps` steps.

    `info["success"]`: now within 0.45 of this episode's own target. `info["stitched"]`: now within 0.45 of the centre
    of the goal's cell, and no cell of `maze.avoid` was visited in this episode so far.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own declaration)

    def __init__(self, maze: Maze | Mapping[str, Any], steps: int = 200):
        self.maze = maze if isinstance(maze, Maze) else Maze.from_dict(maze)
        self.steps = steps
        self._simulation = PointMazeEnv(
            maze_map=[[int(character) for character in row] for row in self.maze.rows],
            reward_type="dense",
            continuing_task=False,
        )
        Path(self._simulation.tmp_xml_file_path).unlink(missing_ok=True)  # loaded; the package leaves it behind
        data = self._simulation.point_env.data
        self._model, self._data = self._simulation.point_env.model, data
        # Views of the simulator's memory, valid for its life.
        self._position, self._velocity, self._force = data.qpos, data.qvel, data.ctrl
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._goal_centre = self.maze.centre(self.maze.goal)
        self._avoid = frozenset(self.maze.avoid)
        self._target = self._goal_centre
        self._step = 0
        self._detoured = False

    @property
    def target(self) -> tuple[float, float]:
        """(x, y) of the hidden target of this episode."""
        return self._target

    @property
    def state(self) -> State:
        """(x, y, vx, vy): the observation before it is rounded to single precision."""
        return (*self._position.tolist(), *self._velocity.tolist())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; `options["start"]` (a cell) replaces the maze's own start for this episode."""
        super().reset(seed=seed)
        start = (options or {}).get("start", self.maze.start)
        cells: dict[str, np.ndarray | None] = {
            "goal_cell": np.array(self.maze.goal),
            "reset_cell": np.array(start),
        }
        self._simulation.reset(seed=seed, options=cells)
        x, y = self._simulation.goal.tolist()
        self._target = (x, y)
        self._step = 0
        self._detoured = False
        return np.array(self.state, np.float32), self._info(self.state)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        # The simulator is stepped directly, in the order and with the numbers of the package's own `step`: its
        # wrappers cost several times what the physics of one point do.
        force = [float(part) for part in action]
        if any(math.isnan(part) for part in force):
            force = [0.0, 0.0]
        self._velocity[:] = [max(-MAX_SPEED, min(MAX_SPEED, part)) for part in self._velocity.tolist()]
        mj_forward(self._model, self._data)
        self._force[:] = [max(-1.0, min(1.0, part)) for part in force]
        mj_step(self._model, self._data)
        self._step += 1
        state = self.state
        reward = math.exp(-math.dist(state[:2], self._target))
        return np.array(state, np.float32), reward, False, self._step >= self.steps, self._info(state)

    def close(self) -> None:
        self._simulation.close()

    def _info(self, state: State) -> dict[str, Any]:
        position = state[:2]
        self._detoured = self._detoured or self.maze.cell(position) in self._avoid
        at_goal = math.dist(position, self._goal_centre) <= SUCCESS_RADIUS
        return {
            "success": math.dist(position, self._target) <= SUCCESS_RADIUS,
            "stitched": at_goal and not self._detoured,
        }
