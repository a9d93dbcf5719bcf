"""A behaviour term for the ensemble family: stay near the logged actions, by squared distance (TD3+BC, ReBRAC).

    L_b  = weight_t sg[ mean_B |q| ] mean_B ||mode pi(s) - a||^2,         q = min_k Q_k(s, a~), a~ ~ pi(s)
    y   <- y less discount (1 - d) target_weight f ||a' - a_next||^2,     a' ~ pi(s')

q are the values that the actor climbs, so that weight is in units of their mean size, as in ReBRAC, whose values are
divided by it: the unit of the reward does not matter. a_next is the action logged at s', and f is 1 where there is one.
Squared distances are summed over action dimensions.

The rows are those of the learner's batches: drawn by return, the term holds the policy to what good episodes did. Where
critics draw apart, the actor's are its own. weight_t goes from `weight` to `final_weight` within `decay_updates`: clone
first, then improve. After the learner's `advantage_after` updates, rows count whose logged action the critics put above
the policy's own (the "Q-filter" of Nair et al. 2018, "Overcoming Exploration in Reinforcement Learning with
Demonstrations"); the mean is still one over all rows.

Differs from ReBRAC in the policy, which is a squashed Gaussian: the actor's distance is that of its mode, so that the
term leaves the spread of the draws to the entropy bonus; the target's is that of the draw whose value it takes.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.numbers import is_off
from odaf.algorithms.terms.base import Context, Term
from odaf.components.losses import squared_distance
from odaf.data.view import Extra
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class BehaviourDistance(Term):
    """Keep the policy's actions near the logged ones, in the actor's loss and in the target."""

    name: ClassVar[str] = "behaviour"
    acts_on_actor: ClassVar[bool] = True
    acts_on_target: ClassVar[bool] = True

    weight: float = 0.1
    """Weight in the actor's loss, in units of the mean size of the values it climbs; 0 leaves the term out."""
    final_weight: float | None = None
    """That weight after decay_updates; None keeps it."""
    decay_updates: int = 0
    """Updates over which the weight goes linearly to final_weight."""
    target_weight: float = 0.0
    """Weight of the next action's squared distance from the logged one, taken off the target, in scaled rewards; 0
    leaves the target as it is."""

    def __post_init__(self) -> None:
        amounts = {"weight": self.weight, "final_weight": self.final_weight, "target_weight": self.target_weight}
        for field, amount in amounts.items():
            if amount is not None and amount < 0:
                raise ConfigError(f"behaviour.{field}={amount} must not be negative")
        if self.decay_updates < 0 or (self.decay_updates > 0) != (self.final_weight is not None):
            raise ConfigError(
                f"behaviour.decay_updates={self.decay_updates}, behaviour.final_weight={self.final_weight}: a weight "
                "that changes needs both, a number of updates above 0 and where it ends; one that stays has neither"
            )

    @property
    def can_be_padded(self) -> bool:
        """Yes: an action that is not there is 0 in log and policy."""
        return True

    def citations(self) -> tuple[citations.Citation, ...]:
        """TD3+BC, and ReBRAC where the target has its part."""
        return (citations.TD3_BC,) if is_off(self.target_weight) else (citations.TD3_BC, citations.REBRAC)

    def extras(self) -> tuple[Extra, ...]:
        """The action logged at the successor and whether there is one, for the target's part."""
        return () if is_off(self.target_weight) else ("next_actions", "followed")

    def weight_at(self, step: Int[Array, ""]) -> Float[Array, ""]:
        """weight_t in the update after `step` updates."""
        if self.final_weight is None:
            return jnp.asarray(self.weight)
        share = jnp.minimum(step / self.decay_updates, 1.0)
        return self.weight + (self.final_weight - self.weight) * share

    def actor_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """L_b; its gradient reaches the actor only."""
        del state, key
        assert context.values is not None  # the actor's loss has them
        distances = squared_distance(context.actor.mode(context.batch.observations), context.batch.actions)
        distance = jnp.mean(distances if context.counted is None else context.counted * distances)
        size = jax.lax.stop_gradient(jnp.mean(jnp.abs(context.values)))
        weight = self.weight_at(context.step)
        return weight * size * distance, {"behaviour/distance": distance, "behaviour/weight": weight}

    def target_penalty(
        self,
        context: Context,
        state: PyTree,
        next_actions: Float[Array, "rows act_dim"],
        log_density: Float[Array, " rows"],
        key: PRNGKeyArray,
    ) -> Float[Array, " rows"]:
        """target_weight f ||a' - a_next||^2."""
        del state, log_density, key
        if is_off(self.target_weight):
            return jnp.zeros(next_actions.shape[0])
        extras = context.batch.extras
        return self.target_weight * extras["followed"] * squared_distance(next_actions, extras["next_actions"])
