"""Actor networks: a tanh-Gaussian one for the soft actor-critic family, a deterministic one for cloning."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.distributions import sample_tanh_gaussian
from odaf.components.networks import MLP, init_mlp

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0
HEAD_BOUND = 1e-3


class GaussianActor(eqx.Module):
    """pi(a|s): an MLP whose outputs are the mean and the log standard deviation before the tanh."""

    network: MLP

    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation (clipped to [-5, 2]) of the Gaussian before squashing."""
        mean, log_std = jnp.split(self.network(observations), 2, axis=-1)
        return mean, jnp.clip(log_std, LOG_STD_MIN, LOG_STD_MAX)

    def sample(
        self, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "rows act_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, " rows"]]:
        """Action for given standard normal noise, and its log-density; differentiable in everything."""
        mean, log_std = self.parameters(observations)
        return sample_tanh_gaussian(mean, log_std, noise)

    def mode(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
        """Deterministic action tanh(mean), in (-1, 1)."""
        mean, _ = self.parameters(observations)
        return jnp.tanh(mean)


def draw_actions(
    actor: GaussianActor, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "draws rows act_dim"]
) -> tuple[Float[Array, "draws rows act_dim"], Float[Array, "draws rows"]]:
    """Several actions a state and their log-densities, from one pass through the actor."""
    mean, log_std = (jnp.broadcast_to(part[None], noise.shape) for part in actor.parameters(observations))
    return sample_tanh_gaussian(mean, log_std, noise)


class DeterministicActor(eqx.Module):
    """mu(s) = tanh(MLP(s))."""

    network: MLP

    def mode(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
        """Action in (-1, 1)."""
        return jnp.tanh(self.network(observations))


def init_gaussian_actor(key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...]) -> GaussianActor:
    """Draw an actor whose first actions are near zero with a standard deviation near one."""
    sizes = (obs_dim, *hidden_sizes, 2 * act_dim)
    return GaussianActor(init_mlp(key, sizes, output_bound=HEAD_BOUND))


def init_deterministic_actor(
    key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...]
) -> DeterministicActor:
    """Draw a deterministic actor with zero hidden biases."""
    return DeterministicActor(init_mlp(key, (obs_dim, *hidden_sizes, act_dim), hidden_bias=0.0))
