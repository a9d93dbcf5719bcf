"""OSR's idea on the critics (OSR-v): beside the log's states, value the way back above what the policy would do.

    L_v = weight * mean over members and rows of ( log sum_i exp( Q_k(s^, a_i) - log pi(a_i|s^) ) - Q_k(s^, a^) )
    s^ = s + beta * noise,   a_1..a_n ~ pi(s^),   a^ ~ I(s^, s')

Our reconstruction: the code of OSR-v was never released and its exact loss could not be checked. What is known is a
CQL-like regulariser that pushes down the policy's actions at perturbed states and up those of the inverse-dynamics
model. The log-sum-exp over n importance-weighted actions mirrors CQL, whose conservative term this becomes for a
vanishing beta, a perfect model and the policy's actions alone. docs/reference/algorithms/osr.md says more.
s' must be the next state, so the learner's `return_steps` has to be 1.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context
from odaf.algorithms.terms.inverse_dynamics import InverseDynamicsTerm, mean_where_followed
from odaf.components.inverse_dynamics import InverseDynamics
from odaf.components.policies import draw_actions
from odaf.components.targets import frozen
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class InverseDynamicsValues(InverseDynamicsTerm):
    """Near logged states, lower the critics at the policy's actions and raise them at those that lead back (OSR-v)."""

    name: ClassVar[str] = "inverse_dynamics_values"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 5.0
    """lambda_v, the weight in the critics' loss (not known; 5 is CQL's); 0 leaves the term out."""
    num_actions: int = 10
    """n, policy actions a state."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """OSR-v, of one paper with OSR."""
        return (citations.OSR,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_actions < 1:
            raise ConfigError(f"{self.name}.num_actions={self.num_actions} must be at least 1")

    def critic_loss(
        self, context: Context, state: InverseDynamics, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean gap; its gradient reaches the critics only."""
        key_state, key_latent, key_back, key_policy = jr.split(key, 4)
        batch = context.batch
        rows, act_dim = batch.actions.shape
        perturbed = self.states_beside(batch, key_state)
        mean, log_std = frozen(state).parameters(perturbed, batch.next_observations, state.draw_noise(key_latent, rows))
        back = jnp.tanh(mean + jnp.exp(log_std) * jr.normal(key_back, mean.shape))
        noise = jr.normal(key_policy, (self.num_actions, rows, act_dim))
        chosen, log_density = draw_actions(frozen(context.actor), perturbed, noise)

        candidates = jnp.concatenate([chosen, back[None]])  # one call for all actions at a state
        states = jnp.broadcast_to(perturbed[None], (len(candidates), *perturbed.shape))
        values = context.critics(states.reshape(-1, perturbed.shape[1]), candidates.reshape(-1, act_dim))
        values = values.reshape(-1, self.num_actions + 1, rows)
        pushed_down = jax.nn.logsumexp(values[:, :-1] - log_density[None], axis=1)
        loss = mean_where_followed(jnp.mean(pushed_down - values[:, -1], axis=0), batch)
        return self.weight * loss, {"inverse_dynamics_values/gap": loss}
