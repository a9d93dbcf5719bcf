"""Many updates in one compiled call.

Data, state and metrics stay on the device for a whole stretch. Each update's randomness is a function of the seed and
of the update's number alone, and one compiled function serves stretches of every length; so where a run is cut into
stretches, stopped or resumed changes no bit of its result.
"""

import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from odaf.algorithms.base import Algorithm
from odaf.data.sampling import Columns, sample
from odaf.data.spec import Spec
from odaf.errors import ConfigError

# What a seed's key is folded with, one number a purpose.
_PRETRAIN, _INIT, _TRAIN = 0, 1, 2
# The axis of a mesh that the rows of a batch are spread over.
_BATCH = "batch"


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
ManyFixed = tuple[Algorithm, Columns, Key[Array, " seeds"], Int[Array, ""], Int[Array, ""]]


@eqx.filter_jit(donate="all-except-first")
def train_stretch(fixed: Fixed, state: Any, mesh: Mesh | None = None) -> tuple[Any, dict[str, Float[Array, ""]]]:
    """Runs updates `first + 1` to `last` and reduces their metrics.

    Args:
        fixed: the learner, what batches are drawn from, the seed's `training_key`, `first` and `last`. Calls that
            differ in the last three only share one compiled function; with `last` equal to `first` no update is run.
        state: the learner's state after `first` updates. Its memory is given to the result: do not use it again.
        mesh: of `batch_mesh`, over which the rows of each batch are spread, while every device holds the whole state;
            None computes on one device. Sums over a batch are then added in another order, so the bits differ.

    Returns:
        The state after `last` updates, and one scalar a metric: the largest where its name ends in `/max`, the smallest
        where it ends in `/min`, otherwise the mean over the updates. One value that is not a number makes the result
        not a number.
    """
    algorithm, columns, key, first, last = fixed
    arrays, static = eqx.partition(state, eqx.is_array)
    arrays, means = _stretch(algorithm, columns, static, mesh, first, last, key, arrays)
    return eqx.combine(arrays, static), means


@eqx.filter_jit(donate="all-except-first")
def train_stretch_many(fixed: ManyFixed, states: Any) -> tuple[Any, dict[str, Float[Array, " seeds"]]]:
    """`train_stretch` for many seeds in one compiled call; each lane is that seed's own training.

    Args:
        fixed: as for `train_stretch`, with the seeds' `training_key`s stacked, [seeds]; all seeds are at the same step.
        states: the `stacked` states of the seeds. Their memory is given to the result: do not use them again.

    Returns:
        The stacked states after `last` updates, and one number a metric and seed. A lane agrees with the single run up
        to rounding, since products over many lanes are compiled differently.
    """
    algorithm, columns, keys, first, last = fixed
    arrays, static = eqx.partition(states, eqx.is_array)
    train = functools.partial(_stretch, algorithm, columns, static, None, first, last)
    arrays, means = jax.vmap(train)(keys, arrays)
    return eqx.combine(arrays, static), means


def stacked(states: Sequence[Any]) -> Any:
    """States of one learner as one state whose arrays have a leading axis [seeds]."""
    arrays = [eqx.filter(state, eqx.is_array) for state in states]
    static = eqx.filter(states[0], eqx.is_array, inverse=True)
    return eqx.combine(jax.tree.map(lambda *leaves: jnp.stack(leaves), *arrays), static)


def lane(states: Any, index: int) -> Any:
    """One of the states that were `stacked`, in memory of its own."""
    return jax.tree.map(lambda leaf: leaf[index] if eqx.is_array(leaf) else leaf, states)


def batch_mesh(devices: int, batch_size: int) -> Mesh:
    """The first `devices` devices in a row, for batches whose rows are spread over them.

    Raises:
        ConfigError: there are fewer devices, or the rows of a batch cannot be shared evenly.
    """
    found = jax.devices()
    if not 1 <= devices <= len(found):
        raise ConfigError(f"devices: must be from 1 to the {len(found)} that JAX finds here, got {devices}")
    if batch_size % devices:
        raise ConfigError(f"devices: {batch_size} rows of a batch cannot be shared evenly by {devices}; change either")
    return jax.make_mesh((devices,), (_BATCH,), axis_types=(AxisType.Auto,), devices=found[:devices])


def on_every_device(tree: Any, mesh: Mesh) -> Any:
    """`tree` with a whole copy of each array on every device of `mesh`."""
    everywhere = NamedSharding(mesh, PartitionSpec())
    return jax.tree.map(lambda leaf: jax.device_put(leaf, everywhere) if eqx.is_array(leaf) else leaf, tree)


def _stretch(
    algorithm: Algorithm,
    columns: Columns,
    static: Any,
    mesh: Mesh | None,
    first: Int[Array, ""],
    last: Int[Array, ""],
    key: PRNGKeyArray,
    arrays: Any,
) -> tuple[Any, dict[str, Array]]:
    @jax.jit  # so that it is traced once for both of its uses
    def update(arrays: Any, step: Int[Array, ""]) -> tuple[Any, dict[str, Array]]:
        key_sample, key_update = jr.split(jr.fold_in(key, step))
        batch = sample(columns, key_sample, algorithm.batch_size)
        if mesh is not None:
            batch = jax.lax.with_sharding_constraint(batch, NamedSharding(mesh, PartitionSpec(_BATCH)))
        after, metrics = algorithm.update(eqx.combine(arrays, static), batch, key_update)
        metrics = {name: jnp.asarray(value).astype(jnp.float32) for name, value in metrics.items()}
        arrays = jax.tree.map(_firm, eqx.filter(after, eqx.is_array))
        if mesh is not None:
            arrays = jax.lax.with_sharding_constraint(arrays, NamedSharding(mesh, PartitionSpec()))
        return arrays, metrics

    def one(step: Int[Array, ""], carry: tuple[Any, dict[str, Array]]) -> tuple[Any, dict[str, Array]]:
        arrays, totals = carry
        arrays, metrics = update(arrays, step)
        return arrays, {name: _accumulate(name, totals[name], value) for name, value in metrics.items()}

    _, shapes = jax.eval_shape(update, arrays, first)
    totals = {name: jnp.full(shape.shape, _start(name), jnp.float32) for name, shape in shapes.items()}
    arrays, totals = jax.lax.fori_loop(first, last, one, (arrays, totals))
    count = jnp.maximum(last - first, 1).astype(jnp.float32)
    means = {name: value if name.endswith(("/max", "/min")) else value / count for name, value in totals.items()}
    return arrays, means


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
