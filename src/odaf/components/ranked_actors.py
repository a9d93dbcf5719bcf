"""Actors that propose several actions and take the one that a critic values most."""

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.candidates import best_candidate
from odaf.components.cvae import decoded_draws
from odaf.components.networks import MLP
from odaf.components.numbers import Number
from odaf.components.policies import Actor, GaussianActor


def perturbed(
    network: MLP,
    reach: Number,
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "draws rows act_dim"],
) -> Float[Array, "draws rows act_dim"]:
    """clip( a + reach tanh( MLP(s, a) ), -1, 1 ) of several actions a state."""
    return jnp.clip(actions + reach * jnp.tanh(network.of_draws(observations, actions)), -1.0, 1.0)


class PerturbedActor(Actor):
    """The best of a decoder's actions, each moved a little; what BCQ deploys.

    Without a key, the same noise is decoded at every state and step.
    """

    decoder: MLP  # of state and z to an action before the tanh
    perturbation: MLP
    reach: Float[Array, ""]  # of the perturbation
    critic: MLP  # Q_1
    noise: Float[Array, "candidates latent_dim"]

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """The candidate that the critic values most; with a key, among fresh draws."""
        actions = jnp.tanh(decoded_draws(self.decoder, observations, _noise(self.noise, observations, key)))
        moved = perturbed(self.perturbation, self.reach, observations, actions)
        return best_candidate(self.critic, observations, moved), carry


class RankedGaussianActor(Actor):
    """The best of several draws of a Gaussian actor; what BEAR deploys.

    Without a key, the draws come from the same noise at every state and step.
    """

    proposals: GaussianActor
    critic: MLP  # Q_1
    noise: Float[Array, "candidates act_dim"]

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """The draw that the critic values most; with a key, among fresh draws."""
        mean, log_std = self.proposals.parameters(observations)
        actions = jnp.tanh(mean[None] + jnp.exp(log_std)[None] * _noise(self.noise, observations, key))
        return best_candidate(self.critic, observations, actions), carry


def _noise(
    fixed: Float[Array, "candidates width"], observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None
) -> Float[Array, "candidates rows width"]:
    shape = fixed.shape[0], observations.shape[0], fixed.shape[1]
    return jnp.broadcast_to(fixed[:, None], shape) if key is None else jr.normal(key, shape, fixed.dtype)
