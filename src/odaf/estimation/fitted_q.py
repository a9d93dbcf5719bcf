"""Fitted Q evaluation to a horizon: what actions are worth under a policy, from the rows of a log.

    Q(s, a, h) = n_h q(s, a, h),     n_h = sum_{k < h} gamma^k
    L = mean_B sum ( q(s, a, h) - y / n_h )^2,     y = (r, 1) + gamma (1 - d) Q'(s', a', h - 1),   a' ~ pi(.|s')

(Le et al. 2019; Q' is a slow copy.) Several policies are evaluated in one program: P times M networks, one batched
product, of which M belong to each policy. They differ in the actions of a' alone. Several discounts share networks,
each with outputs of its own.

h is the number of steps that are left, drawn anew for every row from 1 to H, so that undiscounted sums up to a horizon
are as well defined as discounted ones; Q(., ., 0) = 0. The network gives a mean by step: its targets have the size of a
reward whatever h is. It sees h / H and 1 / n_h, the weight of the reward in y. It has two outputs a discount, one for
rewards, which are shifted to mean 0 and scaled to spread 1 beforehand, and one for rewards that are all 1: the steps
that an episode lasts. With both, the shift is taken back exactly where episodes end, and a value by step is known. A
true end cuts the sum, a time-out does not.

Every member of an ensemble learns from episodes drawn with replacement, and its value is that of their first states:
the spread of the members is a standard error over episodes. The m-th members of all policies learn from the same
episodes, so that the chance in these cancels where two policies are compared.

Where rows are held out, fitting stops by the Bellman error on these, the mean over all networks. Networks that have
not yet learnt what follows contradict themselves least, so over long horizons it stops far too early;
docs/reference/estimates.md says what it did where values are known.
"""

import functools
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.fitting import Batch, EarlyStopping, Fitted, Progress, fit, of_rows, own
from odaf.components.networks import MLP, init_mlp
from odaf.components.threads import in_threads, parts_of
from odaf.estimation.recorded import discounted_steps

SLOW_RATE = 0.1  # a slower copy carries rewards back over too few steps: docs/reference/estimates.md
STRETCH = 1_000
ODD = 7_919  # spreads numbers of steps over rows
MOST_HELD_OUT = 4_096  # rows


class FiniteHorizonQ(eqx.Module):
    """q of every network, policy after policy, or of some of them, and what belongs to it."""

    networks: MLP
    first: Int[Array, ""]  # number of the first of these networks
    next_actions: Float[Array, "policies _logged _draws _act"]  # none once it is fitted
    sums: Float[Array, "discounts _lengths"]  # n_h for h from 0 to H
    discounts: Float[Array, " discounts"]
    low: Float[Array, " 2"]  # the range that rewards, and ones, allow for q
    high: Float[Array, " 2"]
    members: int = eqx.field(static=True)  # networks of each policy

    @property
    def horizon(self) -> int:
        """H."""
        return self.sums.shape[1] - 1

    def means(
        self,
        observations: Float[Array, "*m rows obs"],
        actions: Float[Array, "*m rows act"],
        steps: Int[Array, "*m rows"],
    ) -> Float[Array, "nets rows discounts 2"]:
        """q(s, a, h) of every network."""
        left = steps.astype(jnp.float32) / self.horizon
        share = jnp.moveaxis(1.0 / jnp.maximum(self.sums[:, steps], 1.0), 0, -1)
        found = self.networks(jnp.concatenate([observations, actions, left[..., None], share], axis=-1))
        return found.reshape(*found.shape[:2], -1, 2)

    def targets(
        self,
        slow: "FiniteHorizonQ",
        rewards: Float[Array, "nets rows"],
        terminated: Float[Array, "nets rows"],
        next_observations: Float[Array, "nets rows obs"],
        next_actions: Float[Array, "nets rows act"],
        steps: Int[Array, "nets rows"],
    ) -> Float[Array, "nets rows discounts 2"]:
        """y / n_h."""
        found = slow.means(next_observations, next_actions, steps - 1)
        found = jnp.clip(found, self.low[None, None, None], self.high[None, None, None])
        before, now = (jnp.moveaxis(self.sums[:, each], 0, -1)[..., None] for each in (steps - 1, steps))
        goes_on = self.discounts[None, None, :, None] * (1.0 - terminated)[..., None, None]
        earned = jnp.stack([rewards, jnp.ones_like(rewards)], axis=-1)[:, :, None]
        return (earned + goes_on * before * found) / now


