"""Rollouts of a model of transitions in one compiled scan, and the ring of rows that they are kept in."""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from odaf.components.dynamics.terminations import Termination
from odaf.components.dynamics.transition_ensemble import TransitionEnsemble, Uncertainty
from odaf.data.transitions import Transitions

# (states, key) -> actions in [-1, 1], drawn
Behave = Callable[[Array, PRNGKeyArray], Array]


class Rolled(eqx.Module):
    """What a rollout saw: all rows of its first step, then all of its second, and so on."""

    rows: Transitions  # [steps * starts]
    kept: Bool[Array, " rows"]  # whether the rollout still ran; all else of other rows is without meaning
    doubt: Float[Array, " rows"]  # u(s, a), in the log's units; 0 where none is asked for


def rollout(
    model: TransitionEnsemble,
    behave: Behave,
    starts: Float[Array, "starts obs_dim"],
    steps: int,
    terminates: Termination,
    key: PRNGKeyArray,
    doubts: Uncertainty | None = None,
) -> Rolled:
    """Plays a policy in a model, every row from an elite of its own that is drawn anew at each step.

    A row that ends is kept and is its rollout's last one. One with a number that is not finite is not kept and ends its
    rollout too. Shapes are fixed: rollouts that have ended go on unseen.

    Args:
        model: of transitions.
        behave: the policy.
        starts: first states, in learner's units.
        steps: of each rollout, at most.
        terminates: of transitions in the log's units.
        key: random key.
        doubts: what measures the uncertainty of each step, by all members; None evaluates one member a row.
    """

    def step(carry: tuple[Array, Array], number: Int[Array, ""]) -> tuple[tuple[Array, Array], Rolled]:
        states, runs = carry
        key_act, key_next = jr.split(jr.fold_in(key, number))
        actions = behave(states, key_act)
        if doubts is None:
            following, rewards = model.draw(states, actions, key_next)
            doubt = jnp.zeros_like(rewards)
        else:
            following, rewards, doubt = model.draw_and_doubt(states, actions, key_next, doubts)
        ends = terminates(model.in_user_units(states), actions, model.in_user_units(following))
        kept = runs & jnp.all(jnp.isfinite(following), axis=-1) & jnp.isfinite(rewards)
        rows = Transitions(states, actions, rewards, following, ends.astype(rewards.dtype))
        return (following, kept & ~ends), Rolled(rows, kept, doubt)

    _, rolled = jax.lax.scan(step, (starts, jnp.ones(starts.shape[0], bool)), jnp.arange(steps))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), rolled)


class Ring(eqx.Module):
    """The last rows that were pushed, as many as there is room for."""

    rows: Transitions  # [capacity]; zero where nothing has been yet
    head: Int[Array, ""]  # place of the next row
    filled: Int[Array, ""]  # rows that are there

    @classmethod
    def empty(cls, capacity: int, obs_dim: int, act_dim: int) -> "Ring":
        """Room for so many rows."""
        number = functools.partial(jnp.zeros, capacity)
        states = jnp.zeros((capacity, obs_dim)), jnp.zeros((capacity, obs_dim))
        rows = Transitions(states[0], jnp.zeros((capacity, act_dim)), number(), states[1], number())
        return cls(rows, jnp.asarray(0, jnp.int32), jnp.asarray(0, jnp.int32))

    @property
    def capacity(self) -> int:
        """Rows that there is room for."""
        return self.rows.rewards.shape[0]

    def pushed(self, rows: Transitions, kept: Bool[Array, " rows"]) -> "Ring":
        """With the kept ones of some rows behind those there are, in their order, over the oldest if need be.

        There must be room for all of `rows`, kept or not.
        """
        counted = jnp.cumsum(kept.astype(jnp.int32))
        places = jnp.where(kept, (self.head + counted - 1) % self.capacity, self.capacity)  # beyond the end: nowhere
        written = jax.tree.map(lambda ring, new: ring.at[places].set(new, mode="drop"), self.rows, rows)
        head = (self.head + counted[-1]) % self.capacity
        return Ring(written, head, jnp.minimum(self.filled + counted[-1], self.capacity))

    def sample(self, key: PRNGKeyArray, count: int) -> Transitions:
        """So many of the rows that are there, with replacement; there must be one at least."""
        places = jr.randint(key, (count,), 0, jnp.maximum(self.filled, 1))
        return jax.tree.map(lambda column: column[places], self.rows)
