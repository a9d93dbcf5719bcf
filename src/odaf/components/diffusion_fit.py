"""Training an `ActionDiffusion` on a log, with its error on episodes that it never saw."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.diffusion import ActionDiffusion, init_action_diffusion
from odaf.components.fitting import Progress, fit, of_rows
from odaf.components.pretraining import HOLDOUT_ROWS, normalised_rows, split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.row_choice import has_table
from odaf.data.sampling import row_weights
from odaf.data.view import View
from odaf.errors import ConfigError

NO_MODEL = 1.0  # the mean squared error of saying that there is no noise


@dataclasses.dataclass(frozen=True)
class DiffusionConfig:
    """Sizes and training of the model of whoever acted in the log."""

    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of its hidden layers."""
    diffusion_steps: int = 10
    """Steps in which noise becomes an action."""
    steps: int = 39_000
    """Gradient steps before rollouts begin; the model is frozen afterwards."""
    batch_size: int = 256
    """Rows a gradient step."""
    learning_rate: float = 1e-4
    """Step size of AdamW at the start; it falls to 0 along a cosine, a little at each step."""
    weight_decay: float = 1e-6
    """Share of the weights, times the step size, that each step takes away."""
    holdout: float = 0.05
    """Share of the episodes kept out of training to measure the error on."""

    def __post_init__(self) -> None:
        for field in ("diffusion_steps", "steps", "batch_size"):
            if getattr(self, field) < 1:
                raise ConfigError(f"behaviour.{field}={getattr(self, field)} must be at least 1")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"behaviour.hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if self.weight_decay < 0.0:
            raise ConfigError(f"behaviour.weight_decay={self.weight_decay} must not be negative")
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(
                f"behaviour.holdout={self.holdout} must lie between 0 and 1: without episodes to check on, "
                "nobody knows whether the model is better than none"
            )


def fit_action_diffusion(
    config: DiffusionConfig,
    dataset: Dataset,
    normaliser: Normaliser,
    view: View,
    key: PRNGKeyArray,
    progress: Progress,
) -> tuple[ActionDiffusion, dict[str, Any]]:
    """Train the model on most episodes and measure it on the rest.

    Args:
        config: sizes and training.
        dataset: the episodes that are learned from; whole ones go to one side.
        normaliser: observation scaling of the learner.
        view: of the learner; where its rows are drawn by weight, so are those that the model learns from.
        key: random key for the split, the initial network and the batches.
        progress: called with (steps done, steps in all) after every stretch.

    Returns:
        The model with averaged weights, and a report: its mean squared error of noise in held-out actions, 1 for a
        model that says nothing, and a warning if it is no better than that.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows.
    """
    key_split, key_rows, key_init, key_fit, key_error = jr.split(key, 5)
    what = "behaviour model"
    remedy = "take a learner that needs no model of the log, such as td3-bc"
    train, holdout = split_rows(dataset, config.holdout, key_split, what, remedy, needs_successors=False)
    if has_table(view.choice):
        train = _by_weight(train, row_weights(dataset, view)[train], key_rows)
    columns = normalised_rows(dataset, normaliser, np.concatenate([train, holdout]))[:2]
    fitted = fit(
        init_action_diffusion(key_init, dataset.obs_dim, dataset.act_dim, config.hidden_sizes, config.diffusion_steps),
        _loss,
        columns,
        rows=len(train),
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        schedule="cosine",
        weight_decay=config.weight_decay,
        averages=True,
        key=key_fit,
        progress=progress,
        what=what,
        remedy="lower behaviour.learning_rate or check the log for outliers with `odaf data info`",
    )
    measured = tuple(column[len(train) : len(train) + HOLDOUT_ROWS] for column in columns)
    drawn = fitted.model.draw(key_error, len(measured[0]), dataset.act_dim)
    error = float(np.mean(of_rows(_errors, fitted.model, (*measured, *drawn))))
    report: dict[str, Any] = {
        "steps": fitted.steps,
        "training_loss": fitted.means["loss"],
        "holdout_rows": len(measured[0]),
        "holdout_error": error,
        "warnings": [],
    }
    if not error < NO_MODEL:
        report["warnings"].append(
            f"behaviour model: its hold-out error {error:.3g} is no better than saying nothing (1), so rollouts do not "
            "act as the log does; train it longer (behaviour.steps)"
        )
    return fitted.model, report


def _by_weight(rows: np.ndarray, weights: np.ndarray, key: PRNGKeyArray) -> np.ndarray:
    """As many rows, each as often as its weight says, to within one; where in between the rounding falls is random."""
    ends = np.cumsum(weights / weights.sum())
    places = (np.arange(len(rows)) + float(jr.uniform(key))) / len(rows)
    return rows[np.minimum(np.searchsorted(ends, places), len(rows) - 1)]


def _loss(
    model: ActionDiffusion, batch: tuple[Array, Array], key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    observations, actions = batch
    return jnp.mean(model.misfit(observations, actions, *model.draw(key, *actions.shape))), {}


def _errors(model: ActionDiffusion, batch: tuple[Array, Array, Array, Array]) -> Float[Array, " rows"]:
    return model.misfit(*batch)
