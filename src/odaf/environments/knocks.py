"""A policy is put off its stride: knocked in the middle of an episode, or started from an unusual state.

A knock takes the controls away once, after `at` counted steps, for a number of simulator steps, and gives them back.
Rewards and ends of these steps are not counted, and they are not among the steps of the episode. A body that the knock
has thrown down is still down when the policy gets the controls back, so the next counted step ends the episode.

Source: the out-of-sample evaluation of Jiang et al. 2023 (OSR) and its code: one knock at step 500 of 1,000, actions
drawn from U(0, 1e-3), which is as good as motors off. "extra-large", the other kinds of action and the unusual starts
are additions of this package.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from odaf.environments.locomotion import TASKS
from odaf.errors import ConfigError

LEVELS = {"none": 0, "slight": 5, "moderate": 10, "large": 15, "extra-large": 30}
"""Simulator steps of a knock, by name."""

KnockAction = Literal["motors-off", "uniform", "gaussian"]
_MOTORS_OFF = 1e-3
# Second entry of a generator's seed, so that a knock and a start with the same reset seed are independent.
_KNOCK, _START = 0, 1


@dataclass(frozen=True)
class Knock:
    """When the controls are taken away, for how long, and what happens meanwhile.

    Attributes:
        steps: simulator steps without control; 0 is no knock.
        at: counted steps before it.
        action: "motors-off" draws every number of the action from U(0, 1e-3); "uniform" from the action's bounds;
            "gaussian" from a normal distribution around their middle with half their width as standard deviation. All
            are clipped to the bounds.
    """

    steps: int = LEVELS["large"]
    at: int = 500
    action: KnockAction = "motors-off"

    def __post_init__(self):
        if self.steps < 0:
            raise ConfigError(f"knock: steps is {self.steps}; give 0 (no knock) or more")
        if self.at < 1:
            raise ConfigError(f"knock: at is {self.at}; a knock comes after 1 or more counted steps")


class Knocked:
    """An environment without a time limit of its own, with a knock and a number of counted steps.

    `info["survived"]`: no counted step so far was a true end. `info["knocked"]`: the knock has happened.
    """

    def __init__(self, environment: Any, knock: Knock, limit: int):
        """
        Args:
            environment: of Gymnasium, without a time limit; `odaf.environments.registry.make_untimed` builds such.
            knock: what is done to it.
            limit: counted steps after which an episode is truncated.

        Raises:
            ConfigError: the knock would come after the last counted step, or the actions have no bounds to draw from.
        """
        self.environment, self.knock, self.limit = environment, knock, limit
        if knock.steps and knock.at >= limit:
            raise ConfigError(
                f"knock: at is {knock.at}, but an episode has {limit} counted steps; give an earlier step, "
                f"for instance --knock-at {max(limit // 2, 1)}"
            )
        space = environment.action_space
        self._low, self._high = np.asarray(space.low, np.float64), np.asarray(space.high, np.float64)
        if knock.action != "motors-off" and not (np.isfinite(self._low).all() and np.isfinite(self._high).all()):
            raise ConfigError(f"knock: '{knock.action}' actions need bounds, and this environment's have none")
        self._dtype = space.dtype
        self._counted, self._knocked = 0, False
        self._random = np.random.default_rng()

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode; the seed fixes the start and the knock."""
        if seed is not None:
            self._random = np.random.default_rng([seed, _KNOCK])
        self._counted, self._knocked = 0, False
        observation, info = self.environment.reset(seed=seed)
        return observation, {**info, "survived": True, "knocked": False}

    def step(self, action: Any, /) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One counted step; the knock follows the one after which it is due, and its last observation is returned."""
        observation, reward, terminated, _, info = self.environment.step(action)
        self._counted += 1
        if self._counted == self.knock.at and self.knock.steps and not terminated:
            for _ in range(self.knock.steps):
                observation = self.environment.step(self._without_control())[0]
            self._knocked = True
        info = {**info, "survived": not terminated, "knocked": self._knocked}
        return observation, reward, bool(terminated), self._counted >= self.limit, info

    def close(self) -> None:
        self.environment.close()

    def _without_control(self) -> np.ndarray:
        size = self._low.shape
        if self.knock.action == "motors-off":
            action = self._random.uniform(0.0, _MOTORS_OFF, size)
        elif self.knock.action == "uniform":
            action = self._random.uniform(self._low, self._high)
        else:
            middle, half = (self._high + self._low) / 2, (self._high - self._low) / 2
            action = middle + half * self._random.standard_normal(size)
        return np.clip(action, self._low, self._high).astype(self._dtype)


class UnusualStart:
    """A locomotion task whose episodes begin off the usual pose: positions and velocities + noise * std * N(0, 1).

    The horizontal position, which is no part of an observation, stays. A start that counts as fallen ends the episode
    with its first step.
    """

    def __init__(self, environment: Any, noise: float, std: np.ndarray):
        """
        Args:
            environment: HalfCheetah, Hopper or Walker2d of Gymnasium.
            noise: size in standard deviations.
            std: [obs_dim] standard deviation of each dimension of the logged observations.

        Raises:
            ConfigError: it is another environment, or `noise` is negative or no number.
        """
        if not 0.0 <= noise < np.inf:
            raise ConfigError(f"initial noise: is {noise}; give 0 or more standard deviations, for instance 0.1")
        self.environment, self.noise, self.std = environment, noise, np.asarray(std, np.float64)
        self.action_space = environment.action_space
        self._body = environment.unwrapped
        identity = getattr(self._body.spec, "id", "this environment")
        family = identity.rpartition("-v")[0]
        tasks = {task.family: task for task in TASKS.values()}
        if family not in tasks or len(self.std) != tasks[family].obs_dim:
            raise ConfigError(
                f"initial noise: {identity} does not show its whole pose in its observation; it can be put on "
                f"{', '.join(tasks)} with their usual observations"
            )
        self._random = np.random.default_rng()

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode off the pose that the same seed gives without noise."""
        if seed is not None:
            self._random = np.random.default_rng([seed, _START])
        observation, info = self.environment.reset(seed=seed)
        if self.noise == 0.0:
            return observation, info
        positions, velocities = self._body.data.qpos.copy(), self._body.data.qvel.copy()
        offsets = self.noise * self.std * self._random.standard_normal(len(self.std))
        seen = len(positions) - 1  # all but the horizontal position
        positions[1:] += offsets[:seen]
        velocities += offsets[seen:]
        self._body.set_state(positions, velocities)
        return self._body._get_obs(), info

    def step(self, action: Any, /) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        return self.environment.step(action)

    def close(self) -> None:
        self.environment.close()
