"""A dataset on the device, and batches drawn from it inside compiled code."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from odaf.data.alias_table import alias_table, units_of
from odaf.data.dataset import Dataset
from odaf.data.mixing_batches import MixedColumns, sample_mixed
from odaf.data.normalisation import Normaliser, scale_actions
from odaf.data.returns_to_go import returns_to_go
from odaf.data.row_choice import drawn_from, has_table, log_weights
from odaf.data.transitions import Transitions
from odaf.data.view import Extra, View
from odaf.errors import DatasetError


class WeightedColumns(eqx.Module):
    """All columns of a data set, and the table that its rows are drawn by."""

    columns: Transitions
    kept: UInt32[Array, " rows"]  # of `alias_table`
    alias: Int[Array, " rows"]
    apart: bool = eqx.field(static=True, default=False)  # the table is for the actor; critics draw all rows alike

    @property
    def rewards(self) -> Float[Array, " rows"]:
        """Of each row."""
        return self.columns.rewards


class Slab(eqx.Module):
    """One data set among several whose rows lie one behind the other in the same arrays."""

    columns: Transitions | WeightedColumns  # the rows of all sets; an alias counts from its set's first row
    first: Int[Array, ""]  # the set's first row
    rows: Int[Array, ""]  # and how many it has


# What an update's key is folded with for the rows of an actor that draws apart.
_ACTOR = 1
# What training draws its batches from.
Columns = Transitions | MixedColumns | WeightedColumns | Slab


def training_columns(dataset: Dataset, normaliser: Normaliser, view: View = View()) -> Columns:
    """What `sample` draws batches from: `device_columns`, with the mixture of the data or the view's choice of rows.

    Raises:
        DatasetError: as `device_columns`, or a part of a mixture has no row with so many steps, or rows are chosen by
            returns that are no finite numbers.
        ConfigError: rows are chosen from data that are mixed per batch.
    """
    dataset = drawn_from(dataset, view.choice)
    columns = _with_mixture(device_columns(dataset, normaliser, view), dataset, view.return_steps)
    if not has_table(view.choice):
        return columns
    assert isinstance(columns, Transitions)  # `drawn_from` refuses mixtures
    kept, alias = alias_table(units_of(row_weights(dataset, view)))
    return WeightedColumns(columns, _on_device(kept), _on_device(alias), view.choice.critic_sampling == "uniform")


def training_column_shapes(dataset: Dataset, view: View = View()) -> Columns:
    """The shapes of `training_columns`, with nothing put on the device; raises what that does."""
    dataset = drawn_from(dataset, view.choice)
    rows = len(dataset) if view.return_steps == 1 else len(_n_step_rows(dataset, view.return_steps)[1])
    states, actions = dataset.obs_dim, dataset.act_dim

    def columns() -> Transitions | WeightedColumns:
        state, action, number = (jnp.zeros(shape) for shape in ((rows, states), (rows, actions), (rows,)))
        extras = {name: action if name == "next_actions" else number for name in view.extras}
        found = Transitions(state, action, number, state, number, extras)
        if not has_table(view.choice):
            return found
        apart = view.choice.critic_sampling == "uniform"
        return WeightedColumns(found, number.astype(jnp.uint32), number.astype(jnp.int32), apart)

    return _with_mixture(jax.eval_shape(columns), dataset, view.return_steps)


def row_weights(dataset: Dataset, view: View) -> Float[np.ndarray, " kept"]:
    """How likely each row is that batches may hold (the actor's, where critics draw from others), as a multiple of a
    row of the best episode.

    Raises:
        DatasetError: no episode that is drawn from has so many steps, or returns are no finite numbers.
        ConfigError: rows are chosen from data that are mixed per batch.
    """
    dataset = drawn_from(dataset, view.choice)
    weights = log_weights(dataset, view.choice) if has_table(view.choice) else np.ones(len(dataset))
    if view.return_steps == 1:
        return weights
    weights = weights[_n_step_rows(dataset, view.return_steps)[1]]
    if not weights.any():
        raise DatasetError(
            f"return_steps={view.return_steps}: none of the best episodes has so many steps; choose fewer, or raise "
            "best_share"
        )
    return weights


def _with_mixture(columns: Any, dataset: Dataset, return_steps: int) -> Columns:
    if dataset.mixture is None:
        return columns
    border = dataset.mixture.border
    if return_steps > 1:
        _, kept = _n_step_rows(dataset, return_steps)
        border = int((kept < border).sum())
        if border in (0, len(kept)):
            raise DatasetError(
                f"return_steps={return_steps}: no episode of the {'second' if border else 'first'} part of the mixture "
                "has so many steps; choose fewer"
            )
    return MixedColumns(columns, border, dataset.mixture.ratio)


def device_columns(dataset: Dataset, normaliser: Normaliser, view: View = View()) -> Transitions:
    """The dataset's rows on the default device: observations normalised, actions scaled to [-1, 1].

    Args:
        dataset: the log.
        normaliser: the observation scaling.
        view: what of it the learner sees. With n `return_steps`, each row gets the discounted sum of the n rewards from
            it on, the successor n steps later, and whether the task ended on the way; its value then bootstraps with
            discount to the power n. Rows that are fewer than n steps away from the cut of their episode have no such
            successor and are left out.

    Raises:
        DatasetError: no episode has so many steps.
    """
    rewards, last, kept = _n_step(dataset, view)
    return Transitions(
        observations=_on_device(normaliser.normalise(dataset.observations[kept])),
        actions=_on_device(scale_actions(dataset.actions[kept], dataset.action_low, dataset.action_high)),
        rewards=_on_device(rewards),
        next_observations=_on_device(normaliser.normalise(dataset.next_observations[last])),
        terminated=_on_device(dataset.terminated[last].astype(np.float32)),
        extras={name: _on_device(_extra(name, dataset, view, last, kept)) for name in view.extras},
    )


def _extra(name: Extra, dataset: Dataset, view: View, last: np.ndarray | slice, kept: np.ndarray | slice) -> np.ndarray:
    """One of the view's further columns, float32 [kept rows] or [kept rows, act_dim]."""
    rows = np.arange(len(dataset))
    is_last = np.append(np.diff(np.repeat(np.arange(dataset.num_episodes), dataset.episode_lengths())) != 0, True)
    if name == "next_actions":
        following = np.where(is_last, rows, rows + 1)[last]
        actions = scale_actions(dataset.actions[following], dataset.action_low, dataset.action_high)
        return np.where(is_last[last][:, None], np.float32(0.0), actions)
    if name == "followed":
        return (~is_last[last]).astype(np.float32)
    if name == "successor_known":
        repeats = np.all(dataset.observations[last] == dataset.next_observations[last], axis=1)
        return (~(dataset.terminated[last] & repeats)).astype(np.float32)
    if name == "returns_to_go":
        assert view.discount is not None  # a view insists on it
        scaled = replace(dataset, rewards=_shown_rewards(dataset, view), source="returns_to_go")
        return returns_to_go(scaled, view.discount)[kept]
    return (rows - np.repeat(dataset.episode_starts, dataset.episode_lengths())).astype(np.float32)[kept]


def _shown_rewards(dataset: Dataset, view: View) -> np.ndarray:
    if view.reward_scale == 1.0 and view.reward_shift == 0.0:
        return dataset.rewards  # without a copy
    return (view.reward_scale * (dataset.rewards.astype(np.float64) + view.reward_shift)).astype(np.float32)


def _on_device(column: np.ndarray) -> Array:
    """The column on the device, and not before it has arrived: else the host keeps a copy of every column meanwhile."""
    return jax.block_until_ready(jax.device_put(column))  # `jnp.asarray` would copy it once more on the way


def _n_step(dataset: Dataset, view: View) -> tuple[np.ndarray, np.ndarray | slice, np.ndarray | slice]:
    """(n-step rewards, row that holds the n-step successor, row it belongs to), each [kept rows]."""
    rewards = _shown_rewards(dataset, view)
    if view.return_steps == 1:
        return rewards, slice(None), slice(None)  # all rows, without a copy of them
    assert view.discount is not None  # a view insists on it
    rows = np.arange(len(dataset))
    last, kept = _n_step_rows(dataset, view.return_steps)
    total = np.zeros(len(dataset))
    lengths = dataset.episode_lengths()
    stops = np.repeat(dataset.episode_starts + lengths, lengths)
    for ahead in range(view.return_steps):
        inside = rows + ahead < stops
        total[inside] += view.discount**ahead * rewards[rows[inside] + ahead]
    return total[kept].astype(np.float32), last, kept


def _n_step_rows(dataset: Dataset, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """(row that holds the n-step successor, row it belongs to), each [kept rows]."""
    rows = np.arange(len(dataset))
    lengths = dataset.episode_lengths()
    last = np.minimum(rows + steps, np.repeat(dataset.episode_starts + lengths, lengths)) - 1
    kept = np.flatnonzero((last - rows + 1 == steps) | dataset.terminated[last])
    if len(kept) == 0:
        raise DatasetError(
            f"return_steps={steps}: no episode has so many steps (the longest has {lengths.max()}); choose fewer"
        )
    return last[kept], kept


def padded_columns(columns: Columns, widths: tuple[int, int]) -> Columns:
    """The rows of a data set with zeros behind, up to so many observations and actions (`odaf.data.padding`)."""
    if not isinstance(columns, Transitions):
        return replace(columns, columns=padded_columns(columns.columns, widths))
    states, actions = widths

    def wide(column: Float[Array, "rows width"], width: int) -> Float[Array, "rows {width}"]:
        return jnp.pad(column, ((0, 0), (0, width - column.shape[1])))

    return replace(
        columns,
        observations=wide(columns.observations, states),
        actions=wide(columns.actions, actions),
        next_observations=wide(columns.next_observations, states),
        extras={name: wide(each, actions) if each.ndim > 1 else each for name, each in columns.extras.items()},
    )


def sample(columns: Columns, key: PRNGKeyArray | Array, batch_size: int) -> Transitions:
    """Draws `batch_size` rows with replacement: all alike, by weight, or by part of a mixture (`sample_mixed`).

    Where critics draw apart, these are their rows, those of sampling="uniform", and the actor's are in `actor`.

    Usable inside `jit`, `scan` and `vmap`.

    The rows are a function of `key` alone, so a resumed run that carries its key draws what an unbroken one would.
    """
    if isinstance(columns, MixedColumns):
        return sample_mixed(columns.columns, columns.border, columns.ratio, key, batch_size)
    if isinstance(columns, Slab):  # the same draws as from the set alone
        within, first, count = columns.columns, columns.first, columns.rows
    else:
        within, first, count = columns, 0, columns.rewards.shape[0]

    def alike() -> Int[Array, " batch"]:
        return first + jr.randint(key, (batch_size,), 0, count)

    if isinstance(within, Transitions):
        return _taken(within, alike())
    if not within.apart:
        return _taken(within.columns, _weighted_rows(within, first, count, key, batch_size))
    chosen = _weighted_rows(within, first, count, jr.fold_in(key, _ACTOR), batch_size)
    return replace(_taken(within.columns, alike()), actor=_taken(within.columns, chosen))


def _taken(columns: Transitions, rows: Int[Array, " batch"]) -> Transitions:
    return jax.tree.map(lambda column: column[rows], columns)


def _weighted_rows(
    table: WeightedColumns, first: Array | int, count: Array | int, key: PRNGKeyArray | Array, batch_size: int
) -> Int[Array, " batch"]:
    """Rows of the set of `count` rows from `first` on: a cell of the table, then the row it keeps or its alias."""
    key_cell, key_part = jr.split(key)
    cells = first + jr.randint(key_cell, (batch_size,), 0, count)
    part = jr.bits(key_part, (batch_size,), jnp.uint32)
    return jnp.where(part < table.kept[cells], cells, first + table.alias[cells])
