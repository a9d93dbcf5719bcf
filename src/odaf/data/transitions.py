"""The batch a learner sees."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from odaf.data.padding import Padding


class Transitions(eqx.Module):
    """Rows (s, a, r, s', end) in learner's units; the same class holds a batch and all columns of a dataset.

    `terminated` is 1.0 only where the task truly ended, so `1 - terminated` is the bootstrap mask; a time limit leaves
    it at 0.0 and keeps its real successor. Where `terminated` is 1.0 the successor may be a placeholder.
    """

    observations: Float[Array, "batch obs_dim"]  # normalised
    actions: Float[Array, "batch act_dim"]  # scaled to [-1, 1]
    rewards: Float[Array, " batch"]  # as logged, but for the view's scale and shift
    next_observations: Float[Array, "batch obs_dim"]  # normalised
    terminated: Float[Array, " batch"]  # 1.0 at a true end, else 0.0
    extras: dict[str, Float[Array, "batch *width"]] = eqx.field(default_factory=dict)  # those of the learner's `View`
    actor: "Transitions | None" = None  # of a batch: the actor's rows, where critics and actor draw apart
    padding: Padding | None = None  # of a batch whose actions have more dimensions than its data set

    @property
    def for_actor(self) -> "Transitions":
        """The rows that the actor learns from: these, unless it has its own."""
        return self if self.actor is None else self.actor

    @property
    def own_actions(self) -> Bool[Array, " act_dim"] | None:
        """Which dimensions of the actions are the data set's own; None if all are."""
        return None if self.padding is None else self.padding.mask(self.actions.shape[1])

    def action_noise(self, key: PRNGKeyArray, rows: int | None = None) -> Float[Array, "rows act_dim"]:
        """Standard normal draws, one for each number of the actions, or of so many rows of actions.

        They are 0 where a dimension is not the data set's own.
        """
        shape = self.actions.shape[0] if rows is None else rows, self.actions.shape[1]
        return jr.normal(key, shape) if self.padding is None else self.padding.normal(key, *shape)

    def mean_over_actions(self, values: Float[Array, "batch act_dim"]) -> Float[Array, ""]:
        """Mean over rows and over the data set's own dimensions."""
        if self.padding is None:
            return jnp.mean(values)
        own = jnp.where(self.padding.mask(values.shape[1]), values, 0.0)
        return jnp.sum(own) / (values.shape[0] * self.padding.actions.astype(values.dtype))

    def with_padding(self, padding: Padding) -> "Transitions":
        """The same batch, the actor's rows included, that knows its own dimensions."""
        actor = None if self.actor is None else replace(self.actor, padding=padding)
        return replace(self, padding=padding, actor=actor)
