"""Columns of logged experience in final form: what a data set holds, before anything is done with it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from odaf.data.mixture import Mixture
from odaf.data.spec import Spec

COLUMNS = ("observations", "actions", "rewards", "next_observations", "terminated", "truncated")


@dataclass(frozen=True, eq=False)
class Rows:
    """N transitions of E whole episodes, in the user's units; `Dataset` adds the checks and the ways in and out.

    Attributes:
        observations: [N, obs_dim] float32.
        actions: [N, act_dim] float32, within `action_low` and `action_high`.
        rewards: [N] float32, earned by the action of the same row.
        next_observations: [N, obs_dim] float32; a placeholder where `terminated` and no successor was logged.
        terminated: [N] bool.
        truncated: [N] bool.
        episode_starts: [E] int64, the first row of each episode, ascending from 0.
        action_low: [act_dim] float32.
        action_high: [act_dim] float32.
        observation_names: one per observation column.
        action_names: one per action column.
        provenance: JSON types only: where the rows came from, and under "findings" what was changed on the way in.
        observation_units: one per observation column, for instance "m/s"; empty where none was given.
        action_units: one per action column.
        infos: further columns that learners do not see, by name: each [N, ...] numbers or bool, such as `qpos`.
        mixture: how batches are mixed from two parts; None draws every row equally often. See `odaf.data.mixing`.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_observations: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    episode_starts: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    provenance: dict[str, Any]
    observation_units: tuple[str, ...] | None = None
    action_units: tuple[str, ...] | None = None
    infos: Mapping[str, np.ndarray] = field(default_factory=dict)
    mixture: Mixture | None = None

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def obs_dim(self) -> int:
        return self.observations.shape[1]

    @property
    def act_dim(self) -> int:
        return self.actions.shape[1]

    @property
    def num_episodes(self) -> int:
        return len(self.episode_starts)

    @property
    def environment(self) -> dict[str, Any] | None:
        """How to build the environment the data came from (see `odaf.environments.make`), or None if unknown."""
        return self.provenance.get("environment")

    def episode(self, index: int) -> slice:
        """Rows of one episode; negative indices count from the end."""
        if not -self.num_episodes <= index < self.num_episodes:
            raise IndexError(f"episode {index} of {self.num_episodes}")
        index %= self.num_episodes
        stop = self.episode_starts[index + 1] if index + 1 < self.num_episodes else len(self)
        return slice(int(self.episode_starts[index]), int(stop))

    def episode_lengths(self) -> np.ndarray:
        """[E] int64, steps."""
        return np.append(self.episode_starts[1:], len(self)).astype(np.int64) - self.episode_starts

    def episode_returns(self) -> np.ndarray:
        """[E] float64, undiscounted sums of the logged rewards."""
        return np.add.reduceat(self.rewards.astype(np.float64), self.episode_starts)

    def spec(self) -> Spec:
        """What a learner needs to size its networks and scale its actions."""
        return Spec(
            obs_dim=self.obs_dim,
            act_dim=self.act_dim,
            action_low=tuple(self.action_low.tolist()),
            action_high=tuple(self.action_high.tolist()),
            reward_min=float(self.rewards.min()),
            reward_max=float(self.rewards.max()),
            ever_terminates=bool(self.terminated.any()),
            max_episode_length=int(self.episode_lengths().max()),
        )
