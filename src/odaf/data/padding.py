"""Rows of narrower data sets beside those of wider ones: zeros where a data set has no column.

Trainings on robots of different sizes can be lanes of one compiled program if all have the widths of the widest. What a
lane does not have is 0 in its rows, its networks have zero weights there (`odaf.training.widths`), and a learner that
draws noise or averages over dimensions asks the batch (`odaf.data.transitions.Transitions`), which knows the lane's own
width. So a padded lane computes what it computes alone, up to rounding.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray


class Padding(eqx.Module):
    """How many of its dimensions are a lane's own: the first ones."""

    states: Int[Array, "*lanes"]
    actions: Int[Array, "*lanes"]
    widths: tuple[tuple[int, int], ...] = eqx.field(static=True)  # of states and actions that the program's lanes have

    def mask(self, act_dim: int) -> Bool[Array, " act_dim"]:
        """Which dimensions of the padded actions are the lane's own."""
        return jnp.arange(act_dim) < self.actions

    def normal(self, key: PRNGKeyArray, rows: int, act_dim: int) -> Float[Array, "rows act_dim"]:
        """The standard normal draws that a lane alone gets from this key, bit for bit, beside zeros."""
        widths = {actions for _, actions in self.widths}
        return _own(self.actions, widths, lambda width: jr.normal(jr.clone(key), (rows, width)), act_dim)

    def over_states(self, draw: Callable[[int], Float[Array, "..."]], obs_dim: int) -> Float[Array, "... obs_dim"]:
        """What a lane alone draws for its states, bit for bit, beside zeros.

        Args:
            draw: called with a number of dimensions; the result's last axis has as many. It clones its key.
            obs_dim: of the padded states.
        """
        return _own(self.states, {states for states, _ in self.widths}, draw, obs_dim)


def _own(own: Array, widths: set[int], draw: Callable[[int], Array], wide: int) -> Array:
    """A draw's bits depend on the shape that it is part of: each width that occurs is drawn, and the own one taken."""
    found = None
    for width in sorted(widths):
        drawn = draw(width)
        drawn = jnp.pad(drawn, [*[(0, 0)] * (drawn.ndim - 1), (0, wide - width)])
        found = drawn if found is None else jnp.where(own == width, drawn, found)
    assert found is not None, "a program has lanes"
    return found
