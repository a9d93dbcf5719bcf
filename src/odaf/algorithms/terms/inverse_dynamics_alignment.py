"""OSR's term on the actor: off the log's states, act so as to come back to where the log went.

    L_osr = weight * mean over rows and action dimensions of KL( pi(s^) || I(s^, s') ),   s^ = s + beta * noise

Both are the Gaussians before the tanh. I is a model of inverse dynamics fitted to the log beforehand: from a state s^
beside the logged one, its action leads to the logged next state s' (Jiang, Yao and Tan 2023). docs/algorithms/osr.md
tells what differs from the paper. s' must be the next state, so the learner's `return_steps` has to be 1.
"""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.terms.base import Context, Term
from odaf.components.distributions import gaussian_divergence
from odaf.components.inverse_dynamics import InverseDynamics, InverseDynamicsConfig, fit_inverse, untrained_inverse
from odaf.components.targets import frozen
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class InverseDynamicsAlignment(Term):
    """Let the policy near logged states choose actions that lead to logged next states (OSR)."""

    name: ClassVar[str] = "inverse_dynamics"
    acts_on_actor: ClassVar[bool] = True
    needs_next_state: ClassVar[bool] = True

    weight: float = 0.5
    """Weight in the actor's loss (OSR 0.5); 0 leaves the term out."""
    state_noise: float = 1e-3
    """beta, standard deviation of the normal noise on the states, in standard deviations of the log."""
    model: InverseDynamicsConfig = dataclasses.field(default_factory=InverseDynamicsConfig)
    """The model of inverse dynamics."""

    def __post_init__(self) -> None:
        for field in ("weight", "state_noise"):
            if getattr(self, field) < 0:
                raise ConfigError(f"inverse_dynamics.{field}={getattr(self, field)} must not be negative")

    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> InverseDynamics:
        """The model before training."""
        return untrained_inverse(self.model, key, spec.obs_dim, spec.act_dim)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[InverseDynamics, dict[str, Any]]:
        """Fit the model on the log."""
        return fit_inverse(
            self.model,
            dataset,
            normaliser,
            key,
            lambda done, steps: progress("inverse-dynamics model", done, steps),
            self.name,
        )

    def actor_loss(
        self, context: Context, side: InverseDynamics, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean divergence; its gradient reaches the actor only."""
        key_state, key_latent = jr.split(key)
        batch = context.batch
        perturbed = batch.observations + self.state_noise * jr.normal(key_state, batch.observations.shape)
        noise = side.draw_noise(key_latent, len(perturbed))
        mean, log_std = frozen(side).parameters(perturbed, batch.next_observations, noise)
        divergence = gaussian_divergence(*context.actor.parameters(perturbed), mean, log_std)
        loss = mean_where(jnp.mean(divergence, axis=1), has_successor(batch))
        return self.weight * loss, {"inverse_dynamics/divergence": loss}


def has_successor(batch: Transitions) -> Float[Array, " rows"]:
    """1 where the next state was recorded; 0 at a true end that repeats its own state as a placeholder."""
    repeats = jnp.all(batch.observations == batch.next_observations, axis=1)
    return 1.0 - batch.terminated * repeats.astype(batch.terminated.dtype)


def mean_where(values: Float[Array, " rows"], keep: Float[Array, " rows"]) -> Float[Array, ""]:
    """Mean over the kept rows; 0 if there are none."""
    return jnp.sum(values * keep) / jnp.maximum(jnp.sum(keep), 1.0)
