"""A mean over many rows, worked through in parts that fit a processor's cache."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

ROWS_AT_ONCE = 512

# (parameters, part of the rows, constants) -> loss, figures to watch
PartLoss = Callable[[Any, Any, Any], tuple[Float[Array, ""], PyTree[Float[Array, ""]]]]


def draws_at_once(draws: int, rows: int) -> int:
    """How many of `draws` copies of `rows` rows belong to one part: an even share, of `ROWS_AT_ONCE` rows at most.

    One at the least. On an accelerator all of them, since it is the faster the more it is given.
    """
    if jax.default_backend() != "cpu":
        return draws
    return max([size for size in range(1, draws + 1) if draws % size == 0 and size * rows <= ROWS_AT_ONCE], default=1)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def mean_over_parts(
    loss: PartLoss, parameters: PyTree, parts: PyTree[Array], constants: PyTree[Array]
) -> tuple[Float[Array, ""], Any]:
    """The mean over parts of a loss and of the figures that go with it.

    Where its gradient is wanted, a part's gradient is formed right after its loss, while the activations are still in
    the cache, and added up; without this, all parts would go forward first. Reverse mode only. The gradient reaches the
    parameters; rows, constants and figures are left out.

    Args:
        loss: of one part; hashable, without arrays of its own.
        parameters: what the loss is differentiated in; arrays of floating-point numbers.
        parts: arrays with a leading axis [parts].
        constants: handed to every call.
    """

    def add(total: Any, part: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, loss(parameters, part, constants)), None

    return _summed(add, jax.eval_shape(loss, parameters, _first(parts), constants), parts)


def _forward(loss: PartLoss, parameters: PyTree, parts: PyTree, constants: PyTree) -> tuple[Any, Any]:
    both = jax.value_and_grad(loss, has_aux=True)

    def add(total: Any, part: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, both(parameters, part, constants)), None

    found, gradient = _summed(add, jax.eval_shape(both, parameters, _first(parts), constants), parts)
    return found, (gradient, parts, constants)


def _backward(loss: PartLoss, residuals: Any, cotangents: Any) -> tuple[Any, Any, Any]:
    del loss
    gradient, parts, constants = residuals
    scaled = jax.tree.map(lambda leaf: cotangents[0] * leaf, gradient)
    return scaled, jax.tree.map(jnp.zeros_like, parts), jax.tree.map(jnp.zeros_like, constants)


def _summed(add: Callable[[Any, Any], tuple[Any, None]], shapes: Any, parts: PyTree) -> Any:
    count = jax.tree.leaves(parts)[0].shape[0]
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    total, _ = jax.lax.scan(add, nothing, parts)
    return jax.tree.map(lambda leaf: leaf / count, total)


def _first(parts: PyTree) -> PyTree:
    return jax.tree.map(lambda leaf: leaf[0], parts)


mean_over_parts.defvjp(_forward, _backward)
