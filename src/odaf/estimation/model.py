"""Rollouts of a model of the plant: what a policy would earn if what follows an action were as the log suggests.

Every member of an ensemble learns from the same resampled episodes as a member of fitted Q:

    (s', r) ~ N( mean(s, a), std(s, a)^2 )       a Gaussian ensemble (`odaf.components.dynamics`), r as a last state
    p(s, a, s')                                  logistic, the chance that the task ends with this step

    V = mean_{s_0} sum_{t < H} gamma^t S_t E[ r(s_t, a_t) ],     S_0 = 1,     S_{t+1} = S_t ( 1 - p(s_t, a_t, s_{t+1}) )

from the log's first states, a_t from the policy, s_{t+1} drawn and kept inside the range that the log shows, rewards
inside theirs. S_t is the share of episodes that still run: none is cut by a draw. The spread of the members, each with
its own episodes for learning and for starts, is the standard error. Differs from MBPO and MOPO's models: ends are
learnt, members are not mixed within a rollout, no early stopping.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.dynamics import DynamicsConfig, untrained
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics
from odaf.components.fitting import Batch, Progress, fit
from odaf.components.networks import MLP, init_mlp
from odaf.components.policies import Actor
from odaf.estimation.evidence import Evidence
from odaf.estimation.outcomes import Visited

STRETCH = 1_000
MOST_STARTS = 256
WATCHED = 8  # starts whose episodes are returned step by step
ROUNDING = 1e-6  # of the largest change: less is no change


Carry = tuple[Array, Array, Array, Array]  # states, shares that still run, discount so far, sums


class PlantModel(eqx.Module):
    """What follows an action, by member, in the log's normalised units."""

    dynamics: GaussianEnsembleDynamics  # of the state with the reward behind it
    ends: MLP
    low: Float[Array, " obs_and_reward"]  # the range that the log shows
    high: Float[Array, " obs_and_reward"]

    def step(
        self,
        states: Float[Array, "members rows obs"],
        actions: Float[Array, "members rows act"],
        normal: Float[Array, "members rows obs_and_reward"],
    ) -> tuple[Float[Array, "members rows obs"], Float[Array, "members rows"], Float[Array, "members rows"]]:
        """Drawn successors, expected rewards, and the chance that the task ends."""
        before = with_reward(states, jnp.zeros(states.shape[:2]))
        mean, log_variance = self.dynamics.moments(before, actions)
        low, high = self.low[None, None], self.high[None, None]
        drawn = jnp.clip(self.dynamics.to_state(before, mean + jnp.exp(0.5 * log_variance) * normal), low, high)
        rewards = jnp.clip(self.dynamics.to_state(before, mean), low, high)[..., -1]
        following = drawn[..., :-1]
        return following, rewards, jax.nn.sigmoid(self.end_logits(states, actions, following))

    def end_logits(
        self,
        states: Float[Array, "members rows obs"],
        actions: Float[Array, "members rows act"],
        next_states: Float[Array, "members rows obs"],
    ) -> Float[Array, "members rows"]:
        """log( p / (1 - p) )."""
        return self.ends(jnp.concatenate([states, actions, next_states], axis=-1))[..., 0]


def with_reward(states: Float[Array, "*m rows obs"], rewards: Float[Array, "*m rows"]) -> Float[Array, "*m rows both"]:
    """States with rewards as their last number."""
    return jnp.concatenate([states, rewards[..., None]], axis=-1)


@dataclass(frozen=True, eq=False)
class Player:
    """Who acts in rollouts.

    Attributes:
        actor: on observations of its own normaliser.
        mean: of that normaliser.
        scale: of that normaliser.
        draws: whether actions are drawn.
    """

    actor: Actor
    mean: np.ndarray
    scale: np.ndarray
    draws: bool


