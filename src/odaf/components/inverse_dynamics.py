"""The inverse-dynamics model of OSR: which action leads from a state to a next state, a ~ I(a | s, s').

    z ~ q(z | s, s'),   u ~ N(mean, std^2) with (mean, out) = decoder(s, s', z),   log std = c out + b
    loss = mean ( tanh(u) - a )^2 + 0.5 KL( q || N(0, 1) ),   both means over rows and dimensions

u is a re-parameterised draw, and the squared error of a draw grows with its spread: whatever the log holds, training
presses the standard deviation towards zero. It says nothing about how sure the action is, and only `log_std_min` stops
it. docs/reference/algorithms/osr.md has the figures, the source and what is different here.
"""

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.cvae import CVAE, KL_WEIGHT, init_cvae, latent_divergence
from odaf.components.fitting import Fitted, Progress, fit, of_rows
from odaf.components.pretraining import Rows, SplitRows, split_columns
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

ACTION_CLIP = 0.999
LOG_STD_MAX = 2.0


@dataclasses.dataclass(frozen=True)
class InverseDynamicsConfig:
    """Sizes and pre-training of the inverse-dynamics model."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the decoder's hidden layers; the encoder has one layer more."""
    latent_dim: int = 32
    """Width of the latent variable z."""
    encode_target: bool = False
    """The encoder sees the action too while training, and z comes from the clipped prior afterwards: a true
    conditional auto-encoder. False is the published form, whose z is noise that depends on (s, s')."""
    log_std_min: float = -1.0
    """Lower end of the log standard deviation before the tanh. Training presses it down to there (see above), and the
    lower it is the harder a policy is pulled: a divergence from this model grows with exp(-2 log_std_min) / 2."""
    steps: int = 7_812
    """Gradient steps before the policy is trained; the model is frozen afterwards."""
    batch_size: int = 256
    """Rows a gradient step."""
    learning_rate: float = 1e-4
    """Step size of Adam."""
    schedule: Literal["cosine", "constant"] = "constant"
    """Course of the learning rate: down to zero over the steps, or constant."""
    holdout: float = 0.05
    """Share of the episodes kept out of training to measure the error on."""
    patience: int | None = None
    """Stop after so many checks of that error, one every 1,000 steps, without a new lowest one, and keep the model that
    had it; None trains for all steps and keeps the last."""

    def __post_init__(self) -> None:
        for field in ("latent_dim", "steps", "batch_size", "patience"):
            count = getattr(self, field)
            if count is not None and count < 1:
                raise ConfigError(f"model.{field}={count} must be at least 1")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"model.hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if self.log_std_min >= LOG_STD_MAX:
            raise ConfigError(f"model.log_std_min={self.log_std_min} must be below {LOG_STD_MAX}, the upper end")
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(
                f"model.holdout={self.holdout} must lie between 0 and 1: without episodes to check on, "
                "nobody knows whether the model is better than none"
            )


