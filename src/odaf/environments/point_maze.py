"""A point mass in a maze, pushed by forces; the physics are those of PointMaze in gymnasium-robotics."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium_robotics.envs.maze.point_maze import PointMazeEnv

from odaf.environments.maze import Maze

SUCCESS_RADIUS = 0.45


class PointMaze(gymnasium.Env):
    """A ball that is pushed through a maze towards a target it cannot see.

    Observation: (x, y, vx, vy) float32; the target is not part of it. Action: force along x and y in [-1, 1], clipped.
    One step is 0.01 s; velocity is limited to 5 before each step. Start and target are the centres of their cells plus
    U(-0.25, 0.25) in x and y, drawn anew by every `reset`; a seed fixes both.

    Reward: exp(-distance to the target after the step), in (0, 1]. The task never terminates, reaching the target
    included; it is truncated after `steps` steps.

    `info["success"]`: now within 0.45 of this episode's own target. `info["stitched"]`: now within 0.45 of the centre
    of the goal's cell, and no cell of `maze.avoid` was visited in this episode so far.
    """

    metadata = {"render_modes": []}

    def __init__(self, maze: Maze | Mapping[str, Any], steps: int = 200):
        self.maze = maze if isinstance(maze, Maze) else Maze.from_dict(maze)
        self.steps = steps
        # Wrappers are left out, the physics are not: time limit, checks and dictionary observations cost more than
        # the simulation of one point.
        self._simulation = PointMazeEnv(
            maze_map=[[int(character) for character in row] for row in self.maze.rows],
            reward_type="dense",
            continuing_task=False,
        )
        Path(self._simulation.tmp_xml_file_path).unlink(missing_ok=True)  # loaded; the package leaves it behind
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._goal_centre = self.maze.centre(self.maze.goal)
        self._avoid = frozenset(self.maze.avoid)
        self._target = self._goal_centre
        self._step = 0
        self._detoured = False

    @property
    def target(self) -> np.ndarray:
        """[2] float64, the hidden target of this episode."""
        return self._target.copy()

    @property
    def state(self) -> np.ndarray:
        """[4] float64, the observation before it is rounded to single precision."""
        data = self._simulation.point_env.data
        return np.concatenate([data.qpos, data.qvel])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; `options["start"]` (a cell) replaces the maze's own start for this episode."""
        super().reset(seed=seed)
        start = (options or {}).get("start", self.maze.start)
        cells = {"goal_cell": np.array(self.maze.goal), "reset_cell": np.array(start)}
        self._simulation.reset(seed=seed, options=cells)
        self._target = np.array(self._simulation.goal, np.float64)
        self._step = 0
        self._detoured = False
        state = self.state
        return state.astype(np.float32), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        state, _, _, _, _ = self._simulation.point_env.step(np.asarray(action, np.float64))
        self._step += 1
        reward = float(np.exp(-np.hypot(*(state[:2] - self._target))))
        return state.astype(np.float32), reward, False, self._step >= self.steps, self._info(state)

    def close(self) -> None:
        self._simulation.close()

    def _info(self, state: np.ndarray) -> dict[str, Any]:
        position = state[:2]
        self._detoured = self._detoured or self.maze.cell(position) in self._avoid
        at_goal = np.hypot(*(position - self._goal_centre)) <= SUCCESS_RADIUS
        return {
            "success": bool(np.hypot(*(position - self._target)) <= SUCCESS_RADIUS),
            "stitched": bool(at_goal and not self._detoured),
        }
