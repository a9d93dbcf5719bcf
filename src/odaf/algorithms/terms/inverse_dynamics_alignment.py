"""OSR's term on the actor: off the log's states, act so as to come back to where the log went.

    L_osr = weight * mean over rows and action dimensions of KL( pi(s^) || I(s^, s') ),   s^ = s + beta * noise

Both are the Gaussians before the tanh. I is a model of inverse dynamics fitted to the log beforehand: from a state s^
beside the logged one, its action leads to the logged next state s' (Jiang, Yao and Tan 2023). The page
docs/reference/algorithms/osr.md tells what differs from the paper. s' must be the next state, so the learner's
`return_steps` has to be 1.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context
from odaf.algorithms.terms.inverse_dynamics import InverseDynamicsTerm, mean_where_followed
from odaf.components.distributions import gaussian_divergence
from odaf.components.inverse_dynamics import InverseDynamics
from odaf.components.targets import frozen


@dataclasses.dataclass(frozen=True)
class InverseDynamicsAlignment(InverseDynamicsTerm):
    """Let the policy near logged states choose actions that lead to logged next states (OSR)."""

    name: ClassVar[str] = "inverse_dynamics"
    acts_on_actor: ClassVar[bool] = True

    weight: float = 0.5
    """Weight in the actor's loss (OSR 0.5); 0 leaves the term out."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """OSR."""
        return (citations.OSR,)

    def actor_loss(
        self, context: Context, state: InverseDynamics, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean divergence; its gradient reaches the actor only."""
        key_state, key_latent = jr.split(key)
        batch = context.batch
        perturbed = self.states_beside(batch, key_state)
        noise = state.draw_noise(key_latent, len(perturbed))
        mean, log_std = frozen(state).parameters(perturbed, batch.next_observations, noise)
        divergence = gaussian_divergence(*context.actor.parameters(perturbed), mean, log_std)
        loss = mean_where_followed(jnp.mean(divergence, axis=1), batch)
        return self.weight * loss, {"inverse_dynamics/divergence": loss}