class Played(NamedTuple):
    """What a player earns in the model, and where it comes to.

    Attributes:
        values: what it earns, and the steps that an episode lasts: [discounts, 2, 1 + members] float64; first the mean
            of all members, then every member at its own starts.
        visited: every member's steps from a few of the starts.
    """

    values: np.ndarray
    visited: Visited


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A fitted model and the log that it was fitted to."""

    model: PlantModel
    log: Evidence
    loss: float
    starts: np.ndarray  # numbers of the episodes whose first states are played from
    key: PRNGKeyArray

    def play(self, player: Player) -> Played:
        """To the horizon of the log, from the first states of its episodes."""
        log = self.log
        first = jnp.asarray(log.observations[log.starts[self.starts]])
        own = (jnp.asarray(log.normaliser.mean), jnp.asarray(log.normaliser.std))
        theirs = (jnp.asarray(player.mean), jnp.asarray(player.scale))
        watched = np.unique(np.linspace(0, len(self.starts) - 1, WATCHED).astype(np.int64))
        sums, (states, running, rewards, actions) = _rollout(
            self.model,
            player.actor,
            (*own, *theirs),
            first,
            jnp.asarray(log.discounts, jnp.float32),
            self.key,
            jnp.asarray(watched),
            log.horizon,
            player.draws,
        )
        found = np.asarray(sums, np.float64)
        counts = log.member_counts[:, self.starts]
        weighed = np.sum(found * counts, axis=3) / np.maximum(np.sum(counts, axis=1), 1.0)
        values = np.concatenate([found.mean(axis=(2, 3))[..., None], weighed], axis=2)
        steps = np.asarray(running).reshape(log.horizon, -1)
        return Played(
            values,
            Visited(
                np.asarray(states).reshape(*steps.shape, -1),
                steps,
                np.asarray(rewards).reshape(steps.shape),
                np.asarray(actions).reshape(*steps.shape, -1),
            ),
        )


def fit_model(log: Evidence, key: PRNGKeyArray, progress: Progress) -> FittedModel:
    """Fit the ensemble to a log, by the log's settings.

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    key_dynamics, key_ends, key_fit, key_starts, key_play = jr.split(key, 5)
    settings, rewards = log.settings, log.dataset.rewards.astype(np.float32)
    config = DynamicsConfig(kind="ensemble", hidden_sizes=settings.hidden_sizes)
    obs_dim, act_dim = log.observations.shape[1], log.actions.shape[1]
    dynamics = untrained(config, key_dynamics, obs_dim + 1, act_dim, members=settings.members)
    assert isinstance(dynamics, GaussianEnsembleDynamics)
    change = np.concatenate([log.next_observations - log.observations, rewards[:, None]], axis=1, dtype=np.float64)
    spread = change.std(axis=0)
    spread = np.where(spread > ROUNDING * np.abs(change).max(axis=0), spread, 1.0)  # a constant is learnt by its shift
    scaling = jnp.asarray(change.mean(axis=0), jnp.float32), jnp.asarray(spread, jnp.float32)
    dynamics = eqx.tree_at(lambda tree: (tree.shift, tree.scale), dynamics, scaling)
    ends = init_mlp(key_ends, (2 * obs_dim + act_dim, *settings.hidden_sizes, 1), members=settings.members)
    seen = np.concatenate([log.observations, log.next_observations])
    model = PlantModel(
        dynamics,
        ends,
        jnp.asarray(np.append(seen.min(axis=0), rewards.min())),
        jnp.asarray(np.append(seen.max(axis=0), rewards.max())),
    )
    mask = jax.tree.map(lambda _: True, model)
    fitted = fit(
        model,
        _loss,
        (
            jnp.asarray(log.observations),
            jnp.asarray(log.actions),
            jnp.asarray(rewards),
            jnp.asarray(log.dataset.terminated.astype(np.float32)),
            jnp.asarray(log.next_observations),
        ),
        bootstraps=jnp.asarray(log.member_rows, jnp.int32),
        members=settings.members,
        trainable=eqx.tree_at(
            lambda tree: (tree.low, tree.high, tree.dynamics.shift, tree.dynamics.scale), mask, (False,) * 4
        ),
        stretch=min(settings.steps, STRETCH),
        schedule="cosine",
        key=key_fit,
        progress=progress,
        what="model of the plant",
        remedy="lower learning_rate, or check the log for outliers with `odaf data check`",
        steps=settings.steps,
        batch_size=settings.batch_size,
        learning_rate=settings.learning_rate,
    )
    order = np.asarray(jr.permutation(key_starts, len(log.starts)))
    return FittedModel(
        fitted.model, log, fitted.means["loss"] / settings.members, np.sort(order[:MOST_STARTS]), key_play
    )


def _loss(model: PlantModel, batch: Batch, key: PRNGKeyArray) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Of the Gaussian ensemble, plus the logistic loss of the ends, summed over members."""
    states, actions, rewards, ended, next_states = batch
    before, after = with_reward(states, jnp.zeros_like(rewards)), with_reward(next_states, rewards)
    logits = model.end_logits(states, actions, next_states)
    surprise = jnp.sum(jnp.mean(jax.nn.softplus(logits) - ended * logits, axis=1))
    return model.dynamics.loss(before, actions, after, key) + surprise, {"ends": surprise}


@functools.partial(jax.jit, static_argnames=("horizon", "draws"))
def _rollout(
    model: PlantModel,
    actor: Actor,
    scaling: tuple[Array, Array, Array, Array],
    starts: Float[Array, "rows obs"],
    discounts: Float[Array, " discounts"],
    key: PRNGKeyArray,
    watched: Int[Array, " watched"],
    horizon: int,
    draws: bool,
) -> tuple[Float[Array, "discounts 2 members rows"], tuple[Array, Array, Array, Array]]:
    """Sums of rewards and of ones, each weighed by discount and by the share that still runs.

    Then, of the starts that are watched, the state that each step led to [horizon, members, watched, obs], the share
    that still ran when it was taken, its reward [horizon, members, watched], and its action.
    """
    members, (rows, width) = model.dynamics.bootstraps, starts.shape
    own_mean, own_std, mean, scale = (each[None] for each in scaling)

    def step(carry: Carry, number: Array) -> tuple[Carry, tuple[Array, Array, Array, Array]]:
        states, runs, weight, sums = carry
        key_act, key_next = jr.split(jr.fold_in(key, number))
        seen = (states.reshape(-1, width) * own_std + own_mean - mean) / scale
        actions, _ = actor.act(actor.begin(members * rows), seen, key_act if draws else None)
        normal = jr.normal(key_next, (members, rows, width + 1))
        actions = actions.reshape(members, rows, -1)
        following, rewards, ends = model.step(states, actions, normal)
        earned = runs[None] * jnp.stack([rewards, jnp.ones_like(rewards)])
        sums = sums + weight[:, None, None, None] * earned[None]
        shown = following[:, watched], runs[:, watched], rewards[:, watched], actions[:, watched]
        return (following, runs * (1.0 - ends), weight * discounts, sums), shown

    carry = (
        jnp.broadcast_to(starts[None], (members, rows, width)),
        jnp.ones((members, rows)),
        jnp.ones_like(discounts),
        jnp.zeros((discounts.shape[0], 2, members, rows)),
    )
    last, shown = jax.lax.scan(step, carry, jnp.arange(horizon))
    return last[3], shown
