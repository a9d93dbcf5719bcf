"""Models of whoever acted in the log, pi_b(a|s): a conditional auto-encoder of actions, a clone, and a Gaussian.

    z ~ q(z | s, a) = N(mean, std^2),   a^ = tanh( decoder(s, z) )
    l(s, a) = mean_dims ( a^ - a )^2 + 0.5 mean_dims KL( q(. | s, a) || N(0, 1) )
    L = mean_B l

(Fujimoto et al. 2019, BCQ.) Both parts are means, over action dimensions and over latent ones. l of any action, logged
or not, is up to scale and offset a bound on - log pi_b(a|s): the decoder's standard deviation is sqrt(1/8) for every
sample of z (Wu et al. 2022, SPOT). The auto-encoder can be trained beside a learner by `BehaviourCVAE.loss`, or
beforehand by `fit_behaviour_cvae`.

The clone is mu_b(s) = tanh(MLP(s)), with L = mean_{B, dims} ( mu_b(s) - a )^2.

The Gaussian is squashed by a tanh, its standard deviation in [e^-5, 1], with L = mean_B ( alpha log pi_b(a~|s) - log
pi_b(a|s) ), a~ ~ pi_b(.|s), logged actions cut to +-0.999 (Wu et al. 2019, BRAC). alpha >= 0 steers the entropy to
minus the number of action dimensions.
"""

import dataclasses
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.cvae import CVAE, KL_WEIGHT, init_cvae, latent_divergence
from odaf.components.distributions import exact_tanh_gaussian_log_density
from odaf.components.fitting import Loss, OfRows, Progress, fit, of_rows
from odaf.components.networks import init_mlp
from odaf.components.policies import DeterministicActor, NarrowGaussianActor, init_deterministic_actor
from odaf.components.pretraining import Rows, split_columns
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

LATENTS_PER_ACTION = 2
LOG_STD_RANGE = (-4.0, 15.0)  # of q
LARGEST_ACTION = 1.0 - 1e-3  # what the Gaussian is asked for: the density of +-1 itself is infinite

Model = TypeVar("Model")


