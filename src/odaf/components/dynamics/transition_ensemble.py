"""Probabilistic ensemble of whole transitions (Chua et al. 2018, in MOPO's form): the next state and the reward.

    x = ( (s, a) - m ) / d                           m, d of the rows trained on
    mu_i(x), v_i(x)                                  member i's means and log-variances of t = (s' - s, r)
    v <- v_max - softplus( v_max - v ),   v <- v_min + softplus( v - v_min )
    L = sum_i [ mean_{B, dims} (mu_i - t)^2 exp(-v_i) + mean_{B, dims} v_i ]
        + 1/2 sum_layers w_l ||W_l||^2 + 0.01 ( sum v_max - sum v_min )

t is in the log's own units and is not scaled, so member i's standard deviation exp(v_i / 2) is in these units too;
v_max and v_min are learnt and shared by the members. Weights W_l of all members decay, biases do not; the decay is part
of the loss and passes through Adam.

States come in and go out in the learner's units, as everywhere. Members are in the order of their hold-out error, the
best first: the first `elites` of them answer, all of them judge how far an answer can be trusted.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.critics import over_members
from odaf.components.dynamics.gaussian_ensemble import BOUND_WEIGHT, LOG_VARIANCE_MAX, LOG_VARIANCE_MIN
from odaf.components.networks import MLP, init_mlp

# What says how little an answer can be trusted, by name; see `uncertainty`.
Uncertainty = Literal["deviation", "disagreement", "spread"]


class TransitionEnsemble(eqx.Module):
    """(s', r) ~ N( (s, 0) + mu_i(s, a), diag exp(v_i(s, a)) ) with an i among the elites."""

    network: MLP  # all members, in the order of their hold-out error
    log_variance_max: Float[Array, " outputs"]  # the last output is the reward
    log_variance_min: Float[Array, " outputs"]
    input_mean: Float[Array, " inputs"]  # m, of learner's units
    input_std: Float[Array, " inputs"]  # d
    centre: Float[Array, " obs_dim"]  # the user's value of a state's 0 ...
    unit: Float[Array, " obs_dim"]  # ... and the user's units in one of the learner's; 1 where a column never varied
    elites: int = eqx.field(static=True)

    @property
    def members(self) -> int:
        """Networks in all."""
        return self.network.weights[0].shape[0]

    def moments(
        self,
        observations: Float[Array, "*members rows obs_dim"],
        actions: Float[Array, "*members rows act_dim"],
    ) -> tuple[Float[Array, "members rows outputs"], Float[Array, "members rows outputs"]]:
        """mu_i and v_i of every member, for the same rows or for rows of its own."""
        mean, log_variance = jnp.split(self.network(self._inputs(observations, actions)), 2, axis=-1)
        return mean, self._held(log_variance)

    def targets(
        self,
        observations: Float[Array, "*members rows obs_dim"],
        rewards: Float[Array, "*members rows"],
        next_observations: Float[Array, "*members rows obs_dim"],
    ) -> Float[Array, "*members rows outputs"]:
        """t = (s' - s, r), in the log's units."""
        change = (next_observations - observations) * _along(self.unit, observations)
        return jnp.concatenate([change, rewards[..., None]], axis=-1)

    def transition(
        self, observations: Float[Array, "*any rows obs_dim"], outputs: Float[Array, "*any rows outputs"]
    ) -> tuple[Float[Array, "*any rows obs_dim"], Float[Array, "*any rows"]]:
        """(s', r) of a t; inverse of `targets`."""
        return observations + outputs[..., :-1] / _along(self.unit, observations), outputs[..., -1]

    def in_user_units(self, observations: Float[Array, "*any obs_dim"]) -> Float[Array, "*any obs_dim"]:
        """States as the log has them."""
        return _along(self.centre, observations) + _along(self.unit, observations) * observations

    def draw(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, "rows obs_dim"], Float[Array, " rows"]]:
        """(s', r) of every row from an elite of its own, drawn anew at each call; no other member is evaluated.

        The rows are dealt out at random in equal hands, one an elite. So for each row all elites are alike likely, and
        a trajectory of rows has the law that independent draws would give it; only the counts of a call are even.
        """
        key_deal, key_normal = jr.split(key)
        rows, elites = observations.shape[0], self.elites
        hand = -(-rows // elites)
        order = jr.permutation(key_deal, hand * elites)  # of the places, which are more than the rows by less than one
        dealt = jnp.minimum(order, rows - 1).reshape(elites, hand)
        place = jnp.zeros_like(order).at[order].set(jnp.arange(hand * elites))[:rows]
        best: MLP = jax.tree.map(lambda leaf: leaf[:elites], self.network)
        handed = self._inputs(observations, actions)[dealt]
        outputs = over_members(lambda pair: pair[0](pair[1]), (best, handed)).reshape(hand * elites, -1)[place]
        mean, log_variance = jnp.split(outputs, 2, axis=-1)
        return self._drawn(observations, mean, self._held(log_variance), key_normal)

    def draw_and_doubt(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        key: PRNGKeyArray,
        kind: Uncertainty,
    ) -> tuple[Float[Array, "rows obs_dim"], Float[Array, " rows"], Float[Array, " rows"]]:
        """(s', r) of every row from an elite of its own, drawn anew at each call, and all members' u(s, a)."""
        key_member, key_normal = jr.split(key)
        inputs = self._inputs(observations, actions)
        mean, log_variance = jnp.split(over_members(lambda member: member(inputs), self.network), 2, axis=-1)
        log_variance = self._held(log_variance)
        doubt = uncertainty(mean, log_variance, kind)
        chosen = jr.randint(key_member, (1, observations.shape[0], 1), 0, self.elites)
        mean, log_variance = (jnp.take_along_axis(part, chosen, axis=0)[0] for part in (mean, log_variance))
        return *self._drawn(observations, mean, log_variance, key_normal), doubt

    def loss(
        self,
        observations: Float[Array, "members rows obs_dim"],
        actions: Float[Array, "members rows act_dim"],
        rewards: Float[Array, "members rows"],
        next_observations: Float[Array, "members rows obs_dim"],
        weight_decay: Float[Array, " layers"],
    ) -> Float[Array, ""]:
        """L, each member on rows of its own."""
        mean, log_variance = self.moments(observations, actions)
        error = jnp.square(mean - self.targets(observations, rewards, next_observations))
        fit = jnp.sum(jnp.mean(error * jnp.exp(-log_variance), axis=(1, 2)) + jnp.mean(log_variance, axis=(1, 2)))
        squares = jnp.stack([jnp.sum(jnp.square(weight)) for weight in self.network.weights])
        bounds = BOUND_WEIGHT * (jnp.sum(self.log_variance_max) - jnp.sum(self.log_variance_min))
        return fit + 0.5 * jnp.sum(weight_decay * squares) + bounds

    def _inputs(self, observations: Array, actions: Array) -> Array:
        inputs = jnp.concatenate([observations, actions], axis=-1)
        return (inputs - _along(self.input_mean, inputs)) / _along(self.input_std, inputs)

    def _held(self, log_variance: Array) -> Array:
        high, low = (_along(bound, log_variance) for bound in (self.log_variance_max, self.log_variance_min))
        log_variance = high - jax.nn.softplus(high - log_variance)
        return low + jax.nn.softplus(log_variance - low)

    def _drawn(self, observations: Array, mean: Array, log_variance: Array, key: PRNGKeyArray) -> tuple[Array, Array]:
        return self.transition(observations, mean + jnp.exp(0.5 * log_variance) * jr.normal(key, mean.shape))


def _along(vector: Array, array: Array) -> Array:
    """The vector with as many axes as the array, whose last one it lies along."""
    return vector.reshape((1,) * (array.ndim - 1) + vector.shape)


def uncertainty(
    mean: Float[Array, "members rows outputs"],
    log_variance: Float[Array, "members rows outputs"],
    kind: Uncertainty,
) -> Float[Array, " rows"]:
    """u(s, a), in the log's units.

    Args:
        mean: mu_i of all members.
        log_variance: v_i of all members.
        kind: "deviation" is max_i || exp(v_i / 2) ||_2 over states and reward, the largest member's deviation (MOPO);
            "disagreement" is max_i || mu_i - mean_j mu_j ||_2 over states alone; "spread" is the root of the members'
            variance of mu_i, meaned over the dimensions of the state.
    """
    if kind == "deviation":
        return jnp.max(jnp.sqrt(jnp.sum(jnp.exp(log_variance), axis=-1)), axis=0)
    states = mean[..., :-1]
    apart = jnp.square(states - jnp.mean(states, axis=0, keepdims=True))
    if kind == "disagreement":
        return jnp.max(jnp.sqrt(jnp.sum(apart, axis=-1)), axis=0)
    return jnp.sqrt(jnp.mean(apart, axis=(0, 2)))


def init_transition_ensemble(
    key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...], members: int, elites: int
) -> TransitionEnsemble:
    """Draw the members: weights from a normal of 1 / (2 sqrt(fan_in)) cut at two deviations, zero biases.

    Source:
        Chua et al. 2018 (PETS) and MOPO's code.
    """
    inputs, outputs = obs_dim + act_dim, obs_dim + 1
    sizes = (inputs, *hidden_sizes, 2 * outputs)
    network = init_mlp(key, sizes, members=members, activation="silu", hidden_bias=0.0)
    weights = tuple(
        jr.truncated_normal(jr.fold_in(key, layer), -2.0, 2.0, weight.shape) / (2.0 * weight.shape[1] ** 0.5)
        for layer, weight in enumerate(network.weights)
    )
    return TransitionEnsemble(
        network=eqx.tree_at(lambda mlp: mlp.weights, network, weights),
        log_variance_max=jnp.full(outputs, LOG_VARIANCE_MAX),
        log_variance_min=jnp.full(outputs, LOG_VARIANCE_MIN),
        input_mean=jnp.zeros(inputs),
        input_std=jnp.ones(inputs),
        centre=jnp.zeros(obs_dim),
        unit=jnp.ones(obs_dim),
        elites=elites,
    )
