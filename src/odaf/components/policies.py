"""Actors: what a trained policy is. Gaussian ones, squashed by a tanh or cut to the bounds, and a deterministic one."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, PRNGKeyArray, PyTree

from odaf.components.distributions import (
    exact_sample_tanh_gaussian,
    exact_tanh_gaussian_log_density,
    gaussian_log_density,
    sample_tanh_gaussian,
)
from odaf.components.networks import MLP, Factors, init_mlp
from odaf.errors import ConfigError

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0
HEAD_BOUND = 1e-3


class Actor(eqx.Module):
    """What acts, and no more: parameters and pure functions of normalised observations and actions in [-1, 1].

    Most actors see one observation and forget it; their carry is (). One with a memory (a return-to-go, a history)
    keeps it in the carry, whose arrays have a leading axis of rows: `begin` makes it, `act` and `observe` hand on the
    next one. All methods but `begin` may be traced.
    """

    takes_rewards: ClassVar[bool] = False
    """Whether actions depend on the rewards that earlier ones earned, so that `observe` has to be told of them."""

    def begin(self, rows: int) -> PyTree:
        """The carry before the first step of `rows` episodes that are played side by side."""
        del rows
        return ()

    @abc.abstractmethod
    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """Actions in [-1, 1] and the next carry; without a key those that a deployed policy takes, else a draw."""

    def observe(self, carry: PyTree, rewards: Float[Array, " rows"]) -> PyTree:
        """The carry after the rewards, in the log's units, that the last actions earned."""
        del rewards
        return carry

    def log_density(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, " rows"]:
        """log pi(a|s) in nats of actions in [-1, 1].

        Raises:
            ConfigError: the actor has no density.
        """
        del observations, actions
        raise ConfigError(
            f"{type(self).__name__}: has no density of its actions, so what weighs actions by their probability "
            "cannot use it; take a stochastic policy, or a method that asks for none, such as fitted Q evaluation"
        )

    def mode(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
        """Deterministic actions in [-1, 1] at the first step of an episode: of an actor without memory, at any step."""
        return self.act(self.begin(observations.shape[0]), observations)[0]


class SquashedGaussianActor(Actor):
    """pi(a|s): the tanh of a Gaussian whose mean and log standard deviation depend on the state."""

    @abc.abstractmethod
    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation of the Gaussian before squashing."""

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """tanh(mean), or with a key a draw of tanh(mean + std * noise)."""
        mean, log_std = self.parameters(observations)
        if key is not None:
            mean = mean + jnp.exp(log_std) * jr.normal(key, mean.shape, mean.dtype)
        return jnp.tanh(mean), carry

    def log_density(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, " rows"]:
        """log pi(a|s) in nats, without a floor; an action on a bound counts as the nearest number inside."""
        return exact_tanh_gaussian_log_density(*self.parameters(observations), actions)

    def sample(
        self,
        observations: Float[Array, "rows obs_dim"],
        noise: Float[Array, "rows act_dim"],
        own: Bool[Array, " act_dim"] | None = None,
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, " rows"]]:
        """Action for given standard normal noise, and its log-density; differentiable in everything.

        Where actions are padded, the log-density is that of the dimensions that are `own`.
        """
        return self.squashed(*self.parameters(observations), noise, own)

    def squashed(
        self,
        mean: Float[Array, "*rows act_dim"],
        log_std: Float[Array, "*rows act_dim"],
        noise: Float[Array, "*rows act_dim"],
        own: Bool[Array, " act_dim"] | None = None,
    ) -> tuple[Float[Array, "*rows act_dim"], Float[Array, "*rows"]]:
        """tanh(mean + std * noise) and its log-density, which has the floor of SAC-N and its relatives."""
        return sample_tanh_gaussian(mean, log_std, noise, own)


class GaussianActor(SquashedGaussianActor):
    """pi(a|s): an MLP whose outputs are the mean and the log standard deviation before the tanh."""

    network: MLP

    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation (clipped to [-5, 2]) of the Gaussian before squashing."""
        mean, log_std = jnp.split(self.network(observations), 2, axis=-1)
        return mean, jnp.clip(log_std, LOG_STD_MIN, LOG_STD_MAX)


class NarrowGaussianActor(SquashedGaussianActor):
    """As `GaussianActor`, with a standard deviation that a tanh keeps inside [e^-5, 1] before squashing.

    log std = -5 + 2.5 ( tanh(output) + 1 ), so it has a slope everywhere; log-densities have no floor (BRAC).
    """

    network: MLP

    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation of the Gaussian before squashing."""
        mean, output = jnp.split(self.network(observations), 2, axis=-1)
        return mean, LOG_STD_MIN - 0.5 * LOG_STD_MIN * (jnp.tanh(output) + 1.0)

    def squashed(
        self,
        mean: Float[Array, "*rows act_dim"],
        log_std: Float[Array, "*rows act_dim"],
        noise: Float[Array, "*rows act_dim"],
        own: Bool[Array, " act_dim"] | None = None,
    ) -> tuple[Float[Array, "*rows act_dim"], Float[Array, "*rows"]]:
        """tanh(mean + std * noise) and its log-density, exact up to the bounds."""
        return exact_sample_tanh_gaussian(mean, log_std, noise, own)


class ExactGaussianActor(SquashedGaussianActor):
    """As `GaussianActor`, with log-densities that have no floor and a range of its own for the log standard deviation.

    The latter is m output + c where there are m and c (CQL).
    """

    network: MLP
    log_std_scale: Float[Array, ""] | None  # m, learnt; None takes the output as it is
    log_std_offset: Float[Array, ""] | None  # c, learnt
    log_std_min: float = eqx.field(static=True)
    log_std_max: float = eqx.field(static=True)

    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation of the Gaussian before squashing."""
        mean, log_std = jnp.split(self.network(observations), 2, axis=-1)
        if self.log_std_scale is not None and self.log_std_offset is not None:
            log_std = self.log_std_scale * log_std + self.log_std_offset
        return mean, jnp.clip(log_std, self.log_std_min, self.log_std_max)

    def squashed(
        self,
        mean: Float[Array, "*rows act_dim"],
        log_std: Float[Array, "*rows act_dim"],
        noise: Float[Array, "*rows act_dim"],
        own: Bool[Array, " act_dim"] | None = None,
    ) -> tuple[Float[Array, "*rows act_dim"], Float[Array, "*rows"]]:
        """tanh(mean + std * noise) and its log-density, exact up to the bounds."""
        return exact_sample_tanh_gaussian(mean, log_std, noise, own)


def draw_actions(
    actor: SquashedGaussianActor, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "draws rows act_dim"]
) -> tuple[Float[Array, "draws rows act_dim"], Float[Array, "draws rows"]]:
    """Several actions a state and their log-densities, from one pass through the actor."""
    mean, log_std = (jnp.broadcast_to(part[None], noise.shape) for part in actor.parameters(observations))
    return actor.squashed(mean, log_std, noise)


