"""OSR's idea on the critics (OSR-v): beside the log's states, value the way back above what the policy would do.

    L_v = weight * mean over members and rows of ( log sum_i exp( Q_k(s^, a_i) - log pi(a_i|s^) ) - Q_k(s^, a^) )
    s^ = s + beta * noise,   a_1..a_n ~ pi(s^),   a^ ~ I(s^, s')

Our reconstruction: the code of OSR-v was never released and its exact loss could not be checked. What is known is a
CQL-like regulariser that pushes down the policy's actions at perturbed states and up those of the inverse-dynamics
model. The log-sum-exp over n importance-weighted actions mirrors CQL, whose conservative term this becomes for a
vanishing beta, a perfect model and the policy's actions alone. docs/algorithms/osr.md says more.
s' must be the next state, so the learner's `return_steps` has to be 1.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.terms.base import Context, Term
from odaf.algorithms.terms.inverse_dynamics_alignment import has_successor, mean_where
from odaf.components.inverse_dynamics import InverseDynamics, InverseDynamicsConfig, fit_inverse, untrained_inverse
from odaf.components.policies import draw_actions
from odaf.components.targets import frozen
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class InverseDynamicsValues(Term):
    """Near logged states, lower the critics at the policy's actions and raise them at those that lead back (OSR-v)."""

    name: ClassVar[str] = "inverse_dynamics_values"
    acts_on_critics: ClassVar[bool] = True
    needs_next_state: ClassVar[bool] = True

    weight: float = 5.0
    """lambda_v, the weight in the critics' loss (not known; 5 is CQL's); 0 leaves the term out."""
    state_noise: float = 1e-3
    """beta, standard deviation of the normal noise on the states, in standard deviations of the log."""
    num_actions: int = 10
    """n, policy actions a state."""
    model: InverseDynamicsConfig = dataclasses.field(default_factory=InverseDynamicsConfig)
    """The model of inverse dynamics."""

    def __post_init__(self) -> None:
        if self.num_actions < 1:
            raise ConfigError(f"inverse_dynamics_values.num_actions={self.num_actions} must be at least 1")
        for field in ("weight", "state_noise"):
            if getattr(self, field) < 0:
                raise ConfigError(f"inverse_dynamics_values.{field}={getattr(self, field)} must not be negative")

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

    def critic_loss(
        self, context: Context, side: InverseDynamics, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean gap; its gradient reaches the critics only."""
        key_state, key_latent, key_back, key_policy = jr.split(key, 4)
        batch = context.batch
        rows, act_dim = batch.actions.shape
        perturbed = batch.observations + self.state_noise * jr.normal(key_state, batch.observations.shape)
        mean, log_std = frozen(side).parameters(perturbed, batch.next_observations, side.draw_noise(key_latent, rows))
        back = jnp.tanh(mean + jnp.exp(log_std) * jr.normal(key_back, mean.shape))
        noise = jr.normal(key_policy, (self.num_actions, rows, act_dim))
        chosen, log_density = draw_actions(frozen(context.actor), perturbed, noise)

        candidates = jnp.concatenate([chosen, back[None]])  # one call for all actions at a state
        states = jnp.broadcast_to(perturbed[None], (len(candidates), *perturbed.shape))
        values = context.critics(states.reshape(-1, perturbed.shape[1]), candidates.reshape(-1, act_dim))
        values = values.reshape(-1, self.num_actions + 1, rows)
        pushed_down = jax.nn.logsumexp(values[:, :-1] - log_density[None], axis=1)
        loss = mean_where(jnp.mean(pushed_down - values[:, -1], axis=0), has_successor(batch))
        return self.weight * loss, {"inverse_dynamics_values/gap": loss}
