"""A trained learner as a function of the user's own observations: what can be carried away and used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from odaf.algorithms.base import Algorithm
from odaf.data.normalisation import Normaliser, unscale_actions
from odaf.data.spec import Spec
from odaf.errors import DatasetError, DivergenceError


@dataclass(frozen=True, eq=False)
class Policy:
    """Maps observations in the user's units to deterministic actions in the user's units, within their bounds.

    Holds all that is needed to act: the learner's parameters, the normaliser of observations and the action bounds.
    Calls with equally many rows share one compiled function, also across policies of the same learner.

    Attributes:
        algorithm: the learner that trained it.
        spec: sizes and bounds of the task.
        normaliser: the map of observations fitted on the training data.
        state: the learner's parameters.
        observation_names: one name per observation dimension, for calls with a dict.
        action_names: one name per action dimension.
        observation_units: one per observation dimension, as the log gave them; empty texts where it gave none.
        action_units: one per action dimension.
    """

    algorithm: Algorithm
    spec: Spec
    normaliser: Normaliser
    state: Any
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...] = ()
    observation_units: tuple[str, ...] = ()
    action_units: tuple[str, ...] = ()

    def __call__(self, observation: np.ndarray | Sequence[Any] | Mapping[str, Any]) -> np.ndarray:
        """The action for one observation [obs_dim] or a batch [rows, obs_dim]; a dict gives each column by its name.

        Returns:
            float32 actions [act_dim] or [rows, act_dim].

        Raises:
            DatasetError: an observation has the wrong size, a name is missing or unknown, or a value is not finite.
            DivergenceError: the parameters are those of a run that diverged to infinity.
        """
        rows = self._rows(observation)
        single = rows.ndim == 1
        batch = rows[None, :] if single else rows
        mean, scale = self._scaling
        actions = np.asarray(_act(self.algorithm, self.state, mean, scale, jnp.asarray(batch), self.spec))
        if not np.isfinite(actions).all():
            raise DivergenceError(
                "policy: its action is not a finite number, so its parameters are broken: training diverged. "
                "Use an earlier checkpoint, as in run.policy(seed, step=...)"
            )
        return actions[0] if single else actions

    @cached_property
    def _scaling(self) -> tuple[Array, Array]:
        return jnp.asarray(self.normaliser.mean), jnp.asarray(self.normaliser.scale)

    def _rows(self, observation: np.ndarray | Sequence[Any] | Mapping[str, Any]) -> np.ndarray:
        if isinstance(observation, Mapping):
            missing = [name for name in self.observation_names if name not in observation]
            unknown = [name for name in observation if name not in self.observation_names]
            if missing or unknown:
                raise DatasetError(
                    f"observation: missing {missing or 'none'}, unknown {unknown or 'none'}; "
                    f"give exactly {', '.join(self.observation_names)}"
                )
            rows = np.stack([np.asarray(observation[name], np.float32) for name in self.observation_names], axis=-1)
        else:
            rows = np.asarray(observation, np.float32)
        if rows.ndim not in (1, 2) or rows.shape[-1] != self.spec.obs_dim:
            raise DatasetError(
                f"observation: has shape {rows.shape}, but this policy takes [{self.spec.obs_dim}] or "
                f"[rows, {self.spec.obs_dim}] in the order {', '.join(self.observation_names)}"
            )
        if not np.isfinite(rows).all():
            column = int(np.argwhere(~np.isfinite(rows))[0][-1])
            raise DatasetError(
                f"observation: {self.observation_names[column]} is not a finite number; "
                "a policy has no answer to a missing value, so replace it before the call"
            )
        return rows


@eqx.filter_jit
def _act(
    algorithm: Algorithm,
    state: Any,
    mean: Float[Array, " obs_dim"],
    scale: Float[Array, " obs_dim"],
    observations: Float[Array, "rows obs_dim"],
    spec: Spec,
) -> Float[Array, "rows act_dim"]:
    normalised = (observations - mean[None, :]) / scale[None, :]
    scaled = algorithm.actor(state).mode(normalised)
    actions = unscale_actions(scaled, spec.action_low, spec.action_high)
    # Rounding may step over a bound by one unit in the last place.
    low, high = jnp.asarray(spec.action_low, actions.dtype), jnp.asarray(spec.action_high, actions.dtype)
    return jnp.clip(actions, low[None, :], high[None, :])
