"""Pre-training of a dynamics model, with its error on episodes it never saw."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, PRNGKeyArray

from odaf.components.dynamics.base import DynamicsConfig, DynamicsModel
from odaf.components.dynamics.build import untrained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError, DivergenceError

STRETCH = 1_000
HOLDOUT_ROWS = 20_000

Progress = Callable[[int, int], None]


def fit_dynamics(
    config: DynamicsConfig, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: Progress
) -> tuple[DynamicsModel, dict[str, Any]]:
    """Train a model on most episodes and measure it on the rest.

    Args:
        config: kind, sizes and training of the model.
        dataset: the log; whole episodes go to one side.
        normaliser: observation scaling of the learner that will use the model.
        key: random key for the split, the initial networks and the batches.
        progress: called with (steps done, steps in all) after every stretch.

    Returns:
        The frozen model, and a report: mean squared hold-out error in normalised units (over all dimensions and by
        dimension), the error of predicting "no change", and a warning if the model is not better than that.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows whose successor is known.
    """
    key_split, key_init, key_bootstrap, key_train = jr.split(key, 4)
    train, holdout = _split_rows(dataset, config.holdout, key_split)
    rows = _normalised_rows(dataset, normaliser, train)
    check = _normalised_rows(dataset, normaliser, holdout)

    model = untrained(config, key_init, dataset.obs_dim, dataset.act_dim, members=config.members)
    model = _with_output_scaling(model, rows)
    table = None
    if model.bootstraps is not None:  # each member's sample with replacement, drawn once
        table = jr.randint(key_bootstrap, (model.bootstraps, len(train)), 0, len(train))

    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.steps)
        if config.schedule == "cosine"
        else (config.learning_rate)
    )
    optimiser = optax.adam(rate)
    moments = optimiser.init(_trainable(model)[0])

    @eqx.filter_jit(donate="all-except-first")
    def stretch(data, model, moments, steps) -> Any:
        def step(carry, index):
            model, moments = carry
            key_draw, key_loss = jr.split(jr.fold_in(key_train, index))
            shape = (config.batch_size,) if table is None else (table.shape[0], config.batch_size)
            picked = jr.randint(key_draw, shape, 0, data[0].shape[0])
            if table is not None:
                picked = jnp.take_along_axis(table, picked, axis=1)
            batch = tuple(column[picked] for column in data)
            parameters, rest = _trainable(model)
            value, gradient = jax.value_and_grad(lambda p: eqx.combine(p, rest).loss(*batch, key_loss))(parameters)
            updates, moments = optimiser.update(gradient, moments, parameters)
            return (eqx.combine(optax.apply_updates(parameters, updates), rest), moments), value

        return jax.lax.scan(step, (model, moments), steps)

    done, training_loss = 0, float("nan")
    while done < config.steps:
        count = min(STRETCH, config.steps - done)
        (model, moments), losses = stretch(rows, model, moments, jnp.arange(done, done + count))
        done += count
        training_loss = float(jnp.mean(losses))
        if not np.isfinite(float(losses[-1])):
            raise DivergenceError(
                f"dynamics model ({config.kind}): the training loss is not finite after {done} steps; "
                "lower dynamics.learning_rate or check the log for outliers with `odaf data info`"
            )
        progress(done, config.steps)

    model = model.finished(*check, config.elites)
    return model, _report(config, model, check, training_loss)


def _split_rows(dataset: Dataset, share: float, key: PRNGKeyArray) -> tuple[np.ndarray, np.ndarray]:
    """Row indices of the training and hold-out episodes, at least one on each side; a single episode is cut in time."""
    # a terminated row without a recorded successor repeats its own state; it would teach "no change"
    known = ~(dataset.terminated & np.all(dataset.observations == dataset.next_observations, axis=1))
    rows_by_episode = np.split(np.arange(len(dataset)), dataset.episode_starts[1:])
    usable = [rows[known[rows]] for rows in rows_by_episode if np.any(known[rows])]
    if sum(len(rows) for rows in usable) < 2:
        raise DatasetError(
            f"dynamics model: of {len(dataset):,} rows {int(known.sum())} have a logged successor; at least 2 must; "
            "log the state after each action (next_observations), or leave out the outcome term (outcome.weight=0)"
        )
    if len(usable) == 1:
        rows = usable[0]
        cut = min(max(1, int(len(rows) * (1.0 - share))), len(rows) - 1)
        return rows[:cut], rows[cut:]
    order = np.asarray(jr.permutation(key, len(usable)))
    count = min(max(1, round(share * len(usable))), len(usable) - 1)
    train, holdout = ([usable[index] for index in np.sort(side)] for side in (order[count:], order[:count]))
    return np.concatenate(train), np.concatenate(holdout)


def _normalised_rows(dataset: Dataset, normaliser: Normaliser, rows: np.ndarray) -> tuple[Array, Array, Array]:
    low, high = dataset.action_low, dataset.action_high
    actions = 2.0 * (dataset.actions[rows] - low) / (high - low) - 1.0
    return (
        jnp.asarray(normaliser.normalise(dataset.observations[rows]), dtype=jnp.float32),
        jnp.asarray(actions, dtype=jnp.float32),
        jnp.asarray(normaliser.normalise(dataset.next_observations[rows]), dtype=jnp.float32),
    )


def _with_output_scaling(model: DynamicsModel, rows) -> DynamicsModel:
    """Set shift and scale to the mean and spread of the changes; absolute models keep raw outputs."""
    if not model.residual:
        return model
    change = rows[2] - rows[0]
    spread = jnp.maximum(jnp.std(change, axis=0), 1e-6)
    return eqx.tree_at(lambda m: (m.shift, m.scale), model, (jnp.mean(change, axis=0), spread))


def _trainable(model: DynamicsModel):
    """Parameters on one side, the fixed scaling on the other."""
    mask = jax.tree.map(eqx.is_inexact_array, model)
    mask = eqx.tree_at(lambda m: (m.shift, m.scale), mask, (False, False))
    return eqx.partition(model, mask)


def _report(config: DynamicsConfig, model: DynamicsModel, check, training_loss: float) -> dict[str, Any]:
    observations, actions, next_observations = (column[:HOLDOUT_ROWS] for column in check)
    predicted = eqx.filter_jit(lambda m, s, a: m.expected(s, a))(model, observations, actions)
    by_dimension = np.mean(np.square(np.asarray(predicted - next_observations)), axis=0)
    unchanged = np.mean(np.square(np.asarray(observations - next_observations)), axis=0)
    error, naive = float(by_dimension.mean()), float(unchanged.mean())
    report: dict[str, Any] = {
        "kind": config.kind,
        "training_loss": training_loss,
        "holdout_rows": int(observations.shape[0]),
        "holdout_mse": error,
        "holdout_mse_by_dimension": [float(v) for v in by_dimension],
        "no_change_mse": naive,
        "no_change_mse_by_dimension": [float(v) for v in unchanged],
        "error_ratio": error / naive if naive > 0 else float("inf"),
        "warnings": [],
    }
    if not error < naive:
        report["warnings"].append(
            f"dynamics model ({config.kind}): its hold-out error {error:.3g} is no better than predicting 'no change' "
            f"({naive:.3g}), so the outcome term judges states the system would not reach; train it longer "
            "(dynamics.steps) or use dynamics.residual=True"
        )
    return report
