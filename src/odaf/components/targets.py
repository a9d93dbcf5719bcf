"""Bellman targets, the range of values that the rewards allow, and slowly moving copies."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from odaf.components.numbers import Number
from odaf.data.spec import Spec

Networks = TypeVar("Networks", bound=PyTree)


def bellman_target(
    rewards: Float[Array, "*one rows"],
    terminated: Float[Array, "*one rows"],
    next_values: Float[Array, "*critics rows"],
    discount: Number,
) -> Float[Array, "*critics rows"]:
    """y = r + discount * (1 - d) * V(s'): a true end bootstraps to zero, a time-out (d = 0) does not."""
    return rewards + discount * (1.0 - terminated) * next_values


def value_range(spec: Spec, discount: Number) -> tuple[Number, Number]:
    """Smallest and largest discounted return that the logged rewards allow; floats for a float, else arrays.

    A stream of rewards in [r_min, r_max] that goes on for ever is worth between r_min / (1 - discount) and
    r_max / (1 - discount). Where the log shows true ends, a stream may also stop after one reward, so r_min and r_max
    themselves belong to the range.
    """
    horizon = 1.0 / (1.0 - discount)
    low, high = spec.reward_min * horizon, spec.reward_max * horizon
    if spec.ever_terminates:
        if isinstance(low, float) and isinstance(high, float):
            return min(low, spec.reward_min), max(high, spec.reward_max)
        return jnp.minimum(low, spec.reward_min), jnp.maximum(high, spec.reward_max)
    return low, high


def polyak(slow: Networks, online: Networks, rate: Number) -> Networks:
    """(1 - rate) * slow + rate * online, leaf by leaf."""
    moving, fixed = eqx.partition(slow, eqx.is_inexact_array)
    new, _ = eqx.partition(online, eqx.is_inexact_array)
    return eqx.combine(jax.tree.map(lambda s, o: (1.0 - rate) * s + rate * o, moving, new), fixed)


def frozen(networks: Networks) -> Networks:
    """The same networks with every parameter under a stop-gradient: functions of their inputs only."""
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_array(leaf) else leaf, networks)


def copy_of(networks: Networks) -> Networks:
    """A copy with buffers of its own, so that both can be donated to a compiled call."""
    return jax.tree.map(lambda leaf: jnp.array(leaf, copy=True) if eqx.is_array(leaf) else leaf, networks)
