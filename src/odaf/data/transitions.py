"""The batch a learner sees."""

import equinox as eqx
from jaxtyping import Array, Float


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

    @property
    def for_actor(self) -> "Transitions":
        """The rows that the actor learns from: these, unless it has its own."""
        return self if self.actor is None else self.actor
