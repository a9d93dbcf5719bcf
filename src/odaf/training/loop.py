"""Many updates in one compiled call.

Data, state and metrics stay on the device for a whole stretch. Each update's randomness is a function of the seed and
of the update's number alone, and one compiled function serves stretches of every length; so where a run is cut into
stretches, stopped or resumed changes no bit of its result.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from odaf.algorithms.base import Algorithm
from odaf.algorithms.numbers import Numbers, joined, split
from odaf.data.padding import Padding
from odaf.data.sampling import Columns, Slab, WeightedColumns
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError
from odaf.training import averaging

# First row and number of rows of each lane's data set.
Slabs = tuple[Int[Array, " lanes"], Int[Array, " lanes"]]
ManyNumbers = dict[str, Float[Array, " lanes"]]

# What a seed's key is folded with, one number a purpose.
_PRETRAIN, _INIT, _TRAIN = 0, 1, 2
# What the training key is folded with for the keys of refreshes; no update has this number.
_REFRESH = 2**31
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


def first_state(algorithm: Algorithm, spec: Spec, seed_key: PRNGKeyArray, models: Any) -> Any:
    """A learner's state before its first update, around its models; compiled, as op by op it takes seconds."""
    return _first_state(*split(algorithm), spec, seed_key, models)


@eqx.filter_jit
def _first_state(structure: Algorithm, numbers: Numbers, spec: Spec, seed_key: PRNGKeyArray, models: Any) -> Any:
    return averaging.begin(joined(structure, numbers), seed_key, spec, models)


def donatable(state: Any) -> Any:
    """`state` with every array in a buffer of its own and of a strong type.

    A target network that is the same array as its network could not be donated twice, and an array of weak type would
    compile differently from the one that a checkpoint gives back.
    """
    return jax.tree.map(lambda leaf: _strong(jnp.copy(leaf)), state)


def train_stretch(
    algorithm: Algorithm,
    columns: Columns,
    key: PRNGKeyArray,
    first: Int[Array, ""],
    last: Int[Array, ""],
    state: Any,
    mesh: Mesh | None = None,
) -> tuple[Any, dict[str, Float[Array, ""]]]:
    """Runs updates `first + 1` to `last` and reduces their metrics.

    Args:
        algorithm: the learner. Learners that differ in numbers alone share one compiled function.
        columns: what batches are drawn from.
        key: the seed's `training_key`.
        first: updates that `state` has had.
        last: updates that the result will have had; if equal to `first`, no update is run. Calls that differ in key,
            `first` and `last` alone share one compiled function.
        state: the learner's state after `first` updates. Its memory is given to the result: do not use it again.
        mesh: of `batch_mesh`, over which the rows of each batch are spread, while every device holds the whole state;
            None computes on one device. Sums over a batch are then added in another order, so the bits differ.

    Returns:
        The state after `last` updates, and one scalar a metric: the largest where its name ends in `/max`, the smallest
        where it ends in `/min`, otherwise the mean over the updates. One value that is not a number makes the result
        not a number.
    """
    return _train_stretch(*split(algorithm), columns, key, first, last, state, mesh)


@functools.partial(jax.jit, static_argnames=("structure", "mesh"), donate_argnames="state")
def _train_stretch(
    structure: Algorithm,
    numbers: Numbers,
    columns: Columns,
    key: PRNGKeyArray,
    first: Int[Array, ""],
    last: Int[Array, ""],
    state: Any,
    mesh: Mesh | None = None,
) -> tuple[Any, dict[str, Float[Array, ""]]]:
    return _stretch(joined(structure, numbers), columns, mesh, first, last, key, state)


