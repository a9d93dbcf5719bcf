"""CQL's penalty (CQL(H), Kumar et al. 2020): a soft maximum over actions comes down, the logged action goes up.

    gap_k(s, a) = T log sum_i exp( ( Q_k(s, a_i) - log p_i ) / T ) - Q_k(s, a)

The 3 n actions a_i of a state are n uniform ones, n of the policy at s' and n of the policy at s, each with the density
p_i that it was drawn from: the sum is an importance-sampled integral over actions. All of them are valued at s, those
drawn at s' too. Actions and densities are constants. log(3 n), which no gradient sees, is not subtracted.
"""

import math
from typing import Literal

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.critics import CriticEnsemble
from odaf.components.numbers import Number
from odaf.components.policies import SquashedGaussianActor, draw_actions
from odaf.components.targets import frozen
from odaf.data.transitions import Transitions

SoftMaximum = Literal["all", "threes"]


def candidate_actions(
    key: PRNGKeyArray, actor: SquashedGaussianActor, batch: Transitions, num_actions: int
) -> tuple[Float[Array, "three_n rows act_dim"], Float[Array, "three_n rows"]]:
    """The a_i and log p_i of every row: n uniform actions, n of the policy at s', n of the policy at s; constants."""
    key_uniform, key_here, key_next = jr.split(key, 3)
    actor = frozen(actor)
    rows, act_dim = batch.actions.shape
    shape = (num_actions, rows, act_dim)
    uniform = jr.uniform(key_uniform, shape, minval=-1.0, maxval=1.0)
    here, density_here = draw_actions(actor, batch.observations, jr.normal(key_here, shape))
    following, density_following = draw_actions(actor, batch.next_observations, jr.normal(key_next, shape))
    density_uniform = jnp.full((num_actions, rows), -act_dim * math.log(2.0), uniform.dtype)
    return (
        jnp.concatenate([uniform, following, here]),
        jnp.concatenate([density_uniform, density_following, density_here]),
    )


def soft_maximum(
    values: Float[Array, "three_n rows"],
    log_density: Float[Array, "three_n rows"],
    temperature: Number = 1.0,
    over: SoftMaximum = "all",
) -> Float[Array, " rows"]:
    """T log sum_i exp( (q_i - log p_i) / T ) of every row.

    Args:
        values: q_i.
        log_density: log p_i; constants.
        temperature: T.
        over: "all" 3 n actions; or "threes", the mean over n such sums of one action a source, as some public codes
            have it.
    """
    weighted = (values - jax.lax.stop_gradient(log_density)) / temperature
    if over == "all":
        return temperature * jax.nn.logsumexp(weighted, axis=0)
    by_source = weighted.reshape(3, -1, weighted.shape[1])
    return temperature * jnp.mean(jax.nn.logsumexp(by_source, axis=0), axis=0)


def values_and_gaps(
    critic: CriticEnsemble,
    batch: Transitions,
    candidates: Float[Array, "three_n rows act_dim"],
    log_density: Float[Array, "three_n rows"],
    temperature: Number = 1.0,
    over: SoftMaximum = "all",
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Q_k(s, a) and gap_k(s, a) of a single member, from one call for all actions of a state.

    Args:
        critic: one member, as inside `over_members`.
        batch: rows of the log.
        candidates: a_i, of `candidate_actions`.
        log_density: log p_i.
        temperature: T.
        over: see `soft_maximum`.
    """
    values = critic.values_of_many(batch.observations, jnp.concatenate([candidates, batch.actions[None]]))
    logged = values[-1]
    return logged, soft_maximum(values[:-1], log_density, temperature, over) - logged
