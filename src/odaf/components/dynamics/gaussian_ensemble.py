"""Probabilistic ensemble (Chua et al. 2018, in MOPO's form): Gaussian members, each on its own bootstrap sample."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.dynamics.base import DynamicsModel
from odaf.components.networks import MLP

BOUND_WEIGHT = 0.01
LOG_VARIANCE_MAX, LOG_VARIANCE_MIN = 0.5, -10.0


class GaussianEnsembleDynamics(DynamicsModel):
    """Members predict mean and log-variance of the scaled output; a prediction is a draw from one random member.

    Differs from MOPO's: no reward head (the outcome term needs states only), outputs scaled by the spread of the
    changes, early stopping only where asked for and for all members together, no weight decay.
    """

    network: MLP
    log_variance_max: Float[Array, " obs_dim"]  # shared by the members and learnt, as in the original
    log_variance_min: Float[Array, " obs_dim"]
    shift: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]
    residual: bool = eqx.field(static=True)

    @property
    def bootstraps(self) -> int:
        """One bootstrap sample a member."""
        return self.network.weights[0].shape[0]

    def moments(
        self, observations: Float[Array, "*members rows obs_dim"], actions: Float[Array, "*members rows act_dim"]
    ) -> tuple[Float[Array, "members rows obs_dim"], Float[Array, "members rows obs_dim"]]:
        """Mean and soft-clamped log-variance of the scaled output, by member."""
        mean, log_variance = jnp.split(self.network(jnp.concatenate([observations, actions], axis=-1)), 2, axis=-1)
        high, low = (bound[None, None, :] for bound in (self.log_variance_max, self.log_variance_min))
        log_variance = high - jax.nn.softplus(high - log_variance)
        log_variance = low + jax.nn.softplus(log_variance - low)
        return mean, log_variance

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> PyTree[Array]:
        """A member's index and standard normal noise for every row."""
        key_member, key_normal = jr.split(key)
        members = jr.randint(key_member, (rows,), 0, self.bootstraps)
        return members, jr.normal(key_normal, (rows, self.shift.shape[0]))

    def predict(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"], noise: PyTree[Array]
    ) -> Float[Array, "rows obs_dim"]:
        """A draw from the member that the noise names."""
        members, normal = noise
        mean, log_variance = self.moments(observations, actions)
        pick = members[None, :, None]
        mean, log_variance = (jnp.take_along_axis(v, pick, axis=0)[0] for v in (mean, log_variance))
        return self.to_state(observations, mean + jnp.exp(0.5 * log_variance) * normal)

    def predict_draws(
        self,
        observations: Float[Array, "draws rows obs_dim"],
        actions: Float[Array, "draws rows act_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, "draws rows obs_dim"]:
        """Every draw from a random member, the same for all of its rows, so that no other member is asked."""
        key_member, key_normal = jr.split(key)
        members = jr.randint(key_member, observations.shape[:1], 0, self.bootstraps)
        chosen = jax.tree.map(lambda leaf: leaf[members] if eqx.is_array(leaf) else leaf, self.network)
        drawn = eqx.tree_at(lambda model: model.network, self, chosen)
        mean, log_variance = drawn.moments(observations, actions)
        return self.to_state(observations, mean + jnp.exp(0.5 * log_variance) * jr.normal(key_normal, mean.shape))

    def expected(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows obs_dim"]:
        """Mean over the members of their means."""
        mean, _ = self.moments(observations, actions)
        return self.to_state(observations, jnp.mean(mean, axis=0))

    def loss(
        self,
        observations: Float[Array, "members rows obs_dim"],
        actions: Float[Array, "members rows act_dim"],
        next_observations: Float[Array, "members rows obs_dim"],
        key: PRNGKeyArray,
    ) -> Float[Array, ""]:
        """Sum over members of mean((mu - t)^2 / sigma^2) + mean(log sigma^2), plus 0.01 (sum max - sum min)."""
        del key
        mean, log_variance = self.moments(observations, actions)
        error = jnp.square(mean - self.to_output(observations, next_observations))
        fit = jnp.sum(jnp.mean(error * jnp.exp(-log_variance) + log_variance, axis=(1, 2)))
        return fit + BOUND_WEIGHT * (jnp.sum(self.log_variance_max) - jnp.sum(self.log_variance_min))

    def errors(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        next_observations: Float[Array, "rows obs_dim"],
    ) -> Float[Array, "rows members"]:
        """Mean squared error of every row's mean output, by member."""
        mean, _ = self.moments(observations, actions)
        wanted = self.to_output(observations, next_observations)
        return jnp.mean(jnp.square(mean - wanted[None]), axis=-1).T

    def finished(self, errors: Float[np.ndarray, " members"], elites: int) -> "GaussianEnsembleDynamics":
        """The `elites` members with the lowest errors, best first."""
        best = jnp.asarray(np.argsort(errors, kind="stable")[:elites])
        kept = jax.tree.map(lambda leaf: leaf[best] if eqx.is_array(leaf) else leaf, self.network)
        return eqx.tree_at(lambda model: model.network, self, kept)
