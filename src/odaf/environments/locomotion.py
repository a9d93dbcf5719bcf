"""The locomotion tasks HalfCheetah, Hopper and Walker2d, driven directly: no wrapper between us and the simulator."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.environments.contact_margins import ContactMargins, apply
from odaf.environments.gymnasium_environment import make_quietly
from odaf.errors import ConfigError

VERSIONS = ("v4", "v5")
TIME_LIMIT = 1000
_EXTRA = 'pip install "odaf[envs]"'


@dataclass(frozen=True)
class Task:
    """One locomotion task.

    Attributes:
        name: what users type.
        family: Gymnasium's name without the version.
        obs_dim: numbers in an observation.
        act_dim: numbers in an action, each in [-1, 1].
        positions: numbers in the simulator's `qpos`; `qvel` has as many.
    """

    name: str
    family: str
    obs_dim: int
    act_dim: int
    positions: int

    @property
    def velocities(self) -> int:
        """Numbers in the simulator's `qvel`."""
        return self.positions

    def environment_id(self, version: str) -> str:
        """Gymnasium's name, such as `Hopper-v4`."""
        return f"{self.family}-{version}"


TASKS = {
    task.name: task
    for task in (
        Task("halfcheetah", "HalfCheetah", 17, 6, 9),
        Task("hopper", "Hopper", 11, 3, 6),
        Task("walker2d", "Walker2d", 17, 6, 9),
    )
}


def task_of(name: str, version: str = "v4") -> Task:
    """The task called `name`.

    Raises:
        ConfigError: there is no such task or version.
    """
    if name not in TASKS:
        raise ConfigError(f"task '{name}' is not known; known are {', '.join(TASKS)}")
    if version not in VERSIONS:
        raise ConfigError(f"version '{version}' of {name} is not supported; supported are {', '.join(VERSIONS)}")
    return TASKS[name]


class Simulator:
    """One body in the simulator: the bits of `gymnasium.make(ID)`, without its wrappers.

    Observations are float64. `step` reports true ends only; the time limit (1,000 steps) is the caller's to keep.
    """

    def __init__(self, task: Task, version: str = "v4", contact_margins: ContactMargins | None = None):
        """
        Args:
            task: which body.
            version: of the environment.
            contact_margins: how the margins of two geoms that touch are counted; None is as the installed MuJoCo does.

        Raises:
            ConfigError: there is no simulator, or no such rule.
        """
        self.task = task
        self.environment_id = task.environment_id(version)
        try:
            import gymnasium  # noqa: F401
            import mujoco
        except ImportError as error:
            raise ConfigError(
                f"'{self.environment_id}' needs a simulator that is missing ({error}); {_EXTRA}"
            ) from error
        self._mujoco: Any = mujoco
        self._environment: Any = make_quietly(self.environment_id, disable_env_checker=True).unwrapped
        apply(self._environment, contact_margins, self.environment_id)
        self._signature = self._mujoco.mjtState.mjSTATE_INTEGRATION
        self._model, self._data = self._environment.model, self._environment.data

    def reset(self, seed: int) -> np.ndarray:
        """Starts an episode; the seed fixes the start."""
        return self._environment.reset(seed=seed)[0]

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """Plays an action in [-1, 1]: next observation, reward, whether the task truly ended."""
        observation, reward, terminated, _, _ = self._environment.step(action)
        return observation, float(reward), bool(terminated)

    def place(self, body: np.ndarray) -> None:
        """Puts the body into a pose, at rest or in motion.

        Args:
            body: `qpos` and `qvel` in one array, as `body` returns; or an observation, which lacks the horizontal
                position, taken as 0, and shows velocities up to 10 only.
        """
        if len(body) == self.task.obs_dim:
            body = np.concatenate([[0.0], body])
        self._environment.set_state(body[: self.task.positions], body[self.task.positions :])

    def body(self) -> np.ndarray:
        """`qpos` and `qvel` in one array, a copy."""
        return np.concatenate([self._data.qpos, self._data.qvel])

    def physics(self) -> np.ndarray:
        """Everything the simulator needs to go on exactly from here."""
        state = np.empty(self._mujoco.mj_stateSize(self._model, self._signature))
        self._mujoco.mj_getState(self._model, self._data, state, self._signature)
        return state

    def restore(self, physics: np.ndarray) -> None:
        """Goes back to a state that `physics` returned."""
        self._mujoco.mj_setState(self._model, self._data, physics, self._signature)
