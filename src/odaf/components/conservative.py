"""CQL's penalty (CQL(H), Kumar et al. 2020): a soft maximum over actions comes down, the logged action goes up.

    gap_k(s, a) = T log sum_i exp( ( Q_k(s, a_i) - log p_i ) / T ) - Q_k(s, a)

The 3 n actions a_i of a state are n uniform ones, n of the policy at s' and n of the policy at s, each with the density
p_i that it was drawn from: the sum is an importance-sampled integral over actions. All of them are valued at s, those
drawn at s' too. Actions and densities are constants. log(3 n), which no gradient sees, is not subtracted.
"""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.chunks import draws_at_once
from odaf.components.critics import CriticEnsemble
from odaf.components.numbers import Number
from odaf.components.policies import SquashedGaussianActor, draw_actions
from odaf.components.targets import frozen
from odaf.data.transitions import Transitions

SoftMaximum = Literal["all", "threes"]


class Candidates(eqx.Module):
    """States and the actions that are valued at each: the a_i, and last the logged one. Constants."""

    observations: Float[Array, "*chunks rows obs_dim"]
    actions: Float[Array, "*chunks three_n_and_one rows act_dim"]
    log_density: Float[Array, "*chunks three_n rows"]  # log p_i

    def in_chunks(self) -> "Candidates":
        """The same with a first axis [chunks]: states go through a critic so many at once as its cache has room for."""
        count = self.actions.shape[1] // draws_at_once(self.actions.shape[1], self.actions.shape[0])
        return Candidates(
            self.observations.reshape(count, -1, self.observations.shape[1]),
            chunks_of_rows(self.actions, count),
            chunks_of_rows(self.log_density, count),
        )


def chunks_of_rows(columns: Float[Array, "draws rows *width"], count: int) -> Float[Array, "chunks draws part *width"]:
    """Rows in the second axis cut into `count` equal parts along a new first axis."""
    draws, rows, *width = columns.shape
    return jnp.moveaxis(columns.reshape(draws, count, rows // count, *width), 1, 0)


def draw_candidates(
    key: PRNGKeyArray, actor: SquashedGaussianActor, batch: Transitions, num_actions: int
) -> Candidates:
    """The a_i and log p_i of every row: n uniform actions, n of the policy at s', n of the policy at s."""
    key_uniform, key_here, key_next = jr.split(key, 3)
    actor = frozen(actor)
    rows, act_dim = batch.actions.shape
    shape = (num_actions, rows, act_dim)
    uniform = jr.uniform(key_uniform, shape, minval=-1.0, maxval=1.0)
    here, density_here = draw_actions(actor, batch.observations, jr.normal(key_here, shape))
    following, density_following = draw_actions(actor, batch.next_observations, jr.normal(key_next, shape))
    density_uniform = jnp.full((num_actions, rows), -act_dim * math.log(2.0), uniform.dtype)
    return Candidates(
        batch.observations,
        jnp.concatenate([uniform, following, here, batch.actions[None]]),
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
    critic: CriticEnsemble, candidates: Candidates, temperature: Number = 1.0, over: SoftMaximum = "all"
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Q_k(s, a) and gap_k(s, a) of a single member, from one call for all actions of a state.

    Args:
        critic: one member, as inside `over_members`.
        candidates: the whole, or one chunk.
        temperature: T.
        over: see `soft_maximum`.
    """
    values = critic.values_of_many(candidates.observations, candidates.actions)
    return values[-1], soft_maximum(values[:-1], candidates.log_density, temperature, over) - values[-1]
