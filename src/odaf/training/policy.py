"""A trained actor as a function of the user's own observations: what can be carried away and used."""

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.policies import Actor
from odaf.data.derived import Derivation, Memory
from odaf.data.normalisation import Normaliser, unscale_actions
from odaf.errors import ConfigError, DatasetError, DivergenceError
from odaf.training.policy_file import read_policy, write_policy

_NO_ANSWER = "a policy has no answer to a missing value, so replace it before the call"

Observation = np.ndarray | Sequence[Any] | Mapping[str, Any]


class Carry(NamedTuple):
    """What a policy on readings with lags or differences carries: earlier steps, and the actor's own carry."""

    memory: Memory
    actor: PyTree


@dataclass(frozen=True, eq=False)
class Policy:
    """Maps observations in the user's units to actions in the user's units, within their bounds.

    Holds all that is needed to act and nothing else: no learner, no critics, no state of training. Calls with equally
    many rows share one compiled function, also across policies whose actors have one structure.

    Where the log computed observations from readings (formulas, lags, differences), the policy takes the readings and
    computes the very same: a call gives a number for each of `reading_names`. With lags or differences it has a memory,
    so it is played with `begin` and `act`.

    Attributes:
        actor: what acts, on normalised observations, in [-1, 1].
        normaliser: the map of observations fitted on the training data.
        action_low: smallest action in the user's units, one entry a dimension; the actor's -1.
        action_high: largest action; the actor's +1.
        observation_names: one name per observation dimension, as the actor sees them.
        action_names: one name per action dimension; may be empty.
        observation_units: one per observation dimension, as the log gave them; empty texts where it gave none.
        action_units: one per action dimension.
        provenance: where it comes from, as plain JSON types; a run says learner, preset, seed and step.
        derivation: how observations are computed from readings; None where they are the readings.
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
    derivation: Derivation | None = None

    def __post_init__(self):
        made = self.observation_names if self.derivation is None else self.derivation.names
        if made != self.observation_names:
            raise DatasetError(
                f"derivation: makes {', '.join(made)}, but the policy's observations are "
                f"{', '.join(self.observation_names)}; give the recipes of the log that it learned from"
            )
        if self.derivation is not None and self.derivation.lags and self.derivation.actions != self.action_names:
            raise DatasetError(
                f"derivation: remembers {', '.join(self.derivation.actions)}, but the policy's actions are "
                f"{', '.join(self.action_names) or 'without names'}; give the recipes of the log that it learned from"
            )

    @property
    def reading_names(self) -> tuple[str, ...]:
        """What a call takes, in order: the readings of which observations are computed, or else these themselves."""
        return self.observation_names if self.derivation is None else self.derivation.readings

    @property
    def history(self) -> int:
        """So many first steps of an episode have no action, because its observation is made of rows before them."""
        return 0 if self.derivation is None else self.derivation.history

    def without_derivation(self) -> "Policy":
        """The same policy on observations that are computed already, such as those of its log."""
        return replace(self, derivation=None)

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
        by its name. A policy with a derivation takes readings in their place, in the order of `reading_names`.

        Returns:
            float32 actions [act_dim] or [rows, act_dim].

        Raises:
            ConfigError: the policy has a memory, so that an action depends on the steps before; see `begin`.
            DatasetError: an observation has the wrong size, a name is missing or unknown, or a value (or what is
                computed of it) is not finite.
            DivergenceError: the parameters are those of a run that diverged to infinity.
        """
        if isinstance(observation, np.ndarray) and observation.shape == self._shape_of_one and self._is_plain:
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
        return bool(self.history or jax.tree.leaves(self.actor.begin(1)))

    def begin(self, rows: int = 1) -> PyTree:
        """The carry for `act` before the first step of `rows` episodes that are played side by side."""
        carry = self.actor.begin(rows)
        return Carry(self.derivation.begin(rows), carry) if self.derivation is not None and self.history else carry

    def act(
        self, carry: PyTree, observation: Observation, key: int | PRNGKeyArray | None = None
    ) -> tuple[np.ndarray, PyTree]:
        """One step of every policy, with or without a memory.

        Args:
            carry: of `begin`, or what the last `act` or `observe` gave; one observation alone counts as one row.
            observation: as for a call.
            key: None for the deterministic action, else as for `sample`.

        Returns:
            Actions as of a call, and the next carry, which takes these actions for those that are played; where others
            are, tell it with `acted`. NaN in the first `history` steps of an episode: there somebody else has to act.

        Raises:
            DatasetError: as for a call; or the carry is of another number of rows, or nobody told what was done in a
                step for which there was no action.
            DivergenceError: as for a call.
        """
        rows = self.rows_of(observation)
        batch = rows[None] if rows.ndim == 1 else rows
        episodes = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(carry)}
        if self.has_memory and episodes != {(len(batch),)}:
            raise DatasetError(
                f"carry: is not that of {len(batch)} episodes, as many as observations came; "
                f"start with carry = policy.begin({len(batch)})"
            )
        key = jr.key(key) if isinstance(key, int | np.integer) else key
        if self.derivation is None:
            actions, carry = self._act(carry, batch, key)
        else:
            actions, carry = self._act_on_readings(self.derivation, carry, batch, key)
        return (actions[0] if rows.ndim == 1 else actions), carry

    def acted(self, carry: PyTree, actions: Observation) -> PyTree:
        """The carry after a step in which something else was played than `act` gave.

        Args:
            carry: of that `act`.
            actions: what was played, in the log's units: [act_dim] for one episode, [rows, act_dim], or by name.

        Raises:
            DatasetError: an action is missing, unknown or not finite, or there are not as many as episodes.
        """
        if self.derivation is None or not self.derivation.lags:
            return carry
        names = self.derivation.actions
        if isinstance(actions, Mapping):
            actions = _by_name("action", actions, names, np.float32)
        played = np.asarray(actions, np.float32)
        shape = (len(carry.memory.actions), len(names))
        if played.shape != shape and not (shape[0] == 1 and played.shape == shape[1:]):
            raise DatasetError(f"action: has shape {played.shape}, not {shape}, in the order {', '.join(names)}")
        if not np.isfinite(played).all():
            name = names[int(np.argwhere(~np.isfinite(played))[0][-1])]
            raise DatasetError(f"action: {name} is not a finite number; tell what was done in the step before")
        return carry._replace(memory=self.derivation.acted(played.reshape(shape), carry.memory))

    def observe(self, carry: PyTree, rewards: np.ndarray | Sequence[float] | float) -> PyTree:
        """The carry after the rewards [rows] that the last actions earned, in the log's units.

        Raises:
            DatasetError: they are not one finite number for each episode, and the actor remembers them.
        """
        if not self.has_memory:
            return carry
        given = np.atleast_1d(np.asarray(rewards, np.float32))
        if self.actor.takes_rewards:
            episodes = np.shape(jax.tree.leaves(carry)[0])[0]
            if given.shape != (episodes,):
                raise DatasetError(f"reward: has shape {given.shape}, not ({episodes},), one number for each episode")
            if not np.isfinite(given).all():
                raise DatasetError(
                    "reward: is not a finite number, and what is still to be earned is counted from it; give 0 for a "
                    "step whose reward is not known"
                )
        earned = jnp.asarray(given)
        if isinstance(carry, Carry):
            return carry._replace(actor=self.actor.observe(carry.actor, earned))
        return self.actor.observe(carry, earned)

    def rows_of(self, observation: Observation) -> np.ndarray:
        """What a call is given, as numbers [obs_dim] or [rows, obs_dim] in order; with a derivation, of readings.

        Raises:
            DatasetError: an observation has the wrong size, or a name is missing or unknown. Values are not judged.
        """
        # Arrays first: to ask whether something is a mapping takes longer than everything else here.
        names = self.reading_names
        # Formulas are computed in double precision, from the digits that the log had.
        kind = np.float32 if self.derivation is None else np.float64
        if not isinstance(observation, np.ndarray) and isinstance(observation, Mapping):
            observation = _by_name("observation", observation, names, kind)
        try:
            rows = np.asarray(observation, kind)
        except (TypeError, ValueError) as error:
            raise DatasetError(
                f"observation: holds something else than numbers ({error}); give {', '.join(names)}"
            ) from error
        if rows.ndim not in (1, 2) or rows.shape[-1] != len(names):
            computed = ""
            if self.derivation is not None:
                computed = (
                    f"; these are the readings, of which it computes its {self.obs_dim} observations. For observations "
                    "that are computed already use policy.without_derivation()"
                )
            raise DatasetError(
                f"observation: has shape {rows.shape}, but this policy takes [{len(names)}] or "
                f"[rows, {len(names)}] in the order {', '.join(names)}{computed}"
            )
        return rows

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

    def _act(self, carry: PyTree, rows: np.ndarray, key: PRNGKeyArray | None) -> tuple[np.ndarray, PyTree]:
        """Actions at observations [rows, obs_dim], and the actor's next carry."""
        found, carry = self._step(self._arrays, carry, rows, key)
        return self._finite(np.asarray(found), rows), carry

    def _act_on_readings(
        self, derivation: Derivation, carry: PyTree, readings: np.ndarray, key: PRNGKeyArray | None
    ) -> tuple[np.ndarray, PyTree]:
        """Actions at readings [rows, len(reading_names)], and the next carry."""
        if not derivation.history:
            return self._act(carry, derivation.step(readings, derivation.begin(len(readings)))[0], key)
        rows, memory = derivation.step(readings, carry.memory)
        known = ~np.isnan(rows).any(axis=1)
        found, after = self._step(self._arrays, carry.actor, rows, key)  # NaN in rows that hold NaN
        actions = np.asarray(found)
        self._finite(actions[known], rows[known])
        if not known.all():  # an actor sees nothing of a step for which there is no observation
            after = jax.tree.map(
                lambda new, old: jnp.where(known.reshape(-1, *(1,) * (jnp.ndim(new) - 1)), new, old), after, carry.actor
            )
        return actions, Carry(derivation.acted(actions, memory), after)

    @cached_property
    def _is_plain(self) -> bool:
        """Whether an observation goes to the actor as it comes, and nothing is remembered of it."""
        return self.derivation is None and not self.has_memory

    @cached_property
    def _shape_of_one(self) -> tuple[int]:
        return (self.obs_dim,)

    @cached_property
    def _arrays(self) -> tuple[Array, ...]:
        """What the compiled step takes: a plain tuple of arrays on the device is the quickest to hand over."""
        return (
            *map(jnp.asarray, jax.tree.leaves(self.actor)),
            jnp.asarray(self.normaliser.shift),
            jnp.asarray(self.normaliser.scale),
        )

    @cached_property
    def _step(self) -> Callable[..., tuple[Array, PyTree]]:
        return _compiled_step(jax.tree.structure(self.actor), self.action_low, self.action_high)

    def _finite(self, actions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The actions, unless one is not a finite number: then what the cause is."""
        if np.isfinite(actions).all():
            return actions
        if not np.isfinite(rows).all():
            column = int(np.argwhere(~np.isfinite(rows))[0][-1])
            raise DatasetError(f"observation: {self.observation_names[column]} is not a finite number; {_NO_ANSWER}")
        raise DivergenceError(
            "policy: its action is not a finite number, so its parameters are broken: training diverged. "
            "Use an earlier checkpoint, as in run.policy(seed, step=...)"
        )


def _by_name(what: str, given: Mapping[str, Any], names: Sequence[str], kind: type[np.floating[Any]]) -> np.ndarray:
    """[len(names)] or [rows, len(names)] in the order of the names."""
    missing = [name for name in names if name not in given]
    unknown = [name for name in given if name not in names]
    if missing or unknown:
        raise DatasetError(
            f"{what}: missing {missing or 'none'}, unknown {unknown or 'none'}; give exactly {', '.join(names)}"
        )
    columns = []
    for name in names:
        try:
            columns.append(np.asarray(given[name], kind))
        except (TypeError, ValueError) as error:
            raise DatasetError(f"{what}: {name} is {given[name]!r:.40}, which is no number; {_NO_ANSWER}") from error
    if len({column.shape for column in columns}) > 1:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in zip(names, columns, strict=True))
        raise DatasetError(f"{what}: its columns are of different lengths ({shapes}); give one number a row in each")
    return np.stack(columns, axis=-1)


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
