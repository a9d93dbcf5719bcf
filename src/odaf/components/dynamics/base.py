"""What every dynamics model offers, and the settings that choose and train one."""

import abc
import dataclasses
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class DynamicsConfig:
    """Which dynamics model, and how it is pre-trained."""

    kind: Literal["deterministic", "ensemble", "cvae"] = "deterministic"
    """deterministic: one regression network; ensemble: probabilistic ensemble; cvae: the paper's variational model."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers (of the decoder for cvae, whose encoder has one layer more)."""
    residual: bool = True
    """Predict the scaled change s' - s; False predicts the next state itself, as the paper's model does."""
    steps: int = 10_000
    """Gradient steps before the policy is trained; the model is frozen afterwards."""
    batch_size: int = 256
    """Rows a gradient step (and a member)."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    schedule: Literal["cosine", "constant"] = "cosine"
    """Course of the learning rate: down to zero over the steps, or constant."""
    holdout: float = 0.05
    """Share of the episodes kept out of training to measure the error on."""
    patience: int | None = None
    """Stop after so many checks of that error, one every 1,000 steps, without a new lowest one, and keep the model that
    had it; None trains for all steps and keeps the last."""
    members: int = 7
    """Networks trained (ensemble only)."""
    elites: int = 5
    """Networks kept, those with the lowest hold-out error (ensemble only)."""
    latent_dim: int = 32
    """Width of the latent variable (cvae only)."""
    encoder: Literal["state-action", "transition"] = "state-action"
    """What the cvae's encoder sees: (s, a) as printed in the paper, or (s, a, s'), a true posterior."""

    def __post_init__(self) -> None:
        counts = ("steps", "batch_size", "patience", "members", "elites", "latent_dim")
        for field in counts:
            count = getattr(self, field)
            if count is not None and count < 1:
                raise ConfigError(f"dynamics.{field}={count} must be at least 1")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"dynamics.hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if self.kind == "ensemble" and self.elites > self.members:
            raise ConfigError(
                f"dynamics.elites={self.elites} cannot be kept of dynamics.members={self.members}; train more members"
            )
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(
                f"dynamics.holdout={self.holdout} must lie between 0 and 1: without episodes to check on, "
                "nobody knows whether the model is better than none"
            )


class DynamicsModel(eqx.Module):
    """Predicts the next state from a state and an action, all in normalised units.

    Randomness comes in as explicit noise, so that a caller who scored several draws can evaluate a chosen one again.
    """

    shift: eqx.AbstractVar[Float[Array, " obs_dim"]]
    scale: eqx.AbstractVar[Float[Array, " obs_dim"]]
    residual: eqx.AbstractVar[bool]

    def to_state(
        self, observations: Float[Array, "*rows obs_dim"], output: Float[Array, "*members rows obs_dim"]
    ) -> Float[Array, "*members rows obs_dim"]:
        """Next state from the network's output: s' = [s +] shift + scale * output."""
        rank = output.ndim
        shift, scale = (jnp.expand_dims(v, tuple(range(rank - 1))) for v in (self.shift, self.scale))
        state = shift + scale * output
        if not self.residual:
            return state
        return jnp.expand_dims(observations, tuple(range(rank - observations.ndim))) + state

    def to_output(
        self, observations: Float[Array, "*rows obs_dim"], next_observations: Float[Array, "*rows obs_dim"]
    ) -> Float[Array, "*rows obs_dim"]:
        """The network output that would predict this next state exactly; inverse of `to_state`."""
        axes = tuple(range(observations.ndim - 1))
        shift, scale = (jnp.expand_dims(v, axes) for v in (self.shift, self.scale))
        base = observations if self.residual else jnp.zeros_like(observations)
        return (next_observations - base - shift) / scale

    @property
    def bootstraps(self) -> int | None:
        """Number of bootstrap samples that training draws; None when the model sees one plain batch."""
        return None

    @abc.abstractmethod
    def draw_noise(self, key: PRNGKeyArray, rows: int) -> PyTree[Array]:
        """Noise for one prediction a row: arrays whose first axis is `rows`."""

    @abc.abstractmethod
    def predict(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        noise: PyTree[Array],
    ) -> Float[Array, "rows obs_dim"]:
        """One next state a row, differentiable in state and action."""

    def predict_draws(
        self,
        observations: Float[Array, "draws rows obs_dim"],
        actions: Float[Array, "draws rows act_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, "draws rows obs_dim"]:
        """Several next states a row, each with noise of its own; differentiable in state and action."""
        draws, rows, width = observations.shape
        noise = self.draw_noise(key, draws * rows)
        flat = self.predict(observations.reshape(-1, width), actions.reshape(draws * rows, actions.shape[2]), noise)
        return flat.reshape(draws, rows, width)

    @abc.abstractmethod
    def expected(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows obs_dim"]:
        """The model's mean (or its central) prediction, used for the hold-out error."""

    @abc.abstractmethod
    def loss(
        self,
        observations: Float[Array, "*members rows obs_dim"],
        actions: Float[Array, "*members rows act_dim"],
        next_observations: Float[Array, "*members rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Training loss; arrays have a leading axis of `bootstraps` when that is not None."""

    def errors(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
    ) -> Float[Array, "rows members"]:
        """Mean squared error of every row's mean output, by member; a model without members is one."""
        wanted = self.to_output(observations, next_observations)
        found = self.to_output(observations, self.expected(observations, actions))
        return jnp.mean(jnp.square(found - wanted), axis=-1)[:, None]

    def finished(self, errors: Float[np.ndarray, " members"], elites: int) -> "DynamicsModel":
        """The model to keep after training, given its `errors` on rows held out; an ensemble keeps its best members."""
        del errors, elites
        return self
