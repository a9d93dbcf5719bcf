"""Several actions a state, the best of which counts: in a target by all critics, in acting by one.

V(s') = max_i ( w min_k Q'_k(s', a_i) + (1 - w) max_k Q'_k(s', a_i) ),     over the critics first, then over actions
"""

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from odaf.components.critics import over_members
from odaf.components.networks import MLP
from odaf.components.numbers import Number

FIXED_SEED = 0


def best_soft_value(
    critics: MLP,
    observations: Float[Array, "rows obs_dim"],
    candidates: Float[Array, "draws rows act_dim"],
    lowest_weight: Number,
) -> Float[Array, " rows"]:
    """V of the best candidate of each row.

    Args:
        critics: a stack of Q-functions.
        observations: states, whose part of the first layer is computed once for all candidates.
        candidates: a_i of each state.
        lowest_weight: w.
    """
    values = over_members(lambda critic: critic.of_draws(observations, candidates)[..., 0], critics)
    soft = lowest_weight * jnp.min(values, axis=0) + (1.0 - lowest_weight) * jnp.max(values, axis=0)
    return jnp.max(soft, axis=0)


def best_candidate(
    critic: MLP, observations: Float[Array, "rows obs_dim"], candidates: Float[Array, "draws rows act_dim"]
) -> Float[Array, "rows act_dim"]:
    """The candidate of each row that a single critic values most; of equal ones the first."""
    best = jnp.argmax(critic.of_draws(observations, candidates)[..., 0], axis=0)
    return jnp.take_along_axis(candidates, best[None, :, None], axis=0)[0]


def fixed_normal(candidates: int, width: int) -> Float[Array, "candidates width"]:
    """Standard normal noise that never changes: what a policy ranks when it is to act deterministically."""
    return jr.normal(jr.key(FIXED_SEED), (candidates, width))
