"""Pre-training of a dynamics model, with its error on episodes it never saw."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.dynamics.base import DynamicsConfig, DynamicsModel
from odaf.components.dynamics.build import untrained
from odaf.components.fitting import Fitted, Progress, bootstrap_rows, fit, of_rows
from odaf.components.pretraining import Rows, SplitRows, split_columns
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser


def fit_dynamics(
    config: DynamicsConfig,
    dataset: Dataset,
    normaliser: Normaliser,
    key: PRNGKeyArray,
    progress: Progress,
    *,
    use: str = "the outcome term judges states the system would not reach",
    remedy: str = "leave out the outcome term (outcome.weight=0)",
    field: str = "dynamics",
    sees_actions: bool = True,
) -> tuple[DynamicsModel, dict[str, Any]]:
    """Train a model on most episodes and measure it on the rest.

    Args:
        config: kind, sizes and training of the model.
        dataset: the log; whole episodes go to one side.
        normaliser: observation scaling of the learner that will use the model.
        key: random key for the split, the initial networks and the batches.
        progress: called with (steps done, steps in all) after every stretch.
        use: what a model that knows nothing does to the learner, for the warning.
        remedy: how to do without a model, for error messages.
        field: where the learner or the term holds the model's settings, for the same messages.
        sees_actions: False fits a model of what follows a state whatever the action, whose actions have no dimensions.

    Returns:
        The frozen model, and a report: mean squared hold-out error in normalised units (over all dimensions and by
        dimension), the error of predicting "no change", and a warning if the model is not better than that.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows whose successor is known.
    """
    key_split, key_init, key_bootstrap, key_train = jr.split(key, 4)
    rows = split_columns(dataset, normaliser, config.holdout, key_split, f"{field} model", remedy)
    if not sees_actions:
        states, actions, next_states = rows.columns
        rows = dataclasses.replace(rows, columns=(states, actions[:, :0], next_states))
    model = untrained(config, key_init, dataset.obs_dim, rows.columns[1].shape[1], members=config.members)
    model = _with_output_scaling(model, rows)
    table, members = None, model.bootstraps
    if members is not None:
        table = bootstrap_rows(key_bootstrap, members, rows.train, rows.total)
    fitted = fit(
        model,
        _loss,
        rows.columns,
        rows=rows.train,
        bootstraps=table,
        members=members,
        trainable=_trainable(model),
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        schedule=config.schedule,
        stopping=rows.stopping(_mean_error, config.patience),
        key=key_train,
        progress=progress,
        what=f"{field} model ({config.kind})",
        remedy=f"lower {field}.learning_rate or check the log for outliers with `odaf data info`",
    )
    errors = of_rows(_errors, fitted.model, rows.columns, rows.train).mean(axis=0)
    model = fitted.model.finished(errors, config.elites)
    return model, _report(config, model, rows, fitted, use, field)


def _loss(model: DynamicsModel, batch: Rows, key: PRNGKeyArray) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    return model.loss(*batch, key), {}


def _errors(model: DynamicsModel, batch: Rows) -> Float[Array, "rows members"]:
    return model.errors(*batch)


def _mean_error(model: DynamicsModel, batch: Rows) -> Float[Array, " rows"]:
    return jnp.mean(model.errors(*batch), axis=1)


def _expected(model: DynamicsModel, batch: Rows) -> Float[Array, "rows obs_dim"]:
    return model.expected(batch[0], batch[1])


def _with_output_scaling(model: DynamicsModel, rows: SplitRows) -> DynamicsModel:
    """Set shift and scale to the mean and spread of the changes; absolute models keep raw outputs."""
    if not model.residual:
        return model
    states, _, next_states = rows.columns
    shift, scale = _change(states, next_states, jnp.asarray(rows.train))
    return eqx.tree_at(lambda m: (m.shift, m.scale), model, (shift, scale))


@jax.jit
def _change(
    states: Float[Array, "rows obs_dim"], next_states: Float[Array, "rows obs_dim"], count: Int[Array, ""]
) -> tuple[Float[Array, " obs_dim"], Float[Array, " obs_dim"]]:
    """Mean and standard deviation of the changes in the first `count` rows, whose number is no shape of the program."""
    counted = (jnp.arange(states.shape[0]) < count)[:, None]
    number = count.astype(states.dtype)
    change = next_states - states
    mean = jnp.sum(jnp.where(counted, change, 0.0), axis=0) * (1.0 / number)  # rounds as `jnp.mean` of these rows does
    variance = jnp.sum(jnp.where(counted, jnp.square(change - mean[None]), 0.0), axis=0) / number
    return mean, jnp.maximum(jnp.sqrt(variance), 1e-6)


def _trainable(model: DynamicsModel) -> DynamicsModel:
    """Which leaves training moves: the parameters, not the fixed scaling."""
    mask = jax.tree.map(eqx.is_inexact_array, model)
    return eqx.tree_at(lambda m: (m.shift, m.scale), mask, (False, False))


def _report(
    config: DynamicsConfig,
    model: DynamicsModel,
    rows: SplitRows,
    fitted: Fitted[DynamicsModel],
    use: str,
    field: str,
) -> dict[str, Any]:
    observations, _, next_observations = rows.measured()
    predicted = of_rows(_expected, model, rows.columns, rows.train, rows.last_measured)
    by_dimension = np.mean(np.square(predicted - next_observations), axis=0)
    unchanged = np.mean(np.square(observations - next_observations), axis=0)
    error, naive = float(by_dimension.mean()), float(unchanged.mean())
    report: dict[str, Any] = {
        "kind": config.kind,
        "steps": fitted.steps,
        "training_loss": fitted.means["loss"],
        "holdout_rows": len(observations),
        "holdout_mse": error,
        "holdout_mse_by_dimension": [float(v) for v in by_dimension],
        "no_change_mse": naive,
        "no_change_mse_by_dimension": [float(v) for v in unchanged],
        "error_ratio": error / naive if naive > 0 else float("inf"),
        "warnings": [],
    }
    if not error < naive:
        report["warnings"].append(
            f"{field} model ({config.kind}): its hold-out error {error:.3g} is no better than predicting 'no change' "
            f"({naive:.3g}), so {use}; train it longer ({field}.steps) or use {field}.residual=True"
        )
    return report
