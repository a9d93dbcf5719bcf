"""Maximum mean discrepancies pair by pair, multipliers step by step."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from golden import tiny
from odaf.components.discrepancy import discrepancy, squared_discrepancy
from odaf.components.duals import ascended, ascended_directly
from odaf.components.trained import Trained

RNG = np.random.default_rng(0)
X, Y = 2.0 * RNG.normal(size=(3, 5, 2)), 1.0 + RNG.normal(size=(4, 5, 2))


def _kernel(kernel: str, x: np.ndarray, y: np.ndarray, width: float) -> float:
    total = 0.0
    for a, b in zip(x, y, strict=True):
        total += (a - b) ** 2 if kernel == "gaussian" else abs(a - b)
    return np.exp(-total / (2.0 * width))


def _squared(kernel: str, x: np.ndarray, y: np.ndarray, width: float) -> np.ndarray:
    rows = []
    for row in range(x.shape[1]):
        first, second = x[:, row], y[:, row]
        within = np.mean([_kernel(kernel, a, b, width) for a, b in itertools.product(first, first)])
        within += np.mean([_kernel(kernel, a, b, width) for a, b in itertools.product(second, second)])
        rows.append(within - 2.0 * np.mean([_kernel(kernel, a, b, width) for a, b in itertools.product(first, second)]))
    return np.array(rows)


@pytest.mark.parametrize("kernel", ["gaussian", "laplacian"])
def test_every_pair_counts_the_width_is_not_squared_and_the_root_is_taken(kernel):
    with tiny.exactly():
        x, y, expected = tiny.floats(X), tiny.floats(Y), _squared(kernel, X, Y, 3.0)

        @jax.jit
        def everything(x):
            slope = jax.grad(lambda x: jnp.sum(discrepancy(x, y, kernel, 3.0)))(x)
            return squared_discrepancy(x, y, kernel, 3.0), discrepancy(x, y, kernel, 3.0), slope

        squared, root, slope = everything(x)
        np.testing.assert_allclose(squared, expected, rtol=1e-10)
        np.testing.assert_allclose(root, np.sqrt(expected + 1e-6), rtol=1e-10)
        tiny.assert_slopes(slope, lambda x: float(np.sum(np.sqrt(_squared(kernel, x, Y, 3.0) + 1e-6))), x)


def test_equal_samples_are_a_thousandth_apart_and_the_slope_there_is_finite():
    x = jnp.asarray(X, jnp.float32)

    @jax.jit
    def both(x, y):
        return discrepancy(x, y, "laplacian", 1.0), jax.grad(lambda y: jnp.sum(discrepancy(x, y, "laplacian", 1.0)))(y)

    value, slope = both(x, x)
    np.testing.assert_allclose(value, 1e-3, rtol=0.1)
    assert bool(jnp.isfinite(slope).all())


def _slope_kept(dual) -> float:
    return float(jax.tree.leaves(dual.moments)[1])  # after the count: a tenth of the first slope


def test_a_multiplier_climbs_while_the_constraint_is_broken_and_stays_in_its_bounds():
    start = Trained.begin(jnp.asarray(0.5), slow=False)
    up, down = (ascended(start, jnp.asarray(sign * 2.0), 1e-2) for sign in (1.0, -1.0))
    np.testing.assert_allclose([up.now, down.now], [0.51, 0.49], rtol=1e-5)  # Adam's first step has the rate's size
    np.testing.assert_allclose(_slope_kept(up), -0.1 * np.exp(0.5) * 2.0, rtol=1e-6)  # the slope is alpha g
    edge = Trained.begin(jnp.asarray(9.999), slow=False)
    assert float(ascended(edge, jnp.asarray(1.0), 1.0).now) == 10.0
    assert float(ascended(start, jnp.asarray(-1.0), 100.0).now) == -5.0
    plain = ascended_directly(start, jnp.asarray(2.0), 1e-2, (0.0, 0.505))
    assert float(plain.now) == np.float32(0.505)
    np.testing.assert_allclose(_slope_kept(plain), -0.2, rtol=1e-6)  # the slope is g
