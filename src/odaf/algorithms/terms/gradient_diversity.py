"""EDAC's term: members of the ensemble whose slopes in the action differ, so that their minimum falls off the log.

    g_k   = grad_a Q_k(s, a) at logged pairs,   ghat_k = g_k / (|g_k| + 1e-10)
    L_div = weight * mean_B 1/(K - 1) sum_{i != j} <ghat_i, ghat_j>

over all ordered pairs of all K members (An et al. 2021). docs/reference/algorithms/edac.md tells what differs from the
paper.

The loss depends on the parameters only through the slopes, and a slope only on its own member. So its gradient needs no
second-order differentiation of the ensemble: with c_k = dL/dg_k held fast, dL/d(theta_k) is the gradient of

    sum_rows <c_k, grad_a Q_k(s, a)>,

a directional derivative of Q_k in its action, taken one member at a time.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.critics import CriticEnsemble, over_members
from odaf.errors import ConfigError

NORM_EPSILON = 1e-10

Slopes = Float[Array, "critics rows act_dim"]


@dataclasses.dataclass(frozen=True)
class GradientDiversity(Term):
    """Turn the critics' action slopes away from one another (EDAC)."""

    name: ClassVar[str] = "diversity"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 1.0
    """eta, the weight in the critics' loss (EDAC 1 or 5, by task); 0 leaves the term out."""

    @property
    def can_be_padded(self) -> bool:
        """Yes: critics have no slope along an action that is not there."""
        return True

    def citations(self) -> tuple[citations.Citation, ...]:
        """EDAC, of one paper with SAC-N."""
        return (citations.ENSEMBLES,)

    def __post_init__(self) -> None:
        if self.weight < 0:
            raise ConfigError(f"diversity.weight={self.weight} must not be negative")

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * L_div at the logged pairs; its gradient reaches the critics only."""
        del state, key
        batch = context.batch
        loss = action_diversity(_in_full_precision(context.critics), batch.observations, batch.actions)
        members = context.critics.networks.weights[0].shape[0]
        return self.weight * loss, {"diversity/loss": loss, "diversity/cosine": loss / members}


def mean_similarity(slopes: Slopes) -> Float[Array, ""]:
    """mean_B 1/(K - 1) sum_{i != j} <ghat_i, ghat_j>: K times the mean cosine between two members.

    Between -K/(K - 1), when slopes cancel, and K, when all point the same way. The sum over pairs is the square of the
    sum less the squares, so its cost grows with K and not with K squared. A slope of exactly zero is similar to none.
    """
    squares = jnp.sum(jnp.square(slopes), axis=-1, keepdims=True)
    length = jnp.sqrt(jnp.where(squares > 0.0, squares, 1.0))  # the root has no derivative at zero
    directions = slopes / (length + NORM_EPSILON)
    together = jnp.sum(jnp.square(jnp.sum(directions, axis=0)), axis=-1)
    alone = jnp.sum(jnp.square(directions), axis=(0, 2))
    return jnp.mean(together - alone) / (slopes.shape[0] - 1)


def _in_full_precision(critics: CriticEnsemble) -> CriticEnsemble:
    """Slopes of rounded products are known in one direction of differentiation only, and too coarse to compare."""
    networks = dataclasses.replace(critics.networks, products="float32")
    if critics.priors is None:
        return CriticEnsemble(networks)
    fixed = dataclasses.replace(critics.priors.networks, products="float32")
    return CriticEnsemble(networks, dataclasses.replace(critics.priors, networks=fixed))


@jax.custom_vjp
def action_diversity(
    critics: CriticEnsemble, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
) -> Float[Array, ""]:
    """`mean_similarity` of the members' action slopes, as a function of the critics; reverse mode only.

    States and actions are constants: they receive no gradient.
    """
    return mean_similarity(_action_slopes(critics, observations, actions))


def _action_slopes(
    critics: CriticEnsemble, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
) -> Slopes:
    def member(critic: CriticEnsemble) -> Float[Array, "rows act_dim"]:
        values, pull_back = jax.vjp(lambda a: _values(critic, observations, a), actions)
        return pull_back(jnp.ones_like(values))[0]  # rows do not interact: dQ_k/da of every row

    return over_members(member, critics)


def _values(
    critic: CriticEnsemble, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
) -> Float[Array, " rows"]:
    return critic.value(jnp.concatenate([observations, actions], axis=-1))


def _forward(critics: CriticEnsemble, observations: Array, actions: Array) -> tuple[Float[Array, ""], tuple]:
    slopes = _action_slopes(critics, observations, actions)
    return mean_similarity(slopes), (critics, observations, actions, slopes)


def _backward(residuals: tuple, cotangent: Float[Array, ""]) -> tuple[CriticEnsemble, Array, Array]:
    critics, observations, actions, slopes = residuals
    directions = cotangent * jax.grad(mean_similarity)(slopes)  # c_k

    def member(pair: tuple[CriticEnsemble, Float[Array, "rows act_dim"]]) -> CriticEnsemble:
        critic, direction = pair

        def along(critic: CriticEnsemble) -> Float[Array, ""]:
            _, slope = jax.jvp(lambda a: _values(critic, observations, a), (actions,), (direction,))
            return jnp.sum(slope)  # sum_rows <c_k, grad_a Q_k>

        return jax.grad(along)(critic)

    return over_members(member, (critics, directions)), jnp.zeros_like(observations), jnp.zeros_like(actions)


action_diversity.defvjp(_forward, _backward)
