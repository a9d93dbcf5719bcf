"""One way to fit a network to columns of data: Adam on batches of rows, in compiled stretches, with early stopping.

Whatever is fitted outside the loop of updates goes through `fit`: dynamics models, a start from the log, clones. Data,
networks, keys and numbers are arguments of the compiled program, so that it is compiled once for a kind of network and
a shape of data, whichever seed, log or step size it is then called with.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, Integer, PRNGKeyArray, PyTree, Shaped

from odaf.components import together
from odaf.components.adam import adam_step, cosine_fall, initial_moments
from odaf.components.targets import copy_of, polyak
from odaf.errors import DivergenceError

STRETCH = 1_000
BLOCK = 4_096
LEAST_SHARE, AVERAGED_SHARE = 1e-4, 9.0  # of an average: 1 - min( 0.9999, (1 + t) / (10 + t) ) after step t = 1, 2, ...

Model = TypeVar("Model")
Batch = tuple[Array, ...]
Schedule = Literal["cosine", "constant"]
Progress = Callable[[int, int], None]
# (model, batch, key) -> loss, figures to watch; with a slow copy: (model, batch, key, slow copy)
Loss = Callable[..., tuple[Float[Array, ""], dict[str, Float[Array, ""]]]]
# (model, batch) -> array with a leading axis of rows
OfRows = Callable[[Any, Any], Array]


@dataclasses.dataclass(frozen=True)
class EarlyStopping:
    """When to stop before the last step, and what to keep then."""

    error: OfRows
    """(model, batch) -> an error for every row, or with `join` one for every row and member. A function of a module, so
    that it is compiled once."""
    first: int
    """Row of the columns where the rows begin that the error is measured on."""
    last: int
    """Row before which they end."""
    patience: int
    """Checks in a row without a new lowest mean error, after which fitting stops. There is one after every stretch."""
    least_gain: float = 0.0
    """Share of the lowest error by which a new one must be lower to count."""
    join: Callable[[Any, Any, Bool[Array, " members"]], Any] | None = None
    """(model now, model kept, which members are better now) -> model to keep: each member stops for itself then, and
    fitting stops once no member has been better for so many checks. None judges a model as a whole."""


@dataclasses.dataclass(frozen=True)
class Fitted(Generic[Model]):
    """A fitted model and how it got there."""

    model: Model
    """After the last step; with early stopping, the one with the lowest error; averaged where that was asked for."""
    means: dict[str, float]
    """Of the loss ("loss") and its figures over the last stretch."""
    steps: int
    """Taken; early stopping may keep an earlier model."""
    error: float | None
    """The lowest mean error that early stopping saw; where members stop for themselves, the mean of theirs."""


class _Recipe(NamedTuple):
    """What the compiled program is made for."""

    loss: Loss
    batch_size: int
    members: int | None
    ensemble: int | None
    schedule: Schedule
    noisy: bool
    decays: bool
    averages: bool
    stretch: int


class _State(NamedTuple):
    parameters: PyTree
    moments: optax.OptState
    slow: PyTree  # None without a slow copy or an average


def fit(
    model: Model,
    loss: Loss,
    columns: Batch,
    *,
    steps: int,
    batch_size: int,
    learning_rate: float,
    key: PRNGKeyArray,
    what: str,
    remedy: str,
    progress: Progress,
    schedule: Schedule = "constant",
    rows: int | None = None,
    bootstraps: Integer[Array, " entries"] | None = None,
    members: int | None = None,
    part_of: tuple[int, int] | None = None,
    trainable: PyTree | None = None,
    slow_rate: float | None = None,
    weight_decay: float = 0.0,
    averages: bool = False,
    noisy: bool = True,
    stretch: int = STRETCH,
    stopping: EarlyStopping | None = None,
) -> Fitted[Model]:
    """Adam on batches drawn with replacement.

    Args:
        model: where to start; a tree of arrays. It is copied, so that it can be used afterwards.
        loss: of a model, a batch and a key: the loss, and figures to watch by name. A function of a module and no
            closure, since each closure is compiled anew; numbers that change from call to call belong in the model, as
            leaves that are not trainable, or in the columns.
        columns: what batches are drawn from; arrays with a leading axis of rows.
        steps: gradient steps.
        batch_size: rows a batch, for every member if there are `bootstraps`.
        learning_rate: step size at the start.
        key: random key for batches and losses.
        what: the model's name, for error messages.
        remedy: what to do if the loss diverges, for the same messages.
        progress: called with (steps done, steps in all) after every stretch.
        schedule: "cosine" lets the step size fall to zero over the steps, "constant" keeps it.
        rows: how many of the columns' rows are drawn from, from the first on; None all. The rest may be for `stopping`.
        bootstraps: of `bootstrap_rows`: each member draws from rows of its own, and batches have an axis of members.
        members: how many members `bootstraps` are for.
        part_of: (the first member's number, members in all) where these are some of an ensemble whose others are fitted
            by calls of their own: each draws the batches that it has where all are fitted in one call, and `bootstraps`
            are those of all.
        trainable: a tree of booleans in the model's structure; the rest stays as it is. None trains all real numbers.
        slow_rate: share of the model that enters a slow copy of it after each step; the loss is then called with that
            copy too, under the name `slow`. None keeps no copy.
        weight_decay: share of the parameters, times the step size, that each step takes away beside Adam's (AdamW).
        averages: whether to return an average over the steps in place of the last parameters. After step t it moves
            max( 1e-4, 9 / (10 + t) ) of the way to the new parameters, so it reaches over a ninth of the steps, and
            10,000 at most. Offered without a slow copy and without early stopping.
        noisy: whether the loss uses its key. If not, the key of a step goes to the batch undivided.
        stretch: steps in one compiled call.
        stopping: None takes all steps.

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    trainable = jax.tree.map(eqx.is_inexact_array, model) if trainable is None else trainable
    parameters, fixed = eqx.partition(model, trainable)
    parameters = copy_of(parameters)
    assert not averages or (slow_rate is None and stopping is None), "an average stands in place of both"
    has_copy = averages or slow_rate is not None
    state = _State(parameters, initial_moments(parameters), copy_of(parameters) if has_copy else None)
    first, ensemble = (0, members) if part_of is None else part_of
    recipe = _Recipe(loss, batch_size, members, ensemble, schedule, noisy, weight_decay > 0.0, averages, stretch)
    numbers = {
        "first": _number(first),  # member
        "learning_rate": jnp.asarray(learning_rate, jnp.float32),
        "turn": jnp.asarray(np.float32(np.pi) * (np.float32(1.0) / np.float32(steps))),  # of the cosine, a step
        "slow_rate": jnp.asarray(slow_rate or 0.0, jnp.float32),
        "weight_decay": jnp.asarray(weight_decay, jnp.float32),
    }
    count = _number(columns[0].shape[0] if rows is None else rows)

    done, means, lowest, best, checks_without_gain = 0, {}, np.asarray(math.inf), None, 0
    while done < steps:
        last = min(done + stretch, steps)
        state, traces = together.call(
            _stretch, recipe, (done, last), state, fixed, columns, bootstraps, count, numbers, key
        )
        means = {name: float(jnp.mean(trace[: last - done])) for name, trace in traces.items()}
        if not np.isfinite(float(traces["loss"][last - done - 1])):
            raise DivergenceError(f"{what}: the training loss is not finite after {last} steps; {remedy}")
        done = last
        progress(done, steps)
        if stopping is not None:
            current = eqx.combine(state.parameters, fixed)
            errors = np.mean(of_rows(stopping.error, current, columns, stopping.first, stopping.last), axis=0)
            better = errors < (1.0 - stopping.least_gain) * lowest
            lowest = np.where(better, errors, lowest)
            checks_without_gain += 1
            if np.any(better):
                kept, checks_without_gain = best, 0
                best = copy_of(state.parameters)
                if stopping.join is not None and kept is not None:
                    best = stopping.join(best, kept, jnp.asarray(better))
            if checks_without_gain >= stopping.patience:
                break
    kept = state.slow if averages else state.parameters if best is None else best
    return Fitted(eqx.combine(kept, fixed), means, done, None if stopping is None else float(np.mean(lowest)))


def bootstrap_rows(key: PRNGKeyArray, members: int, rows: int, among: int) -> Integer[Array, " entries"]:
    """A sample with replacement of the first `rows` rows for every member, one after another.

    Args:
        key: random key.
        members: how many samples.
        rows: entries of each, and rows that they are drawn from.
        among: rows of the columns. The result has room for samples of that size, so that its shape does not depend on
            how many of them are held out.
    """
    return jr.randint(key, (members * among,), 0, _number(rows))


def own(drawn: Shaped[Array, "ensemble *rest"], first: Int[Array, ""], members: int) -> Shaped[Array, "members *rest"]:
    """What belongs to some of an ensemble's members, of what was drawn for all.

    Args:
        drawn: with a leading axis of all members.
        first: number of the first of them.
        members: how many they are.
    """
    return drawn if len(drawn) == members else jax.lax.dynamic_slice_in_dim(drawn, first, members)


def of_rows(function: OfRows, model: Any, columns: Batch, first: int = 0, last: int | None = None) -> np.ndarray:
    """What a function says of each of the rows from `first` on, worked through in blocks of one shape.

    Args:
        function: of a model and a batch; its result has a leading axis of rows. A function of a module, so that it is
            compiled once.
        model: handed to the function.
        columns: arrays with a leading axis of rows.
        first: row to begin with.
        last: row to stop before; None goes on to the end.
    """
    total = columns[0].shape[0]
    last = total if last is None else last
    blocks = [_block(function, model, columns, _number(start)) for start in range(first, last, min(BLOCK, total))]
    return np.concatenate([np.asarray(block) for block in blocks])[: last - first]


@functools.partial(jax.jit, static_argnames="function")
def _block(function: OfRows, model: Any, columns: Batch, start: Int[Array, ""]) -> Array:
    total = columns[0].shape[0]
    rows = jnp.minimum(start + jnp.arange(min(BLOCK, total)), total - 1)  # beyond the end, the last row once more
    return function(model, tuple(column[rows] for column in columns))


def _stretch(
    recipe: _Recipe,
    steps: tuple[Int[Array, ""], Int[Array, ""]],
    state: _State,
    fixed: PyTree,
    columns: Batch,
    bootstraps: Integer[Array, " entries"] | None,
    rows: Int[Array, ""],
    numbers: dict[str, Array],
    key: PRNGKeyArray,
) -> tuple[_State, dict[str, Float[Array, " stretch"]]]:
    """The steps from the first to the last, at most a stretch of them, and the loss and its figures on the way."""
    first, last = steps

    def batch_of(key: PRNGKeyArray) -> Batch:
        if recipe.members is None or recipe.ensemble is None:
            picked = jr.randint(key, (recipe.batch_size,), 0, rows)
        else:
            picked = own(
                jr.randint(key, (recipe.ensemble, recipe.batch_size), 0, rows), numbers["first"], recipe.members
            )
        if bootstraps is not None:
            members = numbers["first"] + jnp.arange(picked.shape[0])
            picked = bootstraps[members[:, None] * rows + picked]
        return tuple(column[picked] for column in columns)

    @jax.jit  # so that it is traced once for both of its uses
    def step(state: _State, index: Int[Array, ""]) -> tuple[_State, dict[str, Float[Array, ""]]]:
        key_step = jr.fold_in(key, index)
        key_draw, key_loss = jr.split(key_step) if recipe.noisy else (key_step, key_step)
        batch = batch_of(key_draw)
        slow = {} if state.slow is None or recipe.averages else {"slow": eqx.combine(state.slow, fixed)}

        def loss(parameters: PyTree) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
            return recipe.loss(eqx.combine(parameters, fixed), batch, key_loss, **slow)

        (value, figures), gradient = jax.value_and_grad(loss, has_aux=True)(state.parameters)
        rate = numbers["learning_rate"]
        if recipe.schedule == "cosine":
            rate = rate * cosine_fall(index.astype(jnp.float32) * numbers["turn"])
        parameters = state.parameters
        if recipe.decays:
            parameters = jax.tree.map(lambda leaf: leaf - rate * numbers["weight_decay"] * leaf, parameters)
        parameters, moments = adam_step(rate, gradient, state.moments, parameters)
        slow_rate = numbers["slow_rate"]
        if recipe.averages:
            slow_rate = jnp.maximum(LEAST_SHARE, AVERAGED_SHARE / (AVERAGED_SHARE + 2.0 + index.astype(jnp.float32)))
        slow_copy = None if state.slow is None else polyak(state.slow, parameters, slow_rate)
        return _State(parameters, moments, slow_copy), {**figures, "loss": value}

    def one(index: Int[Array, ""], carry: tuple[_State, dict[str, Array]]) -> tuple[_State, dict[str, Array]]:
        state, figures = step(carry[0], index)
        return state, {name: carry[1][name].at[index - first].set(figure) for name, figure in figures.items()}

    _, shapes = jax.eval_shape(step, state, first)
    traces = {name: jnp.zeros((recipe.stretch,), figure.dtype) for name, figure in shapes.items()}
    return jax.lax.fori_loop(first, last, one, (state, traces))


def _number(value: int) -> Int[Array, ""]:
    return jnp.asarray(value, jnp.int32)
