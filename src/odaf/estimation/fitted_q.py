"""Fitted Q evaluation to a horizon: what actions are worth under a policy, from the rows of a log.

    Q(s, a, h) = n_h q(s, a, h),     n_h = sum_{k < h} gamma^k
    L = mean_B sum ( q(s, a, h) - y / n_h )^2,     y = (r, 1) + gamma (1 - d) Q'(s', a', h - 1),   a' ~ pi(.|s')

(Le et al. 2019; Q' is a slow copy.) h is the number of steps that are left, drawn anew for every row from 1 to H, so
that undiscounted sums up to a horizon are as well defined as discounted ones; Q(., ., 0) = 0. The network gives a mean
by step: its targets have the size of a reward whatever h is. It sees h / H and 1 / n_h, the weight of the reward in y.
It has two outputs, one for rewards, which are shifted to mean 0 and scaled to spread 1 beforehand, and one for rewards
that are all 1: the steps that an episode lasts. With both, the shift is taken back exactly where episodes end, and a
value by step is known. A true end cuts the sum, a time-out does not.

Every member of the ensemble learns from episodes drawn with replacement, and its value is that of their first states:
the spread of the members is a standard error over episodes. All steps are taken: an error on episodes held out would
have to be a Bellman error, whose square counts the chance in what follows as error too, so that where episodes end by
chance the fit which promises least looks best.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.fitting import Batch, Progress, fit, of_rows
from odaf.components.networks import MLP, init_mlp
from odaf.estimation.recorded import discounted_steps

SLOW_RATE = 0.02
STRETCH = 1_000


class FiniteHorizonQ(eqx.Module):
    """q of every member, and what belongs to it."""

    networks: MLP
    sums: Float[Array, " lengths"]  # n_h for h from 0 to H
    discount: Float[Array, ""]
    low: Float[Array, " outputs"]  # the range that rewards allow for q
    high: Float[Array, " outputs"]

    @property
    def horizon(self) -> int:
        """H."""
        return self.sums.shape[0] - 1

    def means(
        self,
        observations: Float[Array, "*m rows obs"],
        actions: Float[Array, "*m rows act"],
        steps: Int[Array, "*m rows"],
    ) -> Float[Array, "members rows outputs"]:
        """q(s, a, h) of every member."""
        left = steps.astype(jnp.float32) / self.horizon
        share = 1.0 / jnp.maximum(self.sums[steps], 1.0)
        return self.networks(jnp.concatenate([observations, actions, left[..., None], share[..., None]], axis=-1))

    def targets(
        self,
        slow: "FiniteHorizonQ",
        rewards: Float[Array, "members rows"],
        terminated: Float[Array, "members rows"],
        next_observations: Float[Array, "members rows obs"],
        next_actions: Float[Array, "members rows act"],
        steps: Int[Array, "members rows"],
    ) -> Float[Array, "members rows outputs"]:
        """y / n_h."""
        found = jnp.clip(
            slow.means(next_observations, next_actions, steps - 1), self.low[None, None], self.high[None, None]
        )
        later = (self.discount * (1.0 - terminated) * self.sums[steps - 1])[..., None] * found
        return (jnp.stack([rewards, jnp.ones_like(rewards)], axis=-1) + later) / self.sums[steps][..., None]


@dataclass(frozen=True, eq=False)
class Transitions:
    """Rows that Q is fitted to, as NumPy arrays in the policy's normalised units.

    Attributes:
        observations: [rows, obs_dim].
        actions: [rows, act_dim].
        rewards: [rows], in the log's unit.
        terminated: [rows].
        next_observations: [rows, obs_dim].
        next_actions: [rows, draws, act_dim], of the policy at the successor.
        episodes: [rows], number of each row's episode.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    next_observations: np.ndarray
    next_actions: np.ndarray
    episodes: np.ndarray

    def at(self, rows: np.ndarray) -> "Transitions":
        """Some of the rows."""
        return Transitions(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class FittedQ:
    """An evaluated policy.

    Attributes:
        model: the ensemble.
        shift: mean of the rewards, in their unit.
        scale: their spread.
        counts: [members, E], how often each member drew an episode.
        loss: L of one member at the end, in squared spreads of the reward.
    """

    model: FiniteHorizonQ
    shift: float
    scale: float
    counts: np.ndarray
    loss: float

    def values(self, observations: np.ndarray, actions: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Q(s, a, h) of every member, in the unit of the rewards, and the steps that an episode lasts.

        Args:
            observations: [rows, obs_dim], normalised.
            actions: [rows, draws, act_dim] in [-1, 1]; the result is the mean over draws.
            steps: [rows], those that are left.

        Returns:
            [2, members, rows] float64.
        """
        total = 0.0
        for draw in range(actions.shape[1]):
            columns = (jnp.asarray(observations), jnp.asarray(actions[:, draw]), jnp.asarray(steps, jnp.int32))
            total = total + of_rows(_means, self.model, columns).astype(np.float64)
        means = np.moveaxis(np.asarray(total) / actions.shape[1], (0, 1, 2), (2, 1, 0))  # rows, members, outputs
        sums = np.asarray(self.model.sums, np.float64)[steps]
        return sums * np.stack([self.scale * means[0] + self.shift * means[1], means[1]])


def fit_q(
    rows: Transitions,
    episodes: int,
    horizon: int,
    discount: float,
    key: PRNGKeyArray,
    *,
    members: int,
    hidden_sizes: tuple[int, ...],
    steps: int,
    batch_size: int,
    learning_rate: float,
    progress: Progress,
) -> FittedQ:
    """Evaluate the policy whose next actions the rows hold.

    Args:
        rows: what to learn from.
        episodes: E, in the log.
        horizon: H.
        discount: gamma; 1 for plain sums.
        key: random key for networks, batches and resampled episodes.
        members: of the ensemble.
        hidden_sizes: widths of the hidden layers.
        steps: gradient steps at most.
        batch_size: rows a step and member.
        learning_rate: step size of Adam.
        progress: called with (steps done, steps in all).

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    key_host, key_init, key_fit = jr.split(key, 3)
    rng = np.random.default_rng(np.asarray(jr.bits(key_host, (4,))))
    shift = float(np.mean(rows.rewards, dtype=np.float64))
    scale = float(np.std(rows.rewards, dtype=np.float64)) or max(abs(shift), 1.0)
    scaled = ((rows.rewards - shift) / scale).astype(np.float32)

    table, counts = _resampled_rows(rows.episodes, episodes, members, rng)
    columns = tuple(
        jnp.asarray(column)
        for column in (
            rows.observations,
            rows.actions,
            scaled,
            rows.terminated.astype(np.float32),
            rows.next_observations,
            rows.next_actions,
        )
    )
    inputs = rows.observations.shape[1] + rows.actions.shape[1] + 2
    model = FiniteHorizonQ(
        init_mlp(key_init, (inputs, *hidden_sizes, 2), members=members, hidden_bias=0.0),
        jnp.asarray(discounted_steps(horizon, discount), jnp.float32),
        jnp.asarray(discount, jnp.float32),
        jnp.asarray([min(float(scaled.min()), 0.0), 0.0], jnp.float32),
        jnp.asarray([max(float(scaled.max()), 0.0), 1.0], jnp.float32),
    )
    nothing = jax.tree.map(lambda _: False, model)
    fitted = fit(
        model,
        _loss,
        columns,
        bootstraps=jnp.asarray(table, jnp.int32),
        members=members,
        trainable=eqx.tree_at(lambda tree: tree.networks, nothing, jax.tree.map(lambda _: True, model.networks)),
        slow_rate=SLOW_RATE,
        steps=steps,
        batch_size=batch_size,
        learning_rate=learning_rate,
        stretch=min(steps, STRETCH),
        schedule="cosine",
        key=key_fit,
        progress=progress,
        what="fitted Q evaluation",
        remedy="lower learning_rate, or check the log for outliers with `odaf data check`",
    )
    return FittedQ(fitted.model, shift, scale, counts, fitted.means["loss"] / members)


def _resampled_rows(
    episode_of_row: np.ndarray, episodes: int, members: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """For every member as many rows as there are, of episodes drawn with replacement; and how often each was drawn."""
    there, starts, lengths = np.unique(episode_of_row, return_index=True, return_counts=True)
    table, counts = [], np.zeros((members, episodes))
    for member in range(members):
        drawn = rng.integers(0, len(there), len(there))
        np.add.at(counts[member], there[drawn], 1.0)
        rows = np.concatenate([np.arange(int(lengths[each])) + starts[each] for each in drawn])
        table.append(np.resize(rng.permutation(rows), len(episode_of_row)))  # no chance but that of the episodes
    return np.concatenate(table), counts


def _loss(
    model: FiniteHorizonQ, batch: Batch, key: PRNGKeyArray, slow: FiniteHorizonQ
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    observations, actions, rewards, terminated, next_observations, next_actions = batch
    key_steps, key_draw = jr.split(key)
    steps = jr.randint(key_steps, rewards.shape, 1, model.horizon + 1)
    draw = jr.randint(key_draw, rewards.shape, 0, next_actions.shape[2])
    chosen = jnp.take_along_axis(next_actions, draw[..., None, None], axis=2)[:, :, 0]
    targets = model.targets(slow, rewards, terminated, next_observations, chosen, steps)
    errors = jnp.square(model.means(observations, actions, steps) - jax.lax.stop_gradient(targets))
    return jnp.sum(jnp.mean(errors, axis=1)), {}


def _means(model: FiniteHorizonQ, batch: Batch) -> Float[Array, "rows members outputs"]:
    return jnp.swapaxes(model.means(*batch), 0, 1)