@dataclass(frozen=True, eq=False)
class Transitions:
    """Rows that Q is fitted to, as NumPy arrays in normalised units.

    Attributes:
        observations: [rows, obs_dim].
        actions: [rows, act_dim].
        rewards: [rows], in the log's unit.
        terminated: [rows].
        next_observations: [rows, obs_dim].
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    next_observations: np.ndarray


@dataclass(frozen=True, eq=False)
class FittedQ:
    """An evaluated policy.

    Attributes:
        model: its ensemble.
        shift: mean of the rewards, in their unit.
        scale: their spread.
        loss: L of one network at the end, in squared spreads of the reward.
    """

    model: FiniteHorizonQ
    shift: float
    scale: float
    loss: float

    def values(self, observations: np.ndarray, actions: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Q(s, a, h) of every member, in the unit of the rewards, and the steps that an episode lasts.

        Args:
            observations: [rows, obs_dim], normalised.
            actions: [rows, draws, act_dim] in [-1, 1]; the result is the mean over draws.
            steps: [rows], those that are left.

        Returns:
            [discounts, 2, members, rows] float64.
        """
        total = 0.0
        for draw in range(actions.shape[1]):
            columns = (jnp.asarray(observations), jnp.asarray(actions[:, draw]), jnp.asarray(steps, jnp.int32))
            total = total + of_rows(_means, self.model, columns).astype(np.float64)
        means = np.moveaxis(np.asarray(total) / actions.shape[1], (0, 1, 2, 3), (3, 2, 0, 1))
        sums = np.asarray(self.model.sums, np.float64)[:, None, None, steps]
        return sums * np.stack([self.scale * means[:, 0] + self.shift * means[:, 1], means[:, 1]], axis=1)


