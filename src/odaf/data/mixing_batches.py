"""Batches that mix two data sets afresh at every draw, so that all rows of both stay within reach."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, PRNGKeyArray

from odaf.data.transitions import Transitions


class MixedColumns(eqx.Module):
    """All columns of a data set of two parts, and how a batch is drawn from them."""

    columns: Transitions  # the first part's rows, then the second's
    border: int = eqx.field(static=True)  # rows of the first part
    ratio: float = eqx.field(static=True)  # share of the second part


def sample_mixed(
    columns: Transitions, border: int, ratio: float, key: PRNGKeyArray | Array, batch_size: int
) -> Transitions:
    """Draws rows with replacement, each from the poorer part with probability `ratio`, else from the expert's part.

    On average a batch is composed like the static mixture of `odaf.data.mixing`. Yet that one keeps only the first rows
    of the expert file, a tenth of them at ratio 0.9, while here every expert row may be drawn: an easier task at high
    ratios, and scores on the two must not be compared. Usable inside `jit`, `scan` and `vmap`; costs what a uniform
    draw costs.

    Args:
        columns: the expert's rows, then the other's.
        border: number of the expert's rows.
        ratio: share of rows from the poorer part, in [0, 1].
        key: random key; the rows are a function of it alone.
        batch_size: rows to draw.

    Source:
        The released code of OSR draws a batch of each part and exchanges row by row with probability `ratio`.
    """
    key_part, key_row = jr.split(key)
    poorer = jr.bernoulli(key_part, ratio, (batch_size,))
    low = jnp.where(poorer, border, 0)
    high = jnp.where(poorer, columns.rewards.shape[0], border)
    rows = jr.randint(key_row, (batch_size,), low, high)
    return jax.tree.map(lambda column: column[rows], columns)
