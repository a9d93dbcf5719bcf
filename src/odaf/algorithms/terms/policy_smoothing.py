"""RORL's term on the actor: the policy at a state and anywhere in a small box around it should be nearly the same.

    L_P = weight * mean_B max_i J( pi(s), pi(s + delta_i) ),   delta_i uniform in the box
    J   = KL in one direction + KL in the other, of the Gaussians before the tanh, summed over action dimensions

The gradient goes through both policies (Yang et al. 2022). docs/reference/algorithms/rorl.md tells what differs from
the paper.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.distributions import symmetric_gaussian_divergence
from odaf.components.perturbations import draw_offsets, worst_offsets
from odaf.components.targets import frozen
from odaf.errors import ConfigError

Gaussians = tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]


@dataclasses.dataclass(frozen=True)
class PolicySmoothing(Term):
    """Keep the policy from changing inside a small box around each state (RORL)."""

    name: ClassVar[str] = "policy_smoothing"
    acts_on_actor: ClassVar[bool] = True

    weight: float = 0.1
    """beta_P, the weight in the actor's loss (RORL 0.1 to 1, by task); 0 leaves the term out."""
    radius: float = 0.005
    """epsilon_P, half the edge of the box around a state, in standard deviations of the log."""
    num_draws: int = 20
    """Draws a state, of which the worst counts."""
    shared_draws: bool = False
    """One set of offsets for the whole batch, as in RORL's code."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """RORL."""
        return (citations.RORL,)

    def __post_init__(self) -> None:
        if self.num_draws < 1 or self.radius < 0 or self.weight < 0:
            raise ConfigError(
                f"policy_smoothing: num_draws={self.num_draws} must be at least 1; weight={self.weight} and "
                f"radius={self.radius} must not be negative"
            )

    def actor_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean of the worst J; its gradient reaches the actor only."""
        del state
        states = context.batch.observations
        rows, obs_dim = states.shape
        offsets = draw_offsets(
            key, self.num_draws, rows, obs_dim, self.radius, shared=self.shared_draws, include_centre=False
        )
        actor, fixed = context.actor, frozen(context.actor)
        here = fixed.parameters(states)
        worst = worst_offsets(lambda offset: policy_change(here, fixed.parameters(states + offset)), offsets)
        change = policy_change(actor.parameters(states), actor.parameters(states + worst))
        loss = jnp.mean(change)
        return self.weight * loss, {"policy_smoothing/loss": loss, "policy_smoothing/max": jnp.max(change)}


def policy_change(here: Gaussians, there: Gaussians) -> Float[Array, " rows"]:
    """J in nats: symmetric divergence between policies at two states, each a mean and a log std before the tanh."""
    return jnp.sum(symmetric_gaussian_divergence(*here, *there), axis=-1)
