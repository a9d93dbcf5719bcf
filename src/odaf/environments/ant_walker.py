"""D4RL's ant on an open plane, paid for its way along a direction it is shown: where the walker of the mazes learns.

Source: the directions drawn anew every hundred steps, and the displacement along them as reward, are those that OGBench
(Park et al. 2025) trained its ants with; the body and what it is shown are those of D4RL's mazes (Fu et al. 2020).
"""

from typing import Any

import mujoco
import numpy as np

from odaf.environments import contact_margins as margins
from odaf.environments.ant_maze import FRAME_SKIP
from odaf.environments.ant_maze_controller import walker_inputs
from odaf.environments.ant_maze_model import TORQUE, ant_model
from odaf.environments.contact_margins import ContactMargins

# The compiled module comes without stubs.
_mj_forward, _mj_step, _mj_reset_data, _mj_get_state, _mj_set_state, _mj_state_size, _MjData, _mjtState = (
    getattr(mujoco, name)
    for name in (
        "mj_forward",
        "mj_step",
        "mj_resetData",
        "mj_getState",
        "mj_setState",
        "mj_stateSize",
        "MjData",
        "mjtState",
    )
)

POSITIONS, VELOCITIES, ACTIONS = 15, 14, 8
DIRECTION_STEPS = 100
STEP_SECONDS = 0.1
UPRIGHT, TILT_COST = 0.9, 10.0
_POSE_NOISE = 0.1


def uprightness(observations: np.ndarray) -> np.ndarray | np.floating:
    """How the torso's own upward axis points upwards in the world: 1 on its feet, 0 on its side, -1 on its back.

    Args:
        observations: of `AntMaze`, or `qpos`, [..., at least 7]; the quaternion need not be of length 1.
    """
    quaternion = np.asarray(observations)[..., 3:7]
    length = np.maximum(np.sum(np.square(quaternion), axis=-1), 1e-12)
    return 1.0 - 2.0 * np.sum(np.square(quaternion[..., 1:3]), axis=-1) / length


class AntWalker:
    """One ant that begins at the origin, on its feet, and goes where it is told.

    Observation: 29 numbers, float64, what `WaypointController` shows a walker: those of `AntMaze` without x and y, then
    the direction, two numbers of norm 10. Action: eight numbers in [-1, 1]. One step is 0.1 s.

    Reward: metres a second along the direction, over the step, less ten times what the uprightness after it lacks of
    0.9. A fall alone teaches a learner little that looks a hundred steps ahead: it comes once in a hundred metres. The
    direction is drawn uniformly from the circle at the start and after every hundredth step; the successor shows the
    new one. An ant whose torso tilts by more than a right angle has turned over, which ends the task. The time limit is
    the caller's to keep.
    """

    def __init__(self, contact_margins: ContactMargins | None = "larger"):
        self.model = ant_model(None)
        margins.set_rule(self.model, margins.check(contact_margins))
        self._data = _MjData(self.model)
        self._signature = _mjtState.mjSTATE_INTEGRATION
        self._seed = self._steps = 0
        self._fixed = False
        self._direction = np.zeros(2)

    def reset(self, seed: int, direction: np.ndarray | None = None) -> np.ndarray:
        """Starts an episode; the seed fixes the start and all directions.

        Args:
            seed: at most 2^53, so that `physics` can hold it.
            direction: [2], of any length, kept until `towards` changes it; None draws them.
        """
        rng = np.random.default_rng(seed)
        _mj_reset_data(self.model, self._data)
        self._data.qpos[:] = self.model.qpos0 + rng.uniform(-_POSE_NOISE, _POSE_NOISE, POSITIONS)
        self._data.qvel[:] = _POSE_NOISE * rng.standard_normal(VELOCITIES)
        self._data.qpos[3:7] /= np.linalg.norm(self._data.qpos[3:7])
        _mj_forward(self.model, self._data)
        self._seed, self._steps, self._fixed = seed, 0, direction is not None
        self._direction = self._drawn() if direction is None else _unit(direction)
        return self._observation()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """Plays an action, clipped to [-1, 1]: next observation, reward, whether the ant has turned over."""
        before = self.position
        self._data.ctrl[:] = TORQUE * np.clip(action, -1.0, 1.0)
        _mj_step(self.model, self._data, FRAME_SKIP)
        speed = float((self.position - before) @ self._direction) / STEP_SECONDS
        upright = float(uprightness(self._data.qpos))
        self._steps += 1
        if not self._fixed and self._steps % DIRECTION_STEPS == 0:
            self._direction = self._drawn()
        return self._observation(), speed - TILT_COST * max(0.0, UPRIGHT - upright), upright < 0.0

    def towards(self, direction: np.ndarray) -> np.ndarray:
        """The observation with another direction [2], of any length, from now on; none is drawn any more."""
        self._direction, self._fixed = _unit(direction), True
        return self._observation()

    @property
    def position(self) -> np.ndarray:
        """x and y of the torso, metres; a copy."""
        return self._data.qpos[:2].copy()

    def body(self) -> np.ndarray:
        """`qpos` and `qvel` in one array, a copy."""
        return np.concatenate([self._data.qpos, self._data.qvel])

    def physics(self) -> np.ndarray:
        """Everything that is needed to go on exactly from here in an episode with drawn directions."""
        state = np.empty(_mj_state_size(self.model, self._signature))
        _mj_get_state(self.model, self._data, state, self._signature)
        return np.concatenate([[self._seed, self._steps], state])

    def restore(self, physics: np.ndarray) -> None:
        """Goes back to a state that `physics` returned."""
        self._seed, self._steps = (int(number) for number in physics[:2])
        _mj_set_state(self.model, self._data, physics[2:], self._signature)
        self._fixed, self._direction = False, self._drawn()

    def _drawn(self) -> np.ndarray:
        """The direction of this hundred of the episode; a function of the seed, so that no generator must be kept."""
        angle = np.random.default_rng((self._seed, self._steps // DIRECTION_STEPS)).uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle)])

    def _observation(self) -> np.ndarray:
        state: Any = np.concatenate((self._data.qpos, self._data.qvel))
        return walker_inputs(state[None], self._direction[None])[0]


def _unit(direction: np.ndarray) -> np.ndarray:
    return np.asarray(direction, np.float64) / max(float(np.linalg.norm(direction)), 1e-9)
