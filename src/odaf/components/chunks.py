"""A mean over many rows, worked through in chunks that fit a processor's cache."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

ROWS_AT_ONCE = 512

# (parameters, chunk of the rows, constants) -> loss, figures to watch
ChunkLoss = Callable[[Any, Any, Any], tuple[Float[Array, ""], PyTree[Float[Array, ""]]]]


def draws_at_once(draws: int, rows: int) -> int:
    """How many of `draws` copies of `rows` rows belong to one chunk: an even share, of `ROWS_AT_ONCE` rows at most.

    One at the least. On an accelerator all of them, since it is the faster the more it is given.
    """
    if jax.default_backend() != "cpu":
        return draws
    return max([size for size in range(1, draws + 1) if draws % size == 0 and size * rows <= ROWS_AT_ONCE], default=1)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def mean_over_chunks(
    loss: ChunkLoss, parameters: PyTree, chunks: PyTree[Array], constants: PyTree[Array]
) -> tuple[Float[Array, ""], Any]:
    """The mean over chunks of a loss and of the figures that go with it.

    Where its gradient is wanted, a chunk's gradient is formed right after its loss, while the activations are still in
    the cache, and added up; without this, all chunks would go forward first. Reverse mode only. The gradient reaches
    the parameters; rows, constants and figures are left out.

    Args:
        loss: of one chunk; hashable, without arrays of its own.
        parameters: what the loss is differentiated in; arrays of floating-point numbers.
        chunks: arrays with a leading axis [chunks].
        constants: handed to every call.
    """

    def add(total: Any, chunk: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, loss(parameters, chunk, constants)), None

    return _summed(add, jax.eval_shape(loss, parameters, _first(chunks), constants), chunks)


def _forward(loss: ChunkLoss, parameters: PyTree, chunks: PyTree, constants: PyTree) -> tuple[Any, Any]:
    both = jax.value_and_grad(loss, has_aux=True)

    def add(total: Any, chunk: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, both(parameters, chunk, constants)), None

    found, gradient = _summed(add, jax.eval_shape(both, parameters, _first(chunks), constants), chunks)
    return found, (gradient, chunks, constants)


def _backward(loss: ChunkLoss, residuals: Any, cotangents: Any) -> tuple[Any, Any, Any]:
    del loss
    gradient, chunks, constants = residuals
    scaled = jax.tree.map(lambda leaf: cotangents[0] * leaf, gradient)
    return scaled, jax.tree.map(jnp.zeros_like, chunks), jax.tree.map(jnp.zeros_like, constants)


def _summed(add: Callable[[Any, Any], tuple[Any, None]], shapes: Any, chunks: PyTree) -> Any:
    count = jax.tree.leaves(chunks)[0].shape[0]
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    total, _ = jax.lax.scan(add, nothing, chunks)
    return jax.tree.map(lambda leaf: leaf / count, total)


def _first(chunks: PyTree) -> PyTree:
    return jax.tree.map(lambda leaf: leaf[0], chunks)


mean_over_chunks.defvjp(_forward, _backward)


def gradient_over_chunks(
    loss: Callable[[Any, Any], tuple[Float[Array, ""], PyTree[Array]]], parameters: PyTree, chunks: PyTree[Array]
) -> tuple[Any, Any]:
    """Gradient of the mean over chunks of a loss, and what goes with the loss of each chunk.

    As `mean_over_chunks`, where the gradient itself is asked for: the loss may be any function.

    Args:
        loss: of the parameters and one chunk: the loss, and arrays to keep.
        parameters: what the loss is differentiated in; arrays of floating-point numbers.
        chunks: arrays with a leading axis [chunks].

    Returns:
        The gradient, and the arrays with a leading axis [chunks].
    """

    def add(total: Any, chunk: Any) -> tuple[Any, Any]:
        gradient, kept = jax.grad(loss, has_aux=True)(parameters, chunk)
        return jax.tree.map(jnp.add, total, gradient), kept

    total, kept = jax.lax.scan(add, jax.tree.map(jnp.zeros_like, parameters), chunks)
    count = jax.tree.leaves(chunks)[0].shape[0]
    return jax.tree.map(lambda leaf: leaf / count, total), kept
