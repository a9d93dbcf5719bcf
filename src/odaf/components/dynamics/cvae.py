"""The ODAF paper's dynamics model: a conditional variational auto-encoder of the next state."""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.dynamics.base import DynamicsModel
from odaf.components.networks import MLP

KL_WEIGHT = 0.5
PRIOR_CLIP = 0.5


class CVAEDynamics(DynamicsModel):
    """z ~ q(z | condition), s' = decoder(s, a, z).

    With `sees_target` False the encoder's condition is (s, a), as printed in the paper and as its released code does.
    Such an encoder cannot carry information about s', its best choice is the prior, and the model is a regression
    network with noise on one input. With `sees_target` True the encoder sees (s, a, s') while training, and prediction
    draws z from the prior, clipped to +-0.5: a true conditional VAE.
    """

    network: MLP  # the decoder
    encoder: MLP
    shift: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]
    residual: bool = eqx.field(static=True)
    sees_target: bool = eqx.field(static=True)

    @property
    def latent_dim(self) -> int:
        """Width of z."""
        return self.encoder.weights[-1].shape[-1] // 2

    def encode(
        self, condition: Float[Array, "rows condition_dim"]
    ) -> tuple[Float[Array, "rows latent_dim"], Float[Array, "rows latent_dim"]]:
        """Mean and log standard deviation (not clipped, as in the released code) of q(z | condition)."""
        mean, log_std = jnp.split(self.encoder(condition), 2, axis=-1)
        return mean, log_std

    def decode(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        latent: Float[Array, "rows latent_dim"],
    ) -> Float[Array, "rows obs_dim"]:
        """The decoder's output, before scaling to a state."""
        return self.network(jnp.concatenate([observations, actions, latent], axis=-1))

    def latent_for(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        normal: Float[Array, "rows latent_dim"],
    ) -> Float[Array, "rows latent_dim"]:
        """z at prediction time: through the encoder if it needs no target, else from the clipped prior."""
        if self.sees_target:
            return jnp.clip(normal, -PRIOR_CLIP, PRIOR_CLIP)
        mean, log_std = self.encode(jnp.concatenate([observations, actions], axis=-1))
        return mean + jnp.exp(log_std) * normal

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> PyTree[Array]:
        """Standard normal noise for z."""
        return jr.normal(key, (rows, self.latent_dim))

    def predict(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"], noise: PyTree[Array]
    ) -> Float[Array, "rows obs_dim"]:
        """Decode one z a row."""
        latent = self.latent_for(observations, actions, noise)
        return self.to_state(observations, self.decode(observations, actions, latent))

    def expected(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows obs_dim"]:
        """Decode the central z."""
        return self.predict(observations, actions, jnp.zeros((observations.shape[0], self.latent_dim)))

    def loss(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Mean squared error + 0.5 KL(q || N(0, I)), both means over rows and dimensions."""
        parts = [observations, actions] + ([next_observations] if self.sees_target else [])
        mean, log_std = self.encode(jnp.concatenate(parts, axis=-1))
        latent = mean + jnp.exp(log_std) * jr.normal(key, mean.shape)
        output = self.decode(observations, actions, latent)
        error = jnp.mean(jnp.square(output - self.to_output(observations, next_observations)))
        divergence = -0.5 * jnp.mean(1.0 + 2.0 * log_std - jnp.square(mean) - jnp.exp(2.0 * log_std))
        return error + KL_WEIGHT * divergence
