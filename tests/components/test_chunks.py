"""A mean that is worked through in chunks: the value and the gradient of the whole."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from golden import tiny
from odaf.components.chunks import draws_at_once, mean_over_chunks


def _loss(parameters, chunk, constants):
    matrix, offset = parameters
    rows, signs = chunk
    values = jnp.tanh(rows @ matrix + offset[None]) * signs[:, None] * constants
    return jnp.mean(jnp.square(values)), {"value": jnp.mean(values)}


def _problem():
    random = np.random.default_rng(0)
    parameters = (tiny.floats(random.normal(size=(3, 2))), tiny.floats(random.normal(size=2)))
    rows, signs = tiny.floats(random.normal(size=(12, 3))), tiny.floats(random.choice([-1.0, 1.0], size=12))
    return parameters, (rows, signs), tiny.floats(1.7)


@pytest.mark.parametrize("count", [1, 3, 6])
def test_parts_together_are_the_whole(count):
    with tiny.exactly():
        parameters, whole, constant = _problem()
        chunks = jax.tree.map(lambda column: column.reshape(count, 12 // count, *column.shape[1:]), whole)

        def by_parts(parameters) -> Any:
            return mean_over_chunks(_loss, parameters, chunks, constant)

        expected, slopes = jax.jit(jax.value_and_grad(_loss, has_aux=True))(parameters, whole, constant)
        tiny.assert_close(jax.jit(by_parts)(parameters), expected, rtol=1e-12)
        found, gradient = jax.jit(jax.value_and_grad(lambda p: (3.0 * by_parts(p)[0], by_parts(p)[1]), has_aux=True))(
            parameters
        )
        tiny.assert_close(found, (3.0 * expected[0], expected[1]), rtol=1e-12)
        tiny.assert_close(gradient, jax.tree.map(lambda slope: 3.0 * slope, slopes), rtol=1e-12)


@pytest.mark.parametrize(
    ("draws", "rows", "together"), [(20, 256, 2), (20, 1000, 1), (20, 100, 5), (7, 256, 1), (10, 4, 10)]
)
def test_parts_are_even_and_fit_the_cache(draws, rows, together, monkeypatch):
    assert draws_at_once(draws, rows) == together
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert draws_at_once(draws, rows) == draws
