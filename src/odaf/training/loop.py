"""Many updates in one compiled call.

Data, state and metrics stay on the device for a whole stretch. Each update's randomness is a function of the seed and
of the update's number alone, and one compiled function serves stretches of every length; so where a run is cut into
stretches, stopped or resumed changes no bit of its result.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.algorithms.base import Algorithm
from odaf.data.sampling import Columns, sample
from odaf.data.spec import Spec

# What a seed's key is folded with, one number a purpose.
_PRETRAIN, _INIT, _TRAIN = 0, 1, 2


def pretrain_key(seed: int) -> PRNGKeyArray:
    """Key of everything a learner does before its first update."""
    return jr.fold_in(jr.key(seed), _PRETRAIN)


def init_key(seed: int) -> PRNGKeyArray:
    """Key of a learner's initial parameters."""
    return jr.fold_in(jr.key(seed), _INIT)


def training_key(seed: int) -> PRNGKeyArray:
    """Key that `train_stretch` folds with the number of each update."""
    return jr.fold_in(jr.key(seed), _TRAIN)


@eqx.filter_jit
def first_state(algorithm: Algorithm, spec: Spec, seed_key: PRNGKeyArray, side: Any) -> Any:
    """A learner's state before its first update, around its side networks; compiled, as op by op it takes seconds."""
    return algorithm.init(seed_key, spec, side)


def settled(state: Any) -> Any:
    """`state` with every array in a buffer of its own and of a firm type.

    A target network that is the same array as its network could not be donated twice, and an array of weak type would
    compile differently from the one that a checkpoint gives back.
    """
    return jax.tree.map(lambda leaf: _firm(jnp.copy(leaf)) if eqx.is_array(leaf) else leaf, state)


Fixed = tuple[Algorithm, Columns, PRNGKeyArray, Int[Array, ""], Int[Array, ""]]


@eqx.filter_jit(donate="all-except-first")
def train_stretch(fixed: Fixed, state: Any) -> tuple[Any, dict[str, Float[Array, ""]]]:
    """Runs updates `first + 1` to `last` and reduces their metrics.

    Args:
        fixed: the learner, what batches are drawn from, the seed's `training_key`, `first` and `last`. Calls that
            differ in the last three only share one compiled function; with `last` equal to `first` no update is run.
        state: the learner's state after `first` updates. Its memory is given to the result: do not use it again.

    Returns:
        The state after `last` updates, and one scalar a metric: the largest where its name ends in `/max`, the smallest
        where it ends in `/min`, otherwise the mean over the updates. One value that is not a number makes the result
        not a number.
    """
    algorithm, columns, key, first, last = fixed
    arrays, static = eqx.partition(state, eqx.is_array)

    def update(arrays: Any, step: Int[Array, ""]) -> tuple[Any, dict[str, Array]]:
        key_sample, key_update = jr.split(jr.fold_in(key, step))
        batch = sample(columns, key_sample, algorithm.batch_size)
        after, metrics = algorithm.update(eqx.combine(arrays, static), batch, key_update)
        metrics = {name: jnp.asarray(value).astype(jnp.float32) for name, value in metrics.items()}
        return jax.tree.map(_firm, eqx.filter(after, eqx.is_array)), metrics

    def one(step: Int[Array, ""], carry: tuple[Any, dict[str, Array]]) -> tuple[Any, dict[str, Array]]:
        arrays, totals = carry
        arrays, metrics = update(arrays, step)
        return arrays, {name: _accumulate(name, totals[name], value) for name, value in metrics.items()}

    _, shapes = jax.eval_shape(update, arrays, first)
    totals = {name: jnp.full(shape.shape, _start(name), jnp.float32) for name, shape in shapes.items()}
    arrays, totals = jax.lax.fori_loop(first, last, one, (arrays, totals))
    count = jnp.maximum(last - first, 1).astype(jnp.float32)
    means = {name: value if name.endswith(("/max", "/min")) else value / count for name, value in totals.items()}
    return eqx.combine(arrays, static), means


def is_finite(state: Any) -> bool:
    """Whether every floating-point number in `state` is finite."""
    numbers = jax.tree.leaves(eqx.filter(state, eqx.is_inexact_array))
    return all(bool(jnp.isfinite(leaf).all()) for leaf in numbers)


def _firm(leaf: Array) -> Array:
    return jax.lax.convert_element_type(leaf, leaf.dtype)


def _start(name: str) -> float:
    if name.endswith("/max"):
        return -float("inf")
    return float("inf") if name.endswith("/min") else 0.0


def _accumulate(name: str, total: Array, value: Array) -> Array:
    if name.endswith("/max"):
        return jnp.maximum(total, value)
    return jnp.minimum(total, value) if name.endswith("/min") else total + value
