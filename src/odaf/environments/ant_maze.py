"""An ant in a maze: D4RL's AntMaze (Fu et al. 2020), for the MuJoCo that is installed today."""

import math
from typing import Any

import gymnasium
import mujoco
import numpy as np

from odaf.environments import contact_margins as margins
from odaf.environments.ant_maze_map import AntMazeMap
from odaf.environments.ant_maze_model import TORQUE, ant_model
from odaf.environments.maze import Cell
from odaf.errors import ConfigError

# The compiled module comes without stubs.
_mj_forward, _mj_step, _mj_reset_data, _mj_normalize_quaternions, _MjData = (
    getattr(mujoco, name) for name in ("mj_forward", "mj_step", "mj_resetData", "mj_normalizeQuat", "MjData")
)

SUCCESS_RADIUS = 0.5  # metres
FRAME_SKIP = 5
_POSE_NOISE, _START_NOISE = 0.1, 1.0
_GOAL_NOISE = 1.0, 0.5

MODES = ("evaluation", "collection")


class AntMaze(gymnasium.Env, gymnasium.utils.EzPickle):
    """An ant that is to walk to a goal it cannot see; the axes of the plane are those of `AntMazeMap`.

    Observation: 29 numbers, float64: x, y and height of the torso, its quaternion, eight joint angles (`qpos`), and the
    fourteen velocities (`qvel`). The goal is no part of it. Action: eight numbers in [-1, 1], clipped there, for
    torques up to 30; where one is NaN there is no torque, as the simulator itself decides. One step is 0.1 s.

    Start: the model's own pose plus U(-0.1, 0.1), velocities N(0, 0.1^2). With `random_start`, x and y are instead the
    centre of a free cell that is not marked as a goal plus U(0, 1). Goal: the centre of one of the map's goals plus
    U(0, 1) plus U(0, 0.5), in x and y, drawn anew by every `reset`. A seed fixes all.

    Reward: 1 within 0.5 m of the goal after the step, else 0. A fall ends nothing. In the mode "evaluation" the task
    terminates at the goal, so that the return is 1 for success and 0 for failure; in the mode "collection" it goes on
    there. There is no time limit here; the registered ids have D4RL's.

    `info["success"]`: now within 0.5 m. `info["goal"]`: its x and y. `info["qpos"]`, `info["qvel"]`: the body's state.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own declaration)

    def __init__(
        self,
        maze: Any,
        mode: str = "evaluation",
        random_start: bool = False,
        contact_margins: str | None = "larger",
    ):
        """
        Args:
            maze: a name in `ANT_MAZES`, or rows of your own, see `AntMazeMap.of`.
            mode: "evaluation", where the goal ends an episode, or "collection", where it does not.
            random_start: whether episodes begin anywhere, as in most of D4RL's data, or in the start's cell.
            contact_margins: how MuJoCo counts the margins of two parts that touch; "larger" is the body of D4RL's data
                with any version, "added" that of MuJoCo 3.5.0 and newer, None the one of the installed version.

        Raises:
            ConfigError: the map makes no maze, or there is no such mode or rule.
        """
        gymnasium.utils.EzPickle.__init__(self, maze, mode, random_start, contact_margins)
        if mode not in MODES:
            raise ConfigError(f"ant maze: mode is {mode!r}; give 'evaluation' or 'collection'")
        self.maze, self.mode, self.random_start = AntMazeMap.of(maze), mode, bool(random_start)
        self.model = ant_model(self.maze)
        rule = margins.check(contact_margins)
        margins.set_rule(self.model, rule)
        self.contact_margins = rule or margins.installed_rule()
        self.data = _MjData(self.model)
        # Views of the simulator's memory, valid for its life.
        self._qpos, self._qvel, self._torques = self.data.qpos, self.data.qvel, self.data.ctrl
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (29,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (8,), np.float32)
        self._goal = self.maze.centre(self.maze.goals[0])

    @property
    def goal(self) -> tuple[float, float]:
        """(x, y) of the hidden goal of this episode."""
        return self._goal

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; `options["start"]` and `options["goal"]`, cells, take the place of the drawn ones."""
        super().reset(seed=seed)
        options = options or {}
        goal = self._chosen(options, "goal") or self._any(self.maze.goals)
        self._goal = self._beside(goal, *_GOAL_NOISE)
        _mj_reset_data(self.model, self.data)
        qpos = self.model.qpos0 + self.np_random.uniform(-_POSE_NOISE, _POSE_NOISE, 15)
        qvel = _POSE_NOISE * self.np_random.standard_normal(14)
        start = self._chosen(options, "start") or (self._any(self.maze.starts) if self.random_start else None)
        if start is not None:
            qpos[:2] = self._beside(start, _START_NOISE)
        self.place(qpos, qvel)
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        torques = np.clip(np.asarray(action, np.float64), -1.0, 1.0) * TORQUE
        self._torques[:] = 0.0 if np.isnan(torques).any() else torques
        _mj_step(self.model, self.data, FRAME_SKIP)
        info = self._info()
        reached = info["success"]
        return self._observation(), float(reached), reached and self.mode == "evaluation", False, info

    def place(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Puts the body into a state of 15 positions and 14 velocities; the episode and its goal stay."""
        self._qpos[:], self._qvel[:] = qpos, qvel
        # The simulator of D4RL's days did so by itself when it was shown a new state; today's does with the next step.
        _mj_normalize_quaternions(self.model, self._qpos)
        _mj_forward(self.model, self.data)

    def _any(self, cells: tuple[Cell, ...]) -> Cell:
        return cells[int(self.np_random.integers(len(cells)))]

    def _chosen(self, options: dict[str, Any], name: str) -> Cell | None:
        if name not in options:
            return None
        cell = tuple(options[name])
        if not self.maze.is_free(cell):
            raise ConfigError(
                f"ant maze '{self.maze.name}': {name} {cell} is no free cell (row, column); free are {self.maze.free}"
            )
        return cell

    def _beside(self, cell: Cell, *widths: float) -> tuple[float, float]:
        """The centre of `cell`, plus U(0, width) for each width, in x and y."""
        x, y = self.maze.centre(cell)
        right, down = np.sum([self.np_random.uniform(0.0, width, 2) for width in widths], axis=0).tolist()
        return x + right, y + down

    def _observation(self) -> np.ndarray:
        return np.concatenate((self._qpos, self._qvel))

    def _info(self) -> dict[str, Any]:
        distance = math.dist((self._qpos[0], self._qpos[1]), self._goal)
        return {
            "success": distance <= SUCCESS_RADIUS,
            "goal": np.array(self._goal),
            "qpos": self._qpos.copy(),
            "qvel": self._qvel.copy(),
        }
