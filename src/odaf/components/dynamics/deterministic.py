"""One regression network for the next state: the default."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.dynamics.base import DynamicsModel
from odaf.components.networks import MLP


class DeterministicDynamics(DynamicsModel):
    """s' = [s +] shift + scale * f(s, a), fitted by mean squared error of the scaled output."""

    network: MLP
    shift: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]
    residual: bool = eqx.field(static=True)

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> PyTree[Array]:
        """No noise: an empty tuple."""
        del key, rows
        return ()

    def predict(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"], noise: PyTree[Array]
    ) -> Float[Array, "rows obs_dim"]:
        """The prediction; `noise` is ignored."""
        del noise
        return self.expected(observations, actions)

    def expected(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows obs_dim"]:
        """The prediction."""
        return self.to_state(observations, self.network(jnp.concatenate([observations, actions], axis=-1)))

    def loss(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Mean over rows and dimensions of the squared error of the scaled output."""
        del key
        output = self.network(jnp.concatenate([observations, actions], axis=-1))
        return jnp.mean(jnp.square(output - self.to_output(observations, next_observations)))
