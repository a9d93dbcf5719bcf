"""The ensemble of critics: every member on its own, and how much they disagree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from golden import networks, tiny
from odaf.components.critics import disagreement
from odaf.components.losses import ensemble_td_gradient


@pytest.mark.parametrize("norm", ["none", "layer"])
def test_every_member_sees_state_and_action(norm):
    with tiny.exactly():
        critics, batch = tiny.critics(norm), tiny.batch()
        expected = networks.q_values(critics, batch.observations, batch.actions)
        assert expected.shape == (3, tiny.ROWS)
        found = critics(batch.observations, batch.actions)
        np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_critics_as_constants_have_the_same_values_and_slopes_but_no_gradient_of_their_own():
    with tiny.exactly():
        critics, batch = tiny.critics(), tiny.batch()
        weights = tiny.floats(np.random.default_rng(0).normal(size=(3, tiny.ROWS)))

        def gradients(read):
            def weighted(critics, observations, actions):
                return jnp.sum(weights * read(critics, observations, actions))

            slopes = jax.jit(jax.value_and_grad(weighted, argnums=(0, 1, 2)))
            return slopes(critics, batch.observations, batch.actions)

        value, found = gradients(lambda c, s, a: c.as_constants(s, a))
        plain_value, expected = gradients(lambda c, s, a: c(s, a))
        np.testing.assert_allclose(value, plain_value, rtol=1e-12)
        np.testing.assert_allclose(found[1], expected[1], rtol=1e-10)
        np.testing.assert_allclose(found[2], expected[2], rtol=1e-10)
        assert tiny.all_zero(found[0]) and tiny.each_nonzero(expected[0].networks.weights)


@pytest.mark.parametrize(("cores", "unrolled"), [(1, 10), (2, 10), (2, 2), (2, 1)])
def test_members_in_turn_or_side_by_side_equal_one_batched_product(monkeypatch, cores, unrolled):
    monkeypatch.setattr("odaf.components.critics.usable_cores", lambda: cores)
    monkeypatch.setattr("odaf.components.critics.UNROLLED", unrolled)
    critics, batch = tiny.critics(num_critics=4), tiny.batch()
    y = tiny.floats(np.linspace(-1.0, 1.0, tiny.ROWS))

    def everything(critics, states, actions):
        slope = jax.grad(lambda a: jnp.sum(critics.as_constants(states, a) ** 2))(actions)
        return critics(states, actions), slope, ensemble_td_gradient(critics, states, actions, y)

    in_turn = jax.jit(lambda *arguments: everything(*arguments))(critics, batch.observations, batch.actions)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    together = jax.jit(lambda *arguments: everything(*arguments))(critics, batch.observations, batch.actions)
    tiny.assert_close(in_turn, together, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("ddof", [0, 1])
def test_disagreement_is_the_standard_deviation_over_members(ddof):
    values = np.random.default_rng(0).normal(size=(10, 9)).astype(np.float32)
    found = np.asarray(disagreement(jnp.asarray(values), ddof))
    np.testing.assert_allclose(found, values.std(axis=0, ddof=ddof), rtol=1e-5)
    np.testing.assert_allclose(found / values.std(axis=0), 1.0 if ddof == 0 else 1.0541, rtol=1e-4)


def test_members_that_agree_have_a_finite_gradient_of_disagreement():
    value, gradient = jax.value_and_grad(lambda v: jnp.sum(disagreement(v)))(jnp.full((4, 2), 7.0))
    assert float(value) <= 2.1e-6
    np.testing.assert_array_equal(gradient, np.zeros((4, 2)))
