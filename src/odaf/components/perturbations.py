"""Worst cases inside a box |offset| <= radius around a state, found by sampling or by signed ascent."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.numbers import Number
from odaf.data.padding import Padding

Objective = Callable[[Float[Array, "rows obs_dim"]], Float[Array, " rows"]]


def draw_offsets(
    key: PRNGKeyArray,
    draws: int,
    rows: int,
    obs_dim: int,
    radius: Number,
    *,
    shared: bool,
    include_centre: bool,
    padding: Padding | None = None,
) -> Float[Array, "draws rows obs_dim"]:
    """Uniform offsets in the box.

    Args:
        key: random key.
        draws: offsets a state.
        rows: states in the batch.
        obs_dim: state dimension.
        radius: half the edge of the box, in normalised units.
        shared: every state of the batch gets the same offsets (as in RORL's code) instead of its own.
        include_centre: the first draw is replaced by the state itself.
        padding: which dimensions are a data set's own; along the others offsets are 0.
    """

    def uniform(width: int) -> Float[Array, "draws states {width}"]:
        shape = (draws, 1 if shared else rows, width)
        return jr.uniform(jr.clone(key), shape, minval=-radius, maxval=radius)

    drawn = uniform(obs_dim) if padding is None else padding.over_states(uniform, obs_dim)
    offsets = jnp.broadcast_to(drawn, (draws, rows, obs_dim))
    return offsets.at[0].set(0.0) if include_centre else offsets


def signed_ascent(
    objective: Objective, offsets: Float[Array, "rows obs_dim"], radius: Number, steps: int
) -> Float[Array, "rows obs_dim"]:
    """Offsets that raise a row-wise objective, by projected steps along the sign of its gradient.

    One step from the centre goes straight to a corner of the box, which is the maximum of any objective that is linear
    in the box. More steps are shorter (twice the radius divided by their number) and are projected back.

    Args:
        objective: maps offsets to one value a row; rows must not interact.
        offsets: starting point, inside the box.
        radius: half the edge of the box.
        steps: at least one.

    Returns:
        Offsets inside the box, without gradient.
    """
    length = radius if steps == 1 else 2.0 * radius / steps
    gradient = jax.grad(lambda candidate: jnp.sum(objective(candidate)))
    for _ in range(steps):
        offsets = jnp.clip(offsets + length * jnp.sign(gradient(offsets)), -radius, radius)
    return jax.lax.stop_gradient(offsets)


def worst_offsets(objective: Objective, offsets: Float[Array, "draws rows obs_dim"]) -> Float[Array, "rows obs_dim"]:
    """For every row, the one of its draws with the largest objective.

    The gradient of a maximum over draws is the gradient at the draw that attains it. So draws are judged without
    gradients, one at a time so that the activations of a pass stay in the cache, and only the winner needs a backward
    pass.

    Args:
        objective: maps one offset a row to one value a row; rows must not interact.
        offsets: candidates.

    Returns:
        Offsets without gradient; of equal ones the first.
    """
    scores = jax.lax.map(objective, offsets)
    best = jnp.argmax(scores, axis=0)
    return jax.lax.stop_gradient(offsets[best, jnp.arange(offsets.shape[1])])
