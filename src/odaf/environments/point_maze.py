"""A point mass in a maze, pushed by forces; the physics are those of PointMaze in gymnasium-robotics."""

import contextlib
import functools
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from odaf.environments.contact_margins import ContactMargins, set_rule
from odaf.environments.maze import Cell, Maze

with contextlib.redirect_stderr(io.StringIO()):  # the package prints a notice about environments we do not use
    from gymnasium_robotics.envs.maze.point_maze import PointMazeEnv

# The compiled module comes without stubs.
_mj_forward, _mj_step, _mj_reset_data, _MjData = (
    getattr(mujoco, name) for name in ("mj_forward", "mj_step", "mj_resetData", "MjData")
)

SUCCESS_RADIUS = 0.45
POSITION_NOISE = 0.25
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

    The simulator is driven directly, in the order and with the numbers of gymnasium-robotics' `PointMazeEnv` (seeded
    alike, both give the same bits), because its layers cost several times what the physics of one point do. Objects
    with the same map share the compiled model, so fifty of them are cheap.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own declaration)

    def __init__(self, maze: Maze | Mapping[str, Any], steps: int = 200, contact_margins: ContactMargins | None = None):
        self.maze = maze if isinstance(maze, Maze) else Maze.from_dict(maze)
        self.steps = steps
        self._model = _compiled(self.maze.rows, contact_margins)
        self._data = _MjData(self._model)
        # Views of the simulator's memory, valid for its life.
        self._position, self._velocity, self._force = self._data.qpos, self._data.qvel, self._data.ctrl
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._goal_centre = self.maze.centre(self.maze.goal)
        self._avoid = frozenset(self.maze.avoid)
        self._target = self._goal_centre
        self._state: State = (*self.maze.centre(self.maze.start), 0.0, 0.0)
        self._step = 0
        self._detoured = False

    @property
    def target(self) -> tuple[float, float]:
        """(x, y) of the hidden target of this episode."""
        return self._target

    @property
    def state(self) -> State:
        """(x, y, vx, vy): the observation before it is rounded to single precision."""
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; `options["start"]` (a cell) replaces the maze's own start for this episode."""
        super().reset(seed=seed)
        self._target = self._near(self.maze.goal)  # drawn before the start, as the package does
        start = self._near((options or {}).get("start", self.maze.start))
        _mj_reset_data(self._model, self._data)
        self._position[:] = start
        self._velocity[:] = 0.0
        _mj_forward(self._model, self._data)
        self._state = (*start, 0.0, 0.0)
        self._step = 0
        self._detoured = False
        return np.array(self._state, np.float32), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        right, up = float(action[0]), float(action[1])
        if math.isnan(right) or math.isnan(up):
            right = up = 0.0
        self._velocity[:] = _limit(self._state[2], MAX_SPEED), _limit(self._state[3], MAX_SPEED)
        _mj_forward(self._model, self._data)
        self._force[:] = _limit(right, 1.0), _limit(up, 1.0)
        _mj_step(self._model, self._data)
        self._step += 1
        self._state = state = (*self._position.tolist(), *self._velocity.tolist())
        reward = math.exp(-math.dist(state[:2], self._target))
        return np.array(state, np.float32), reward, False, self._step >= self.steps, self._info()

    def _near(self, cell: Cell) -> tuple[float, float]:
        x, y = self.maze.centre(cell)
        right = float(self.np_random.uniform(-POSITION_NOISE, POSITION_NOISE))
        up = float(self.np_random.uniform(-POSITION_NOISE, POSITION_NOISE))
        return x + right, y + up

    def _info(self) -> dict[str, Any]:
        position = self._state[:2]
        self._detoured = self._detoured or self.maze.cell(position) in self._avoid
        at_goal = math.dist(position, self._goal_centre) <= SUCCESS_RADIUS
        return {
            "success": math.dist(position, self._target) <= SUCCESS_RADIUS,
            "stitched": at_goal and not self._detoured,
        }


@functools.lru_cache(maxsize=16)
def _compiled(rows: tuple[str, ...], rule: ContactMargins | None = None) -> Any:
    """The simulator's model of a map; compiling draws textures nobody looks at and takes far longer than an episode."""
    environment = PointMazeEnv(maze_map=[[int(character) for character in row] for row in rows])
    Path(environment.tmp_xml_file_path).unlink(missing_ok=True)  # loaded; the package leaves it behind
    model = environment.model
    environment.close()
    set_rule(model, rule)
    return model


def _limit(value: float, bound: float) -> float:
    return bound if value > bound else -bound if value < -bound else value
