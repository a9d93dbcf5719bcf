"""Networks against their formula, one member at a time, and where their parameters start."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax.test_util import check_grads

from golden import networks, tiny
from odaf.components.networks import init_mlp

SIZES = (4, 6, 5, 3)


def _network(**settings):
    return tiny.filled(jax.eval_shape(lambda: init_mlp(jr.key(0), SIZES, **settings)))


@pytest.mark.parametrize(("norm", "activation"), [("none", "relu"), ("layer", "relu"), ("layer", "silu")])
def test_a_network_computes_its_formula(norm, activation):
    with tiny.exactly():
        network = _network(norm=norm, activation=activation)
        rows = np.random.default_rng(1).normal(size=(7, 4))
        np.testing.assert_allclose(network(jnp.asarray(rows)), networks.mlp(network, rows), rtol=1e-10)


@pytest.mark.parametrize("norm", ["none", "layer"])
def test_a_stack_shows_the_same_rows_to_every_member_or_each_its_own(norm):
    with tiny.exactly():
        stack = _network(members=3, norm=norm)
        rows = np.random.default_rng(1).normal(size=(3, 7, 4))
        for given, of_member in ((rows[0], lambda _: rows[0]), (rows, lambda member: rows[member])):
            expected = [networks.mlp(stack, of_member(member), member) for member in range(3)]
            np.testing.assert_allclose(stack(jnp.asarray(given)), np.stack(expected), rtol=1e-10)


@pytest.mark.parametrize("members", [None, 3])
def test_derivatives_of_a_normalised_network_are_those_of_its_values(members):
    """First and second, forward and reverse, against finite differences in double precision."""
    with tiny.exactly():
        network = _network(norm="layer", activation="silu", members=members)
        rows = jnp.asarray(np.random.default_rng(1).normal(size=(7, 4)))

        def as_arrays(function):  # the checker hands over NumPy's arrays
            return jax.jit(lambda *arguments: function(*jax.tree.map(jnp.asarray, arguments)))

        def values(network, rows):
            return network(rows)

        def by_pullback(network, rows):
            return jax.vjp(values, network, rows)[1](along_values)

        def by_pushforward(network, rows):
            return jax.jvp(values, (network, rows), along_arguments)[1]

        rng = np.random.default_rng(2)
        along_values = jnp.asarray(rng.normal(size=jax.eval_shape(values, network, rows).shape))
        along_arguments = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), (network, rows))
        for function in (values, by_pullback, by_pushforward):
            check_grads(as_arrays(function), (network, rows), order=1, atol=1e-6, rtol=1e-6, eps=1e-5)


def test_single_precision_stays_close_to_the_formula():
    network = _network(norm="layer")
    rows = np.random.default_rng(1).normal(size=(50, 4)).astype(np.float32)
    np.testing.assert_allclose(network(jnp.asarray(rows)), networks.mlp(network, rows), rtol=1e-4, atol=1e-5)


def test_parameters_start_where_the_authors_of_the_family_start_them():
    stack, plain = jax.jit(
        lambda: (
            init_mlp(jr.key(0), (4, 300, 200, 2), members=5, output_bound=3e-3),
            init_mlp(jr.key(1), (4, 300, 2)),
        )
    )()
    for weight, bound in zip(stack.weights, (4**-0.5, 300**-0.5, 3e-3), strict=True):
        largest = float(np.max(np.abs(weight)))
        assert 0.98 * bound < largest <= bound * 1.000001, "uniform in plus or minus one over the root of the fan-in"
    assert all(np.all(np.asarray(bias) == np.float32(0.1)) for bias in stack.biases[:-1])
    assert 0 < float(np.max(np.abs(stack.biases[-1]))) <= 3e-3
    assert float(np.max(np.abs(plain.weights[-1]))) > 0.9 * 300**-0.5
    assert np.all(np.asarray(plain.biases[-1]) == 0.0)

    first = np.asarray(stack.weights[0]).reshape(5, -1)  # 1,200 numbers a member: a correlation deviates by 0.03
    assert np.abs(np.corrcoef(first)[np.triu_indices(5, 1)]).max() < 0.15, "members are independent"


def _rounded(numbers, products):
    if products == "bfloat16":
        return np.asarray(numbers, dtype=jnp.bfloat16).astype(np.float64)
    fraction, exponent = np.frexp(numbers)  # TF32: a leading digit and ten more
    return np.ldexp(np.rint(fraction * 2.0**11), exponent - 11)


@pytest.mark.parametrize(
    ("shape", "products"), [((7, 5), "bfloat16"), ((3, 7, 5), "bfloat16"), ((7, 5), "tensorfloat32")]
)
def test_rounded_products_round_their_factors_and_nothing_else(shape, products):
    """Through one hidden product, forward and backward; everything else is worked out in double precision."""
    stack = jax.jit(lambda: init_mlp(jr.key(2), (5, 6, 8, 1), members=3, products=products))()
    rows = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    slopes = np.random.default_rng(2).normal(size=(3, 7)).astype(np.float32)
    values, pull_back = jax.vjp(lambda stack, rows: stack(rows)[..., 0], stack, jnp.asarray(rows))
    gradient, row_gradient = pull_back(jnp.asarray(slopes))

    row_sums = np.zeros(rows.shape)
    for k in range(3):
        w = [np.asarray(weight[k], np.float64) for weight in stack.weights]
        b = [np.asarray(bias[k], np.float64) for bias in stack.biases]
        x = rows if rows.ndim == 2 else rows[k]
        first = np.maximum(x @ w[0] + b[0], 0.0)
        second = np.maximum(_rounded(first, products) @ _rounded(w[1], products) + b[1], 0.0)
        np.testing.assert_allclose(values[k], (second @ w[2] + b[2])[:, 0], atol=3e-6)
        back = (slopes[k][:, None] @ w[2].T) * (second > 0.0)
        np.testing.assert_allclose(
            gradient.weights[1][k], _rounded(first, products).T @ _rounded(back, products), atol=3e-6
        )
        through = (_rounded(back, products) @ _rounded(w[1], products).T) * (first > 0.0)
        np.testing.assert_allclose(gradient.weights[0][k], x.T @ through, atol=3e-6)
        if rows.ndim == 2:
            row_sums += through @ w[0].T
        else:
            row_sums[k] = through @ w[0].T
    np.testing.assert_allclose(row_gradient, row_sums, atol=3e-6)


@pytest.mark.parametrize("products", ["bfloat16", "tensorfloat32"])
def test_rounded_products_are_compiled_for_rows_that_members_share(products):
    stack = jax.jit(lambda: init_mlp(jr.key(2), (5, 6, 8, 1), members=3, products=products))()
    rows, slopes = jr.normal(jr.key(3), (7, 5)), jr.normal(jr.key(4), (3, 7))

    def both(stack, rows):
        values, pull_back = jax.vjp(lambda stack, rows: stack(rows)[..., 0], stack, rows)
        return values, pull_back(slopes)

    for compiled, known in zip(
        jax.tree.leaves(jax.jit(both)(stack, rows)), jax.tree.leaves(both(stack, rows)), strict=True
    ):
        np.testing.assert_allclose(compiled, known, atol=2e-2)


def test_rounding_is_felt_and_small():
    exact, finer, coarser = (
        jax.jit(lambda p=p: init_mlp(jr.key(2), (5, 64, 64, 1), products=p))()
        for p in ("float32", "tensorfloat32", "bfloat16")
    )
    rows = jr.normal(jr.key(3), (50, 5))
    expected, *rounded = (
        np.asarray(jax.jit(lambda rows, each=each: each(rows))(rows)) for each in (exact, finer, coarser)
    )
    largest = [np.abs(expected - found).max() / np.abs(expected).max() for found in rounded]
    assert 1e-5 < largest[0] < 2e-3 and 2e-3 < largest[1] < 2e-2


def test_means_of_layer_normalisation_are_in_full_precision_whatever_products_are():
    """Forward and backward, where JAX is told to round products as a GPU does by itself."""
    stack = jax.jit(lambda: init_mlp(jr.key(2), (5, 8, 8, 1), norm="layer"))()
    with jax.default_matmul_precision("high"):
        text = jax.jit(jax.grad(lambda rows: stack(rows).sum())).lower(jnp.ones((4, 5))).as_text()
    means = [line for line in text.splitlines() if "dot_general" in line and "tensor<8xf32>" in line]
    assert len(means) >= 8 and all("HIGHEST" in line for line in means)
