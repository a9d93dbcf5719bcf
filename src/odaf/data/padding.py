"""Rows of narrower data sets beside those of wider ones: zeros where a data set has no column.

Trainings on robots of different sizes can be lanes of one compiled program if all have the widths of the widest. What a
lane does not have is 0 in its rows, its networks have zero weights there (`odaf.training.widths`), and a learner that
draws noise or averages over dimensions asks the batch (`odaf.data.transitions.Transitions`), which knows the lane's own
width. So a padded lane computes what it computes alone, up to rounding.
"""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray


class Padding(eqx.Module):
    """How many of its actions' dimensions are a lane's own: the first ones."""

    own: Int[Array, "*lanes"]
    widths: tuple[int, ...] = eqx.field(static=True)  # numbers of dimensions that lanes of the program have

    def mask(self, act_dim: int) -> Bool[Array, " act_dim"]:
        """Which dimensions of the padded actions are the lane's own."""
        return jnp.arange(act_dim) < self.own

    def normal(self, key: PRNGKeyArray, rows: int, act_dim: int) -> Float[Array, "rows act_dim"]:
        """The standard normal draws that a lane alone gets from this key, bit for bit, beside zeros.

        A draw's bits depend on the shape that it is part of, so each width that occurs is drawn and the own one taken.
        """
        found = jnp.zeros((rows, act_dim))
        for width in self.widths:
            drawn = jnp.pad(jr.normal(jr.clone(key), (rows, width)), ((0, 0), (0, act_dim - width)))
            found = jnp.where(self.own == width, drawn, found)
        return found
