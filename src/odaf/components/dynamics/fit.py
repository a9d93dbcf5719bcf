"""Pre-training of a dynamics model, with its error on episodes it never saw."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import PRNGKeyArray

from odaf.components.dynamics.base import DynamicsConfig, DynamicsModel
from odaf.components.dynamics.build import untrained
from odaf.components.pretraining import Progress, minimise, normalised_rows, split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser

HOLDOUT_ROWS = 20_000


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
    train, holdout = split_rows(
        dataset, config.holdout, key_split, "dynamics model", "leave out the outcome term (outcome.weight=0)"
    )
    rows = normalised_rows(dataset, normaliser, train)
    check = normalised_rows(dataset, normaliser, holdout)

    model = untrained(config, key_init, dataset.obs_dim, dataset.act_dim, members=config.members)
    model = _with_output_scaling(model, rows)
    table = None
    if model.bootstraps is not None:  # each member's sample with replacement, drawn once
        table = jr.randint(key_bootstrap, (model.bootstraps, len(train)), 0, len(train))
    model, training_loss = minimise(
        model,
        lambda model, batch, key: model.loss(*batch, key),
        rows,
        trainable=_trainable(model),
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        schedule=config.schedule,
        key=key_train,
        progress=progress,
        what=f"dynamics model ({config.kind})",
        remedy="lower dynamics.learning_rate or check the log for outliers with `odaf data info`",
        bootstraps=table,
    )
    model = model.finished(*check, config.elites)
    return model, _report(config, model, check, training_loss)


def _with_output_scaling(model: DynamicsModel, rows) -> DynamicsModel:
    """Set shift and scale to the mean and spread of the changes; absolute models keep raw outputs."""
    if not model.residual:
        return model
    change = rows[2] - rows[0]
    spread = jnp.maximum(jnp.std(change, axis=0), 1e-6)
    return eqx.tree_at(lambda m: (m.shift, m.scale), model, (jnp.mean(change, axis=0), spread))


def _trainable(model: DynamicsModel) -> DynamicsModel:
    """Which leaves training moves: the parameters, not the fixed scaling."""
    mask = jax.tree.map(eqx.is_inexact_array, model)
    return eqx.tree_at(lambda m: (m.shift, m.scale), mask, (False, False))


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