@dataclasses.dataclass(frozen=True)
class BehaviourConfig:
    """Sizes and pre-training of a model of whoever acted in the log."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of its hidden layers."""
    steps: int = 100_000
    """Gradient steps before the policy is trained; the model is frozen afterwards."""
    batch_size: int = 256
    """Rows a gradient step."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    holdout: float = 0.05
    """Share of the episodes kept out of training to measure the error on."""

    def __post_init__(self) -> None:
        for field in ("steps", "batch_size"):
            if getattr(self, field) < 1:
                raise ConfigError(f"behaviour.{field}={getattr(self, field)} must be at least 1")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"behaviour.hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(
                f"behaviour.holdout={self.holdout} must lie between 0 and 1: without episodes to check on, "
                "nobody knows whether the model is better than none"
            )


class BehaviourCVAE(eqx.Module):
    """a ~ pi_b(a|s) through a latent variable."""

    cvae: CVAE  # of s; its target is a, its output an action before the tanh

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> Float[Array, "rows latent_dim"]:
        """Standard normal noise for z."""
        return self.cvae.draw_noise(key, rows)

    def before_tanh(
        self, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "rows latent_dim"]
    ) -> Float[Array, "rows act_dim"]:
        """One action a row, before the tanh, for a z of the prior cut to +-0.5."""
        return self.cvae.decode(observations, self.cvae.latent_for(observations, noise))

    def act(
        self, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "rows latent_dim"]
    ) -> Float[Array, "rows act_dim"]:
        """One action in [-1, 1] a row, for a z of the prior cut to +-0.5."""
        return jnp.tanh(self.before_tanh(observations, noise))

    def misfit(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        noise: Float[Array, "rows latent_dim"],
    ) -> Float[Array, " rows"]:
        """l(s, a), for one z of q a row, which is not cut; the gradient in a passes through q and the residual."""
        output, mean, log_std = self.cvae.reconstruct(observations, actions, noise)
        residual = jnp.mean(jnp.square(jnp.tanh(output) - actions), axis=-1)
        return residual + KL_WEIGHT * jnp.mean(latent_divergence(mean, log_std), axis=-1)

    def loss(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        noise: Float[Array, "rows latent_dim"],
    ) -> Float[Array, ""]:
        """L."""
        return jnp.mean(self.misfit(observations, actions, noise))


def init_behaviour_cvae(
    key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...] = (750, 750)
) -> BehaviourCVAE:
    """Draw encoder and decoder, with two latent variables an action dimension and zero hidden biases."""
    return BehaviourCVAE(
        init_cvae(
            key,
            condition_dim=obs_dim,
            target_dim=act_dim,
            output_dim=act_dim,
            latent_dim=LATENTS_PER_ACTION * act_dim,
            encoder_sizes=hidden_sizes,
            decoder_sizes=hidden_sizes,
            log_std_range=LOG_STD_RANGE,
        )
    )


def fit_behaviour_cvae(
    config: BehaviourConfig, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: Progress
) -> tuple[BehaviourCVAE, dict[str, Any]]:
    """Train the auto-encoder on most episodes and measure it on the rest; arguments and errors as `fit_clone`.

    Returns:
        The frozen model, and a report whose error is L with the central z.
    """
    key_init, key_fit = jr.split(key)
    model = init_behaviour_cvae(key_init, dataset.obs_dim, dataset.act_dim, config.hidden_sizes)
    return _fitted(config, model, _cvae_loss, _cvae_errors, dataset, normaliser, key_fit, progress)


def fit_clone(
    config: BehaviourConfig, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: Progress
) -> tuple[DeterministicActor, dict[str, Any]]:
    """Train the clone on most episodes and measure it on the rest.

    Args:
        config: sizes and training of the model.
        dataset: the log; whole episodes go to one side.
        normaliser: observation scaling of the learner that will use the model.
        key: random key for the split, the initial networks and the batches.
        progress: called with (steps done, steps in all) after every stretch.

    Returns:
        The frozen model, and a report: the mean of the hold-out errors ("holdout_error"), the mean squared error of
        always giving the mean action, and a warning if the first is not the smaller.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows.
    """
    key_init, key_fit = jr.split(key)
    model = init_deterministic_actor(key_init, dataset.obs_dim, dataset.act_dim, config.hidden_sizes)
    return _fitted(config, model, _clone_loss, _clone_errors, dataset, normaliser, key_fit, progress)


def init_gaussian(key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...]) -> NarrowGaussianActor:
    """Draw a Gaussian with zero hidden biases."""
    return NarrowGaussianActor(init_mlp(key, (obs_dim, *hidden_sizes, 2 * act_dim), hidden_bias=0.0))


def log_density_inside(
    model: NarrowGaussianActor, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "*draws rows act_dim"]
) -> Float[Array, "*draws rows"]:
    """log pi_b(a|s) in nats, of actions cut to +-0.999; the Gaussian is computed once a state."""
    mean, log_std = (jnp.broadcast_to(part, actions.shape) for part in model.parameters(observations))
    return exact_tanh_gaussian_log_density(mean, log_std, jnp.clip(actions, -LARGEST_ACTION, LARGEST_ACTION))


def gaussian_loss(
    model: tuple[NarrowGaussianActor, Float[Array, ""]], batch: Rows, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """L of the Gaussian, in which alpha is a constant, beside alpha's own loss alpha ( entropy + act_dim ).

    alpha is stored as it is and counts as 0 below 0.
    """
    (gaussian, alpha), (observations, actions, _) = model, batch
    mean, log_std = gaussian.parameters(observations)
    _, log_drawn = gaussian.squashed(mean, log_std, jr.normal(key, mean.shape))
    inside = jnp.clip(actions, -LARGEST_ACTION, LARGEST_ACTION)
    log_density = jnp.mean(exact_tanh_gaussian_log_density(mean, log_std, inside))
    entropy = -jnp.mean(log_drawn)
    weight = jax.lax.stop_gradient(jnp.maximum(alpha, 0.0))
    steering = alpha * jax.lax.stop_gradient(entropy + actions.shape[1])
    figures = {"log_density": log_density, "entropy": entropy, "temperature": alpha}
    return steering - weight * entropy - log_density, figures


def fit_gaussian(
    config: BehaviourConfig, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: Progress
) -> tuple[NarrowGaussianActor, dict[str, Any]]:
    """Train the Gaussian on most episodes and measure it on the rest; arguments and errors as `fit_clone`.

    Returns:
        The frozen model, and a report whose error is the squared one of tanh(mean).
    """
    key_init, key_fit = jr.split(key)
    model = init_gaussian(key_init, dataset.obs_dim, dataset.act_dim, config.hidden_sizes), jnp.ones(())
    fitted, report = _fitted(config, model, gaussian_loss, _gaussian_errors, dataset, normaliser, key_fit, progress)
    return fitted[0], report


def _gaussian_errors(model: tuple[NarrowGaussianActor, Float[Array, ""]], batch: Rows) -> Float[Array, " rows"]:
    return jnp.mean(jnp.square(model[0].mode(batch[0]) - batch[1]), axis=-1)


def _cvae_loss(
    model: BehaviourCVAE, batch: Rows, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    return model.loss(batch[0], batch[1], model.draw_noise(key, batch[0].shape[0])), {}


def _cvae_errors(model: BehaviourCVAE, batch: Rows) -> Float[Array, " rows"]:
    return model.misfit(batch[0], batch[1], jnp.zeros((batch[0].shape[0], model.cvae.latent_dim)))


def _clone_loss(
    model: DeterministicActor, batch: Rows, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    return jnp.mean(_clone_errors(model, batch)), {}


def _clone_errors(model: DeterministicActor, batch: Rows) -> Float[Array, " rows"]:
    return jnp.mean(jnp.square(model.mode(batch[0]) - batch[1]), axis=-1)


def _fitted(
    config: BehaviourConfig,
    model: Model,
    loss: Loss,
    errors: OfRows,
    dataset: Dataset,
    normaliser: Normaliser,
    key: PRNGKeyArray,
    progress: Progress,
) -> tuple[Model, dict[str, Any]]:
    key_split, key_train = jr.split(key)
    what = "behaviour model"
    remedy = "take a learner that needs no model of the log, such as td3-bc"
    rows = split_columns(dataset, normaliser, config.holdout, key_split, what, remedy, needs_successors=False)
    fitted = fit(
        model,
        loss,
        rows.columns,
        rows=rows.train,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        key=key_train,
        progress=progress,
        what=what,
        remedy="lower behaviour.learning_rate or check the log for outliers with `odaf data info`",
    )
    error = float(np.mean(of_rows(errors, fitted.model, rows.columns, rows.train, rows.last_measured)))
    _, actions, _ = rows.measured()
    naive = float(np.mean(np.square(rows.training()[1].mean(axis=0) - actions)))
    report: dict[str, Any] = {
        "steps": fitted.steps,
        **{f"training_{name}": value for name, value in fitted.means.items()},
        "holdout_rows": len(actions),
        "holdout_error": error,
        "mean_action_mse": naive,
        "warnings": [],
    }
    if not error < naive:
        report["warnings"].append(
            f"behaviour model: its hold-out error {error:.3g} is no better than always giving the mean action "
            f"({naive:.3g}): the logged actions do not follow the states, or the model has learnt its rows by heart "
            "(fewer behaviour.steps) or too little (more)"
        )
    return fitted.model, report