class InverseDynamics(eqx.Module):
    """I(a | s, s') as a Gaussian before the tanh, given noise for z."""

    cvae: CVAE  # of (s, s'); its target is a
    log_std_scale: Float[Array, ""]  # c
    log_std_offset: Float[Array, ""]  # b
    log_std_min: float = eqx.field(static=True)

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> Float[Array, "rows latent_dim"]:
        """Standard normal noise for z."""
        return self.cvae.draw_noise(key, rows)

    def parameters(
        self,
        observations: Float[Array, "rows obs_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        noise: Float[Array, "rows latent_dim"],
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation of the action before the tanh, for one z a row."""
        pair = jnp.concatenate([observations, next_observations], axis=-1)
        return self._gaussian(self.cvae.decode(pair, self.cvae.latent_for(pair, noise)))

    def loss(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Squared error of a drawn action + 0.5 KL(q || N(0, 1)); logged actions are cut at +-0.999."""
        key_latent, key_action = jr.split(key)
        pair = jnp.concatenate([observations, next_observations], axis=-1)
        actions = jnp.clip(actions, -ACTION_CLIP, ACTION_CLIP)
        normal = self.draw_noise(key_latent, observations.shape[0])
        output, latent_mean, latent_log_std = self.cvae.reconstruct(pair, actions, normal)
        mean, log_std = self._gaussian(output)
        drawn = jnp.tanh(mean + jnp.exp(log_std) * jr.normal(key_action, mean.shape))
        divergence = jnp.mean(latent_divergence(latent_mean, latent_log_std))
        return jnp.mean(jnp.square(drawn - actions)) + KL_WEIGHT * divergence

    def central(
        self, observations: Float[Array, "rows obs_dim"], next_observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """`parameters` for the central z."""
        return self.parameters(
            observations, next_observations, jnp.zeros((observations.shape[0], self.cvae.latent_dim))
        )

    def _gaussian(
        self, output: Float[Array, "rows two_act_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        mean, output = jnp.split(output, 2, axis=-1)
        log_std = self.log_std_scale * output + self.log_std_offset
        return mean, jnp.clip(log_std, self.log_std_min, LOG_STD_MAX)


def untrained_inverse(config: InverseDynamicsConfig, key: PRNGKeyArray, obs_dim: int, act_dim: int) -> InverseDynamics:
    """Draw the networks of a model; c starts at 1 and b at -1."""
    hidden = config.hidden_sizes
    cvae = init_cvae(
        key,
        condition_dim=2 * obs_dim,
        target_dim=act_dim,
        output_dim=2 * act_dim,
        latent_dim=config.latent_dim,
        encoder_sizes=(*hidden, hidden[-1]),
        decoder_sizes=hidden,
        sees_target=config.encode_target,
    )
    return InverseDynamics(
        cvae=cvae,
        log_std_scale=jnp.asarray(1.0),
        log_std_offset=jnp.asarray(-1.0),
        log_std_min=config.log_std_min,
    )


def fit_inverse(
    config: InverseDynamicsConfig,
    dataset: Dataset,
    normaliser: Normaliser,
    key: PRNGKeyArray,
    progress: Progress,
    term: str,
) -> tuple[InverseDynamics, dict[str, Any]]:
    """Train a model on most episodes and measure it on the rest.

    Args:
        config: sizes and training of the model.
        dataset: the log; whole episodes go to one side, rows without a recorded successor to none.
        normaliser: observation scaling of the learner that will use the model.
        key: random key for the split, the initial networks and the batches.
        progress: called with (steps done, steps in all) after every stretch.
        term: the term that will use the model, named in messages.

    Returns:
        The frozen model, and a report: mean squared hold-out error of the central action in [-1, 1], the error of
        always giving the mean action, the mean log standard deviation, and a warning if the first is not the smaller.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows whose successor is known.
    """
    key_split, key_init, key_train = jr.split(key, 3)
    what = "inverse-dynamics model"
    rows = split_columns(dataset, normaliser, config.holdout, key_split, what, f"leave out the term ({term}.weight=0)")
    fitted = fit(
        untrained_inverse(config, key_init, dataset.obs_dim, dataset.act_dim),
        _loss,
        rows.columns,
        rows=rows.train,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        schedule=config.schedule,
        stopping=rows.stopping(_errors, config.patience),
        key=key_train,
        progress=progress,
        what=what,
        remedy=f"lower {term}.model.learning_rate or check the log for outliers with `odaf data info`",
    )
    return fitted.model, _report(fitted, rows, term)


def _loss(
    model: InverseDynamics, batch: Rows, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    return model.loss(*batch, key), {}


def _central(model: InverseDynamics, batch: Rows) -> Float[Array, "rows two act_dim"]:
    return jnp.stack(model.central(batch[0], batch[2]), axis=1)


def _errors(model: InverseDynamics, batch: Rows) -> Float[Array, " rows"]:
    """Mean squared error of the central action of every row."""
    mean, _ = model.central(batch[0], batch[2])
    return jnp.mean(jnp.square(jnp.tanh(mean) - batch[1]), axis=-1)


def _report(fitted: Fitted[InverseDynamics], rows: SplitRows, term: str) -> dict[str, Any]:
    _, actions, _ = rows.measured()
    central = of_rows(_central, fitted.model, rows.columns, rows.train, rows.last_measured)
    by_dimension = np.mean(np.square(np.tanh(central[:, 0]) - actions), axis=0)
    error = float(by_dimension.mean())
    naive = float(np.mean(np.square(rows.training()[1].mean(axis=0) - actions)))
    report: dict[str, Any] = {
        "steps": fitted.steps,
        "training_loss": fitted.means["loss"],
        "holdout_rows": len(actions),
        "holdout_mse": error,
        "holdout_mse_by_dimension": [float(v) for v in by_dimension],
        "mean_action_mse": naive,
        "error_ratio": error / naive if naive > 0 else float("inf"),
        "mean_log_std": float(np.mean(central[:, 1])),
        "warnings": [],
    }
    if not error < naive:
        report["warnings"].append(
            f"inverse-dynamics model: its hold-out error {error:.3g} is no better than always giving the mean action "
            f"({naive:.3g}), so the term {term} teaches actions that do not lead where they should; train it longer "
            f"({term}.model.steps)"
        )
    return report
