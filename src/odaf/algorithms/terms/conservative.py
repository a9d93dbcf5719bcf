"""CQL's term: the critics' soft maximum over actions comes down, the logged action goes up (CQL(H), Kumar et al. 2020).

    L_c = weight * sum_k mean_B ( log sum_i exp( Q_k(s, a_i) - log p_i ) - Q_k(s, a) )

The 3 n actions a_i of a state are n uniform ones, n of the policy at s and n of the policy at s', each with the density
p_i it was drawn from; all of them are valued at s. docs/reference/algorithms/osr.md tells what differs from CQL.
"""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.policies import draw_actions
from odaf.components.targets import frozen
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class Conservative(Term):
    """Lower the critics over all actions and raise them at the logged ones (CQL)."""

    name: ClassVar[str] = "conservative"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 5.0
    """Weight in each critic's loss (CQL 5 or 10); 0 leaves the term out."""
    num_actions: int = 10
    """n: uniform actions, and policy actions of either kind, a state."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """CQL."""
        return (citations.CQL,)

    def __post_init__(self) -> None:
        if self.num_actions < 1 or self.weight < 0:
            raise ConfigError(
                f"conservative: num_actions={self.num_actions} must be at least 1 and weight={self.weight} "
                "must not be negative"
            )

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * sum over critics of the mean gap; its gradient reaches the critics only."""
        del state
        key_uniform, key_here, key_next = jr.split(key, 3)
        batch, actor = context.batch, frozen(context.actor)
        rows, act_dim = batch.actions.shape
        shape = (self.num_actions, rows, act_dim)
        uniform = jr.uniform(key_uniform, shape, minval=-1.0, maxval=1.0)
        here, density_here = draw_actions(actor, batch.observations, jr.normal(key_here, shape))
        following, density_following = draw_actions(actor, batch.next_observations, jr.normal(key_next, shape))
        density_uniform = jnp.full((self.num_actions, rows), -act_dim * math.log(2.0))
        log_density = jnp.concatenate([density_uniform, density_following, density_here])

        candidates = jnp.concatenate([uniform, following, here, batch.actions[None]])  # one call for all of a state's
        states = jnp.broadcast_to(batch.observations[None], (len(candidates), *batch.observations.shape))
        values = context.critics(states.reshape(-1, states.shape[2]), candidates.reshape(-1, act_dim))
        values = values.reshape(-1, len(candidates), rows)
        soft_maximum = jax.nn.logsumexp(values[:, :-1] - log_density[None], axis=1)
        gaps = jnp.mean(soft_maximum - values[:, -1], axis=1)
        return self.weight * jnp.sum(gaps), {"conservative/gap": jnp.mean(gaps)}
