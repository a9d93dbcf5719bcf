"""Maximum mean discrepancy: how far two samples are apart, seen through a kernel (Gretton et al. 2012).

    MMD^2 = mean_ij k(x_i, x_j) + mean_ij k(y_i, y_j) - 2 mean_ij k(x_i, y_j)

    gaussian   k(x, y) = exp( - ||x - y||^2 / (2 width) )
    laplacian  k(x, y) = exp( - |x - y|_1 / (2 width) ),    the distance summed over dimensions

All pairs count, those of a point with itself too. The width stands as it is, where others square it: BEAR's code has it
so, and its published widths and thresholds are for that.
"""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from odaf.components.numbers import Number

Kernel = Literal["gaussian", "laplacian"]
ROOT_EPSILON = 1e-6


def squared_discrepancy(
    first: Float[Array, "draws rows width"], second: Float[Array, "others rows width"], kernel: Kernel, width: Number
) -> Float[Array, " rows"]:
    """MMD^2 between the draws of every row; gradients flow to both samples."""

    def likeness(x: Float[Array, "m rows dim"], y: Float[Array, "n rows dim"]) -> Float[Array, " rows"]:
        gaps = x[:, None] - y[None, :]
        distance = jnp.sum(jnp.square(gaps) if kernel == "gaussian" else jnp.abs(gaps), axis=-1)
        return jnp.mean(jnp.exp(-distance / (2.0 * width)), axis=(0, 1))

    return likeness(first, first) + likeness(second, second) - 2.0 * likeness(first, second)


def discrepancy(
    first: Float[Array, "draws rows width"], second: Float[Array, "others rows width"], kernel: Kernel, width: Number
) -> Float[Array, " rows"]:
    """MMD between the draws of every row: sqrt( MMD^2 + 1e-6 ), what BEAR's threshold is for.

    1e-6 inside the root keeps the gradient finite where both samples agree.
    """
    return jnp.sqrt(squared_discrepancy(first, second, kernel, width) + ROOT_EPSILON)