class UnsquashedGaussianActor(Actor):
    """pi(a|s) = N(a; tanh(MLP(s)), std^2), with one standard deviation a dimension for all states.

    Draws are cut to [-1, 1].
    """

    network: MLP
    log_std: Float[Array, " act_dim"]

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """tanh(MLP(s)), or with a key a draw around it, cut to [-1, 1]."""
        mean, log_std = self.parameters(observations)
        if key is None:
            return mean, carry
        return jnp.clip(mean + jnp.exp(log_std) * jr.normal(key, mean.shape, mean.dtype), -1.0, 1.0), carry

    def log_density(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, " rows"]:
        """log pi(a|s) in nats, of the Gaussian before draws are cut."""
        return gaussian_log_density(*self.parameters(observations), actions)

    def parameters(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation (clipped to [-5, 2])."""
        mean = jnp.tanh(self.network(observations))
        return mean, jnp.broadcast_to(jnp.clip(self.log_std, LOG_STD_MIN, LOG_STD_MAX), mean.shape)


class DeterministicActor(Actor):
    """mu(s) = tanh(MLP(s))."""

    network: MLP

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """mu(s), with or without a key."""
        del key
        return jnp.tanh(self.network(observations)), carry

    def with_dropout(
        self, observations: Float[Array, "rows obs_dim"], factors: Factors
    ) -> Float[Array, "rows act_dim"]:
        """mu(s) with its hidden units multiplied, as losses may have it; an actor acts without."""
        return jnp.tanh(self.network(observations, factors))


def init_gaussian_actor(key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...]) -> GaussianActor:
    """Draw an actor whose first actions are near zero with a standard deviation near one."""
    sizes = (obs_dim, *hidden_sizes, 2 * act_dim)
    return GaussianActor(init_mlp(key, sizes, output_bound=HEAD_BOUND))


def init_deterministic_actor(
    key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...], output_bound: float | None = None
) -> DeterministicActor:
    """Draw a deterministic actor with zero hidden biases; its last layer as `init_mlp` says."""
    sizes = (obs_dim, *hidden_sizes, act_dim)
    return DeterministicActor(init_mlp(key, sizes, hidden_bias=0.0, output_bound=output_bound))