def train_lanes(
    structure: Algorithm,
    numbers: ManyNumbers,
    columns: Columns,
    slabs: Slabs | None,
    keys: Key[Array, " lanes"],
    first: Int[Array, ""],
    last: Int[Array, ""],
    states: Any,
    padding: Padding | None = None,
) -> tuple[Any, dict[str, Float[Array, " lanes"]]]:
    """`train_stretch` for many trainings in one compiled call; each lane is a training of its own.

    Lanes differ in seed, in the numbers of their settings, and in which data set they draw from.

    Args:
        structure: of `odaf.algorithms.numbers.split`, the same for all lanes.
        numbers: each with a leading axis [lanes].
        columns: what batches are drawn from. With `slabs`, the rows of several data sets one behind the other.
        slabs: first row and number of rows of each lane's data set; None draws from all of `columns`.
        keys: the lanes' `training_key`s, stacked.
        first: updates that `states` have had, the same for all lanes; what is done every n updates alone is branched to
            because it is.
        last: updates that the result will have had.
        states: the `stacked` states of the lanes. Their memory is given to the result: do not use them again.
        padding: whose numbers have a leading axis [lanes], where rows and states are padded to the widest lane's.

    Returns:
        The stacked states after `last` updates, and one number a metric and lane. A lane agrees with the single run up
        to rounding, since products over many lanes are compiled differently; it does not depend on what the other lanes
        hold.
    """
    return _train_lanes(structure, numbers, columns, slabs, keys, first, last, states, padding)


@functools.partial(jax.jit, static_argnames="structure", donate_argnames="states")
def _train_lanes(
    structure: Algorithm,
    numbers: ManyNumbers,
    columns: Columns,
    slabs: Slabs | None,
    keys: Key[Array, " lanes"],
    first: Int[Array, ""],
    last: Int[Array, ""],
    states: Any,
    padding: Padding | None,
) -> tuple[Any, dict[str, Float[Array, " lanes"]]]:
    def one(
        numbers: Numbers, slab: Any, key: PRNGKeyArray, state: Any, padding: Padding | None
    ) -> tuple[Any, dict[str, Array]]:
        own = (
            Slab(columns, *slab) if slab is not None and isinstance(columns, Transitions | WeightedColumns) else columns
        )
        return _stretch(joined(structure, numbers), own, None, first, last, key, state, padding)

    return jax.vmap(one)(numbers, slabs, keys, states, padding)


# `train_stretch` for one learner and shape of its data: of columns, key, first, last and state.
CompiledStretch = Callable[..., tuple[Any, dict[str, Float[Array, ""]]]]


def compiled_stretch(algorithm: Algorithm, columns: Columns, state: Any) -> CompiledStretch:
    """`train_stretch` compiled for shapes alone, before the data and networks they belong to take any memory.

    Args:
        algorithm: the learner.
        columns: `training_column_shapes` of the data.
        state: `run_directory.blank_state` of the learner.
    """
    key = jax.eval_shape(lambda: training_key(0))
    number = jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)  # as `donatable` makes it
    structure, numbers = split(algorithm)
    compiled = _train_stretch.lower(structure, numbers, columns, key, number, number, state).compile()
    return functools.partial(compiled, numbers)


