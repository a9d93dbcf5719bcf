"""Adam as two functions of arrays, so that learners carry nothing but its moments from update to update."""

import math

import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PyTree

from odaf.components.numbers import Number


def initial_moments(parameters: PyTree) -> optax.OptState:
    """Adam's state before the first step: zeros of the parameters' shapes, and a count of steps."""
    return optax.adam(1.0).init(parameters)  # whatever the rate, the state is the same


def cosine_fall(angle: Float[Array, ""]) -> Float[Array, ""]:
    """Factor of a step size that falls along half a cosine: 1 at an angle of 0, 0 at pi."""
    return 0.5 * (1.0 + jnp.cos(angle))


def falling_rate(rate: Number, step: Int[Array, ""], steps: int) -> Number:
    """A step size after `step` of the `steps` in which it falls to 0 along half a cosine; 0 steps keep it as it is."""
    return rate if steps == 0 else rate * cosine_fall(math.pi * (jnp.minimum(step, steps) / steps))


def adam_step(
    rate: Number, gradient: PyTree, moments: optax.OptState, parameters: PyTree
) -> tuple[PyTree, optax.OptState]:
    """One step of Adam (Kingma & Ba 2015) with the usual decay rates, 0.9 and 0.999.

    Args:
        rate: step size.
        gradient: of the loss, with the structure of `parameters`.
        moments: from `initial_moments` or the step before.
        parameters: what to move.

    Returns:
        The moved parameters and the new moments.
    """
    updates, moments = optax.adam(rate).update(gradient, moments, parameters)
    return optax.apply_updates(parameters, updates), moments
