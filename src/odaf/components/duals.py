"""Lagrange multipliers: the price of a constraint climbs while the constraint is broken and falls while it holds.

minimise f  so that  g <= 0:    loss f + alpha g, in which alpha is a constant,    alpha climbs along g
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from odaf.components.numbers import Number
from odaf.components.trained import Trained

Dual = Trained[Float[Array, ""]]

LOG_RANGE = (-5.0, 10.0)  # of log alpha, in BEAR's code


def ascended(
    log_multiplier: Dual,
    violation: Float[Array, ""],
    learning_rate: Number,
    bounds: tuple[float, float] = LOG_RANGE,
) -> Dual:
    """A step of Adam up alpha g with respect to log alpha, and log alpha clipped.

    Args:
        log_multiplier: log alpha, without a slow copy.
        violation: g, positive where the constraint is broken; a constant.
        learning_rate: step size.
        bounds: of log alpha.
    """
    return _stepped(log_multiplier, jnp.exp(log_multiplier.now) * violation, learning_rate, bounds)


def ascended_directly(
    multiplier: Dual, violation: Float[Array, ""], learning_rate: Number, bounds: tuple[float, float]
) -> Dual:
    """The same for a multiplier that is stored as it is: up alpha g with respect to alpha, and alpha clipped."""
    return _stepped(multiplier, violation, learning_rate, bounds)


def _stepped(dual: Dual, slope: Float[Array, ""], learning_rate: Number, bounds: tuple[float, float]) -> Dual:
    moved = dual.stepped(-jax.lax.stop_gradient(slope), learning_rate)
    return dataclasses.replace(moved, now=jnp.clip(moved.now, *bounds))
