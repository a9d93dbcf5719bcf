"""Batches that mix two data sets afresh at every draw, so that all rows of both stay within reach."""

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, PRNGKeyArray

from odaf.data.transitions import Transitions
from odaf.errors import DatasetError


def joined_columns(expert: Transitions, other: Transitions) -> tuple[Transitions, int]:
    """The expert's rows followed by the other's, and how many of them are the expert's; what `sample_mixed` draws from.

    Observations of both must be normalised with the same numbers.

    Raises:
        DatasetError: the rows differ in width.
    """
    for name in ("observations", "actions"):
        widths = getattr(expert, name).shape[1], getattr(other, name).shape[1]
        if widths[0] != widths[1]:
            raise DatasetError(
                f"mixed batches: {name} have {widths[0]} columns in one data set, {widths[1]} in the other"
            )
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), expert, other), expert.rewards.shape[0]


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
