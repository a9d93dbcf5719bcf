"""The inverse-dynamics model of OSR: which action leads from a state to a next state, a ~ I(a | s, s').

    z ~ q(z | s, s'),   u ~ N(mean, std^2) with (mean, out) = decoder(s, s', z),   log std = c out + b
    loss = mean ( tanh(u) - a )^2 + 0.5 KL( q || N(0, 1) ),   both means over rows and dimensions

u is a re-parameterised draw, and the squared error of a draw grows with its spread: whatever the log holds, training
presses the standard deviation towards zero. It says nothing about how sure the action is, and only `log_std_min` stops
it. docs/algorithms/osr.md has the figures, the source and what is different here.
"""

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.distributions import gaussian_divergence
from odaf.components.networks import MLP, init_mlp
from odaf.components.pretraining import Progress, Rows, minimise, normalised_rows, split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

KL_WEIGHT = 0.5
PRIOR_CLIP = 0.5
ACTION_CLIP = 0.999
LOG_STD_MAX = 2.0
HOLDOUT_ROWS = 20_000


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

    def __post_init__(self) -> None:
        for field in ("latent_dim", "steps", "batch_size"):
            if getattr(self, field) < 1:
                raise ConfigError(f"model.{field}={getattr(self, field)} must be at least 1")
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

    network: MLP  # the decoder
    encoder: MLP
    log_std_scale: Float[Array, ""]  # c
    log_std_offset: Float[Array, ""]  # b
    log_std_min: float = eqx.field(static=True)
    encode_target: bool = eqx.field(static=True)

    @property
    def latent_dim(self) -> int:
        """Width of z."""
        return self.encoder.weights[-1].shape[-1] // 2

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> Float[Array, "rows latent_dim"]:
        """Standard normal noise for z."""
        return jr.normal(key, (rows, self.latent_dim))

    def parameters(
        self,
        observations: Float[Array, "rows obs_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        noise: Float[Array, "rows latent_dim"],
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation of the action before the tanh, for one z a row."""
        pair = jnp.concatenate([observations, next_observations], axis=-1)
        if self.encode_target:
            return self._decode(pair, jnp.clip(noise, -PRIOR_CLIP, PRIOR_CLIP))
        mean, log_std = jnp.split(self.encoder(pair), 2, axis=-1)
        return self._decode(pair, mean + jnp.exp(log_std) * noise)

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
        condition = jnp.concatenate([pair, actions], axis=-1) if self.encode_target else pair
        latent_mean, latent_log_std = jnp.split(self.encoder(condition), 2, axis=-1)
        latent = latent_mean + jnp.exp(latent_log_std) * jr.normal(key_latent, latent_mean.shape)
        mean, log_std = self._decode(pair, latent)
        drawn = jnp.tanh(mean + jnp.exp(log_std) * jr.normal(key_action, mean.shape))
        origin = jnp.zeros_like(latent_mean)
        divergence = jnp.mean(gaussian_divergence(latent_mean, latent_log_std, origin, origin))
        return jnp.mean(jnp.square(drawn - actions)) + KL_WEIGHT * divergence

    def _decode(
        self, pair: Float[Array, "rows two_obs_dim"], latent: Float[Array, "rows latent_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        mean, output = jnp.split(self.network(jnp.concatenate([pair, latent], axis=-1)), 2, axis=-1)
        log_std = self.log_std_scale * output + self.log_std_offset
        return mean, jnp.clip(log_std, self.log_std_min, LOG_STD_MAX)


def untrained_inverse(config: InverseDynamicsConfig, key: PRNGKeyArray, obs_dim: int, act_dim: int) -> InverseDynamics:
    """Draw the networks of a model; c starts at 1 and b at -1."""
    key_encoder, key_decoder = jr.split(key)
    hidden, pair = config.hidden_sizes, 2 * obs_dim
    condition = pair + (act_dim if config.encode_target else 0)
    encoder = init_mlp(key_encoder, (condition, *hidden, hidden[-1], 2 * config.latent_dim), hidden_bias=0.0)
    decoder = init_mlp(key_decoder, (pair + config.latent_dim, *hidden, 2 * act_dim), hidden_bias=0.0)
    return InverseDynamics(
        network=decoder,
        encoder=encoder,
        log_std_scale=jnp.asarray(1.0),
        log_std_offset=jnp.asarray(-1.0),
        log_std_min=config.log_std_min,
        encode_target=config.encode_target,
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
    train, holdout = split_rows(dataset, config.holdout, key_split, what, f"leave out the term ({term}.weight=0)")
    rows = normalised_rows(dataset, normaliser, train)
    model = untrained_inverse(config, key_init, dataset.obs_dim, dataset.act_dim)
    model, training_loss = minimise(
        model,
        lambda model, batch, key: model.loss(*batch, key),
        rows,
        trainable=jax.tree.map(eqx.is_inexact_array, model),
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        schedule=config.schedule,
        key=key_train,
        progress=progress,
        what=what,
        remedy=f"lower {term}.model.learning_rate or check the log for outliers with `odaf data info`",
    )
    check = normalised_rows(dataset, normaliser, holdout[:HOLDOUT_ROWS])
    return model, _report(model, check, np.asarray(rows[1]).mean(axis=0), training_loss, term)


def _report(
    model: InverseDynamics, check: Rows, mean_action: np.ndarray, training_loss: float, term: str
) -> dict[str, Any]:
    observations, actions, next_observations = check
    centre = jnp.zeros((len(observations), model.latent_dim))
    mean, log_std = eqx.filter_jit(lambda m: m.parameters(observations, next_observations, centre))(model)
    by_dimension = np.mean(np.square(np.tanh(np.asarray(mean)) - np.asarray(actions)), axis=0)
    error = float(by_dimension.mean())
    naive = float(np.mean(np.square(mean_action - np.asarray(actions))))
    report: dict[str, Any] = {
        "training_loss": training_loss,
        "holdout_rows": len(observations),
        "holdout_mse": error,
        "holdout_mse_by_dimension": [float(v) for v in by_dimension],
        "mean_action_mse": naive,
        "error_ratio": error / naive if naive > 0 else float("inf"),
        "mean_log_std": float(np.mean(np.asarray(log_std))),
        "warnings": [],
    }
    if not error < naive:
        report["warnings"].append(
            f"inverse-dynamics model: its hold-out error {error:.3g} is no better than always giving the mean action "
            f"({naive:.3g}), so the term {term} teaches actions that do not lead where they should; train it longer "
            f"({term}.model.steps)"
        )
    return report