def compiled_lanes(
    algorithm: Algorithm,
    columns: Columns,
    slabs: bool,
    state: Any,
    lanes: int,
    widths: tuple[tuple[int, int], ...] = (),
) -> Any:
    """`train_lanes` compiled for shapes alone: takes numbers, columns, slabs, keys, first, last, states and padding.

    Args:
        algorithm: any of the lanes' learners.
        columns: the shapes of the columns of all data sets together.
        slabs: whether each lane has a part of them to draw from.
        state: `run_directory.blank_state` of the learner.
        lanes: how many trainings are in one call.
        widths: numbers of observations and actions that occur, where rows and state are padded; () is for all of one.
    """
    structure, numbers = split(algorithm)

    def wide(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((lanes, *leaf.shape), leaf.dtype)

    row = jax.ShapeDtypeStruct((lanes,), jnp.int32)
    number = jax.ShapeDtypeStruct((), jnp.int32)
    key = wide(jax.eval_shape(lambda: training_key(0)))
    many, states = jax.tree.map(wide, numbers), jax.tree.map(wide, state)
    borders = (row, row) if slabs else None
    padding = jax.eval_shape(lambda: padding_of([(0, 0)] * lanes, widths)) if widths else None
    return _train_lanes.lower(structure, many, columns, borders, key, number, number, states, padding).compile()


def padding_of(own: Sequence[tuple[int, int]], widths: tuple[tuple[int, int], ...]) -> Padding:
    """The padding of lanes whose states and actions have so many dimensions of their own, out of the `widths`."""
    states, actions = zip(*own, strict=True)
    return Padding(jnp.asarray(states, jnp.int32), jnp.asarray(actions, jnp.int32), widths)


def update_number(step: int) -> Int[Array, ""]:
    """A number of updates, as `train_stretch` takes it."""
    return jnp.asarray(step, dtype=jnp.int32)


def split_lanes(algorithms: Sequence[Algorithm]) -> tuple[Algorithm, ManyNumbers]:
    """(structure, numbers with a leading axis [lanes]) of learners that differ in numbers alone."""
    structures, numbers = zip(*map(split, algorithms), strict=True)
    assert all(structure == structures[0] for structure in structures), "these learners have different programs"
    return structures[0], {name: jnp.stack([each[name] for each in numbers]) for name in numbers[0]}


def stacked(states: Sequence[Any]) -> Any:
    """States of one learner as one state whose arrays have a leading axis [lanes]."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)


def lane(states: Any, index: int) -> Any:
    """One of the states that were `stacked`, in memory of its own."""
    return jax.tree.map(lambda leaf: leaf[index], states)


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
    return jax.tree.map(lambda leaf: jax.device_put(leaf, everywhere), tree)


def _stretch(
    algorithm: Algorithm,
    columns: Columns,
    mesh: Mesh | None,
    first: Int[Array, ""],
    last: Int[Array, ""],
    key: PRNGKeyArray,
    state: Any,
    padding: Padding | None = None,
) -> tuple[Any, dict[str, Array]]:
    def refreshed(state: Any, step: Int[Array, ""]) -> Any:
        key_refresh = jr.fold_in(jr.fold_in(key, _REFRESH), step)
        learner = algorithm.refresh(averaging.learner_state(state), columns, key_refresh)
        return jax.tree.map(_strong, averaging.with_learner(state, learner))

    @jax.jit  # so that it is traced once for both of its uses
    def update(state: Any, step: Int[Array, ""]) -> tuple[Any, dict[str, Array]]:
        state = averaging.at_step(state, step)
        key_sample, key_update = jr.split(jr.fold_in(key, step))
        if algorithm.refresh_every:
            is_due = step % algorithm.refresh_every == 0
            state = jax.lax.cond(is_due, refreshed, lambda state, _: state, state, step)
        batch = algorithm.batch(averaging.learner_state(state), columns, key_sample)
        if padding is not None:
            batch = batch.with_padding(padding)
        if mesh is not None:
            batch = jax.lax.with_sharding_constraint(batch, NamedSharding(mesh, PartitionSpec(_BATCH)))
        after, metrics = averaging.advanced(algorithm, state, batch, key_update)
        metrics = {name: jnp.asarray(value).astype(jnp.float32) for name, value in metrics.items()}
        after = jax.tree.map(_strong, after)
        if mesh is not None:
            after = jax.lax.with_sharding_constraint(after, NamedSharding(mesh, PartitionSpec()))
        return after, metrics

    def one(step: Int[Array, ""], carry: tuple[Any, dict[str, Array]]) -> tuple[Any, dict[str, Array]]:
        state, totals = carry
        state, metrics = update(state, step)
        return state, {name: _accumulate(name, totals[name], value) for name, value in metrics.items()}

    _, shapes = jax.eval_shape(update, state, first)
    totals = {name: jnp.full(shape.shape, _start(name), jnp.float32) for name, shape in shapes.items()}
    state, totals = jax.lax.fori_loop(first, last, one, (state, totals))
    count = jnp.maximum(last - first, 1).astype(jnp.float32)
    means = {name: value if name.endswith(("/max", "/min")) else value / count for name, value in totals.items()}
    return state, means


def is_finite(state: Any) -> bool:
    """Whether every floating-point number in `state` is finite."""
    numbers = jax.tree.leaves(eqx.filter(state, eqx.is_inexact_array))
    return all(bool(jnp.isfinite(leaf).all()) for leaf in numbers)


def _strong(leaf: Array) -> Array:
    return jax.lax.convert_element_type(leaf, leaf.dtype)


def _start(name: str) -> float:
    if name.endswith("/max"):
        return -float("inf")
    return float("inf") if name.endswith("/min") else 0.0


def _accumulate(name: str, total: Array, value: Array) -> Array:
    if name.endswith("/max"):
        return jnp.maximum(total, value)
    return jnp.minimum(total, value) if name.endswith("/min") else total + value
