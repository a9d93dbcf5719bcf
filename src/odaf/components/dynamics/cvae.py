"""The ODAF paper's dynamics model: a conditional variational auto-encoder of the next state."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.cvae import CVAE, KL_WEIGHT
from odaf.components.dynamics.base import DynamicsModel


class CVAEDynamics(DynamicsModel):
    """s' = decoder(s, a, z), z ~ q(z | s, a[, s']).

    Where the encoder does not see s', as printed in the paper and as its released code does, its best choice is the
    prior, and the model is a regression network with noise on one input.
    """

    cvae: CVAE
    shift: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]
    residual: bool = eqx.field(static=True)

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> PyTree[Array]:
        """Standard normal noise for z."""
        return self.cvae.draw_noise(key, rows)

    def predict(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"], noise: PyTree[Array]
    ) -> Float[Array, "rows obs_dim"]:
        """Decode one z a row."""
        condition = jnp.concatenate([observations, actions], axis=-1)
        latent = self.cvae.latent_for(condition, noise)
        return self.to_state(observations, self.cvae.decode(condition, latent))

    def expected(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows obs_dim"]:
        """Decode the central z: the prior's, or the encoder's mean."""
        condition = jnp.concatenate([observations, actions], axis=-1)
        if self.cvae.sees_target:
            latent = jnp.zeros((observations.shape[0], self.cvae.latent_dim))
        else:
            latent, _ = self.cvae.encode(condition)  # without its spread, which far states let run over
        return self.to_state(observations, self.cvae.decode(condition, latent))

    def loss(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Mean squared error + 0.5 KL(q || N(0, I)), both means over rows and dimensions."""
        condition = jnp.concatenate([observations, actions], axis=-1)
        normal = self.draw_noise(key, observations.shape[0])
        output, mean, log_std = self.cvae.reconstruct(condition, next_observations, normal)
        error = jnp.mean(jnp.square(output - self.to_output(observations, next_observations)))
        # `latent_divergence` in the released code's words: the other rounds differently
        divergence = -0.5 * jnp.mean(1.0 + 2.0 * log_std - jnp.square(mean) - jnp.exp(2.0 * log_std))
        return error + KL_WEIGHT * divergence
