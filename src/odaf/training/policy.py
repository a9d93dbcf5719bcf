"""A trained actor as a function of the user's own observations: what can be carried away and used."""

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.policies import Actor
from odaf.data.normalisation import Normaliser, unscale_actions
from odaf.errors import ConfigError, DatasetError, DivergenceError
from odaf.training.policy_file import read_policy, write_policy

Observation = np.ndarray | Sequence[Any] | Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Policy:
    """Maps observations in the user's units to actions in the user's units, within their bounds.

    Holds all that is needed to act and nothing else: no learner, no critics, no state of training. Calls with equally
    many rows share one compiled function, also across policies whose actors have one structure.

    Attributes:
        actor: what acts, on normalised observations, in [-1, 1].
        normaliser: the map of observations fitted on the training data.
        action_low: smallest action in the user's units, one entry a dimension; the actor's -1.
        action_high: largest action; the actor's +1.
        observation_names: one name per observation dimension, for calls with a dict.
        action_names: one name per action dimension; may be empty.
        observation_units: one per observation dimension, as the log gave them; empty texts where it gave none.
        action_units: one per action dimension.
        provenance: where it comes from, as plain JSON types; a run says learner, preset, seed and step.
    """

    actor: Actor
    normaliser: Normaliser
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...] = ()
    observation_units: tuple[str, ...] = ()
    action_units: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def obs_dim(self) -> int:
        """Numbers in one observation."""
        return len(self.normaliser.mean)

    @property
    def act_dim(self) -> int:
        """Numbers in one action."""
        return len(self.action_low)

    # ---- acting -------------------------------------------------------------------------------------------------

    def __call__(self, observation: Observation) -> np.ndarray:
        """The deterministic action for one observation [obs_dim] or a batch [rows, obs_dim]; a dict gives each column
        by its name.

        Returns:
            float32 actions [act_dim] or [rows, act_dim].

        Raises:
            ConfigError: the policy has a memory, so that an action depends on the steps before; see `begin`.
            DatasetError: an observation has the wrong size, a name is missing or unknown, or a value is not finite.
            DivergenceError: the parameters are those of a run that diverged to infinity.
        """
        if isinstance(observation, np.ndarray) and observation.shape == self._shape_of_one and not self.has_memory:
            # One row, as at every step of a plant, goes by the shortest way: each call on it counts beside the actor's.
            rows = np.asarray(observation, np.float32)[None]
            action = np.asarray(self._step(self._arrays, (), rows, None)[0])[0]
            return action if math.isfinite(sum(action.tolist())) else self._finite(action, rows)
        return self._without_memory(observation, None)

    def sample(self, observation: Observation, key: int | PRNGKeyArray) -> np.ndarray:
        """A draw from the policy; the same key gives the same draw, whose rows are independent.

        A policy without randomness gives its deterministic action. Everything else is as for a call.

        Args:
            observation: as for a call.
            key: a JAX random key, or a number to make one of.
        """
        return self._without_memory(observation, key)

    @cached_property
    def has_memory(self) -> bool:
        """Whether actions depend on the steps before, so that `begin`, `act` and `observe` must be used."""
        return bool(jax.tree.leaves(self.actor.begin(1)))

    def begin(self, rows: int = 1) -> PyTree:
        """The carry for `act` before the first step of `rows` episodes that are played side by side."""
        return self.actor.begin(rows)

    def act(
        self, carry: PyTree, observation: Observation, key: int | PRNGKeyArray | None = None
    ) -> tuple[np.ndarray, PyTree]:
        """One step of every policy, with or without a memory.

        Args:
            carry: of `begin`, or what the last `act` or `observe` gave; one observation alone counts as one row.
            observation: as for a call.
            key: None for the deterministic action, else as for `sample`.

        Returns:
            Actions as of a call, and the next carry.

        Raises:
            DatasetError: as for a call; or the carry is of another number of rows.
            DivergenceError: as for a call.
        """
        rows = self._rows(observation)
        batch = rows[None] if rows.ndim == 1 else rows
        episodes = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(carry)}
        if self.has_memory and episodes != {(len(batch),)}:
            raise DatasetError(
                f"carry: is not that of {len(batch)} episodes, as many as observations came; "
                f"start with carry = policy.begin({len(batch)})"
            )
        key = jr.key(key) if isinstance(key, int | np.integer) else key
        found, carry = self._step(self._arrays, carry, batch, key)
        actions = self._finite(np.asarray(found), rows)
        return (actions[0] if rows.ndim == 1 else actions), carry

    def observe(self, carry: PyTree, rewards: np.ndarray | Sequence[float] | float) -> PyTree:
        """The carry after the rewards [rows] that the last actions earned, in the log's units."""
        if not self.has_memory:
            return carry
        return self.actor.observe(carry, jnp.asarray(np.atleast_1d(np.asarray(rewards, np.float32))))

    # ---- files --------------------------------------------------------------------------------------------------

    def save(self, file: str | os.PathLike[str]) -> None:
        """Writes the policy to one file in the layout of safetensors, whole or not at all; an older one is replaced.

        Raises:
            CheckpointError: the file cannot be written.
            ConfigError: the actor is of a class that is not registered in `odaf.components.stored.KINDS`.
        """
        write_policy(Path(file), vars(self))

    @classmethod
    def load(cls, file: str | os.PathLike[str]) -> "Policy":
        """Inverse of `save`: the policy acts with the same bits on the same machine. Never runs code of the file.

        Raises:
            CheckpointError: the file is missing, damaged, or holds something else; the message names it.
        """
        return cls(**read_policy(Path(file)))

    # ---- inside -------------------------------------------------------------------------------------------------

    def _without_memory(self, observation: Observation, key: int | PRNGKeyArray | None) -> np.ndarray:
        if self.has_memory:
            raise ConfigError(
                "policy: has a memory, so an action depends on the steps before; start with carry = policy.begin(), "
                "then actions, carry = policy.act(carry, observation) and carry = policy.observe(carry, reward)"
            )
        return self.act((), observation, key)[0]

    @cached_property
    def _shape_of_one(self) -> tuple[int]:
        return (self.obs_dim,)

    @cached_property
    def _arrays(self) -> tuple[Array, ...]:
        """What the compiled step takes: a plain tuple of arrays on the device is the quickest to hand over."""
        return (
            *map(jnp.asarray, jax.tree.leaves(self.actor)),
            jnp.asarray(self.normaliser.mean),
            jnp.asarray(self.normaliser.scale),
        )

    @cached_property
    def _step(self) -> Callable[..., tuple[Array, PyTree]]:
        return _compiled_step(jax.tree.structure(self.actor), self.action_low, self.action_high)

    def _rows(self, observation: Observation) -> np.ndarray:
        # Arrays first: to ask whether something is a mapping takes longer than everything else here.
        if not isinstance(observation, np.ndarray) and isinstance(observation, Mapping):
            observation = self._by_name(observation)
        rows = np.asarray(observation, np.float32)
        if rows.ndim not in (1, 2) or rows.shape[-1] != self.obs_dim:
            raise DatasetError(
                f"observation: has shape {rows.shape}, but this policy takes [{self.obs_dim}] or "
                f"[rows, {self.obs_dim}] in the order {', '.join(self.observation_names)}"
            )
        return rows

    def _finite(self, actions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The actions, unless one is not a finite number: then what the cause is."""
        if np.isfinite(actions).all():
            return actions
        if not np.isfinite(rows).all():
            column = int(np.argwhere(~np.isfinite(rows))[0][-1])
            raise DatasetError(
                f"observation: {self.observation_names[column]} is not a finite number; "
                "a policy has no answer to a missing value, so replace it before the call"
            )
        raise DivergenceError(
            "policy: its action is not a finite number, so its parameters are broken: training diverged. "
            "Use an earlier checkpoint, as in run.policy(seed, step=...)"
        )

    def _by_name(self, observation: Mapping[str, Any]) -> np.ndarray:
        missing = [name for name in self.observation_names if name not in observation]
        unknown = [name for name in observation if name not in self.observation_names]
        if missing or unknown:
            raise DatasetError(
                f"observation: missing {missing or 'none'}, unknown {unknown or 'none'}; "
                f"give exactly {', '.join(self.observation_names)}"
            )
        return np.stack([np.asarray(observation[name], np.float32) for name in self.observation_names], axis=-1)


@functools.lru_cache(maxsize=256)
def _compiled_step(
    structure: Any, low: tuple[float, ...], high: tuple[float, ...]
) -> Callable[..., tuple[Array, PyTree]]:
    """One step of all policies whose actors have this structure and whose actions these bounds."""

    @jax.jit
    def step(
        arrays: tuple[Array, ...], carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        *leaves, mean, scale = arrays
        actor: Actor = jax.tree.unflatten(structure, leaves)
        scaled, carry = actor.act(carry, (observations - mean[None, :]) / scale[None, :], key)
        actions = unscale_actions(scaled, low, high)
        # Rounding may step over a bound by one unit in the last place.
        bounds = (jnp.asarray(bound, actions.dtype)[None, :] for bound in (low, high))
        # An infinite input may leave a network as a tame number, so it is marked here and refused by the caller.
        known = jnp.all(jnp.isfinite(observations), axis=1, keepdims=True)
        return jnp.where(known, jnp.clip(actions, *bounds), jnp.nan), carry

    return step