def fit_q(
    rows: Transitions,
    next_actions: np.ndarray,
    member_rows: np.ndarray,
    horizon: int,
    discounts: tuple[float, ...],
    key: PRNGKeyArray,
    *,
    members: int,
    hidden_sizes: tuple[int, ...],
    steps: int,
    batch_size: int,
    learning_rate: float,
    progress: Progress,
    held_out: np.ndarray | None = None,
    patience: int = 1,
) -> list[FittedQ]:
    """Evaluate policies in one compiled program.

    Args:
        rows: what to learn from.
        next_actions: [policies, rows, draws, act_dim], of each policy at the successor.
        member_rows: [members * rows], the rows that the m-th network of every policy learns from, as of
            `recorded.resampled_rows`.
        horizon: H.
        discounts: gamma; 1 for plain sums.
        key: random key for networks and batches.
        members: M, networks of each policy.
        hidden_sizes: widths of the hidden layers.
        steps: gradient steps.
        batch_size: rows a step and network.
        learning_rate: step size of Adam at the start; it falls to zero.
        progress: called with (steps done, steps in all).
        held_out: numbers of rows to measure a Bellman error on, by which fitting stops; none takes all steps.
        patience: checks of that error, one every 1,000 steps, without a new lowest one that end the fit.

    Returns:
        One for each policy, in order.

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    key_init, key_fit = jr.split(key)
    shift = float(np.mean(rows.rewards, dtype=np.float64))
    scale = float(np.std(rows.rewards, dtype=np.float64)) or max(abs(shift), 1.0)
    scaled = ((rows.rewards - shift) / scale).astype(np.float32)

    columns = tuple(
        jnp.asarray(column)
        for column in (
            np.arange(len(scaled), dtype=np.int32),
            rows.observations,
            rows.actions,
            scaled,
            rows.terminated.astype(np.float32),
            rows.next_observations,
        )
    )
    aside, stopping = np.zeros(0, np.int64) if held_out is None else held_out[:MOST_HELD_OUT], None
    if len(aside):
        stopping = EarlyStopping(_bellman_error, len(scaled), len(scaled) + len(aside), patience)
        columns = tuple(jnp.concatenate([column, column[aside]]) for column in columns)
    policies, inputs = len(next_actions), rows.observations.shape[1] + rows.actions.shape[1] + 1 + len(discounts)
    nets = policies * members
    model = FiniteHorizonQ(
        init_mlp(key_init, (inputs, *hidden_sizes, 2 * len(discounts)), members=nets, hidden_bias=0.0),
        jnp.asarray(0, jnp.int32),
        jnp.asarray(next_actions, jnp.float32),
        jnp.asarray([discounted_steps(horizon, discount) for discount in discounts], jnp.float32),
        jnp.asarray(discounts, jnp.float32),
        jnp.asarray([min(float(scaled.min()), 0.0), 0.0], jnp.float32),
        jnp.asarray([max(float(scaled.max()), 0.0), 1.0], jnp.float32),
        members,
    )
    nothing = jax.tree.map(lambda _: False, model)
    trainable = eqx.tree_at(lambda tree: tree.networks, nothing, jax.tree.map(lambda _: True, model.networks))
    bootstraps = jnp.asarray(np.tile(member_rows, policies), jnp.int32)
    parts = 1 if stopping else parts_of(nets)  # which stops all by the mean error of all

    def part(first: int, progress: Progress) -> Fitted[FiniteHorizonQ]:
        return fit(
            _of_networks(model, first, nets // parts),
            _loss,
            columns,
            rows=len(member_rows) // members,
            bootstraps=bootstraps,
            members=nets // parts,
            part_of=(first, nets),
            trainable=trainable,
            slow_rate=SLOW_RATE,
            steps=steps,
            batch_size=batch_size,
            learning_rate=learning_rate,
            stretch=min(steps, STRETCH),
            schedule="cosine",
            stopping=stopping,
            key=key_fit,
            progress=progress,
            what="fitted Q evaluation",
            remedy="lower learning_rate, or check the log for outliers with `odaf data check`",
        )

    firsts = range(0, nets, nets // parts)
    fitted = in_threads([functools.partial(part, first) for first in firsts], progress)
    loss = sum(each.means["loss"] for each in fitted) / nets
    networks = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *[each.model.networks for each in fitted])
    small = eqx.tree_at(lambda tree: (tree.networks, tree.next_actions), model, (networks, model.next_actions[:, :0]))
    return [FittedQ(_of_networks(small, policy * members, members), shift, scale, loss) for policy in range(policies)]


def _of_networks(model: FiniteHorizonQ, first: int, count: int) -> FiniteHorizonQ:
    some = jax.tree.map(lambda leaf: leaf[first : first + count], model.networks)
    return eqx.tree_at(lambda tree: (tree.networks, tree.first), model, (some, jnp.asarray(first, jnp.int32)))


def _loss(
    model: FiniteHorizonQ, batch: Batch, key: PRNGKeyArray, slow: FiniteHorizonQ
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    numbers, observations, actions, rewards, terminated, next_observations = batch
    key_steps, key_draw = jr.split(key)
    policies, _, draws, _ = model.next_actions.shape
    nets, size = rewards.shape
    everyone = policies * model.members, size
    steps = own(jr.randint(key_steps, everyone, 1, model.horizon + 1), model.first, nets)
    draw = own(jr.randint(key_draw, everyone, 0, draws), model.first, nets)
    policy = (model.first + jnp.arange(nets)) // model.members
    chosen = model.next_actions[policy[:, None], numbers, draw]
    targets = model.targets(slow, rewards, terminated, next_observations, chosen, steps)
    errors = jnp.square(model.means(observations, actions, steps) - jax.lax.stop_gradient(targets))
    return jnp.sum(jnp.mean(errors, axis=1)), {}


def _bellman_error(model: FiniteHorizonQ, batch: Batch) -> Float[Array, " rows"]:
    """Mean over networks and outputs, each row with a number of steps of its own."""
    numbers, observations, actions, rewards, terminated, next_observations = batch
    nets = model.networks.weights[0].shape[0]
    chosen = jnp.repeat(model.next_actions[:, numbers, 0], model.members, axis=0)
    steps = 1 + numbers * ODD % model.horizon
    rewards, terminated, next_observations, steps, observations, actions = (
        jnp.broadcast_to(column[None], (nets, *column.shape))
        for column in (rewards, terminated, next_observations, steps, observations, actions)
    )
    targets = model.targets(model, rewards, terminated, next_observations, chosen, steps)
    return jnp.mean(jnp.square(model.means(observations, actions, steps) - targets), axis=(0, 2, 3))


def _means(model: FiniteHorizonQ, batch: Batch) -> Float[Array, "rows members discounts 2"]:
    return jnp.swapaxes(model.means(*batch), 0, 1)
