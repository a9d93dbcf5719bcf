"""Losses that learners share: sums and means where they belong, gradients only where they belong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from golden import soft_actor_critic, tiny
from odaf.components.losses import ensemble_td_gradient, soft_actor_loss, td_loss, temperature_loss

Y = np.linspace(-2.0, 3.0, tiny.ROWS)


def td_gradient(critics, batch, y):
    return ensemble_td_gradient(critics, batch.observations, batch.actions, y)


@pytest.mark.parametrize("norm", ["none", "layer"])
def test_the_critic_loss_sums_over_members_and_averages_over_rows(norm):
    with tiny.exactly():
        critics, batch = tiny.critics(norm), tiny.batch()
        gradient, loss, values = td_gradient(critics, batch, tiny.floats(Y))
        np.testing.assert_allclose(loss, soft_actor_critic.critic_loss(critics, batch, Y), rtol=1e-10)
        assert values.shape == (3, tiny.ROWS)
        tiny.assert_slopes(gradient, lambda moved: soft_actor_critic.critic_loss(moved, batch, Y), critics)


def test_a_member_learns_alike_in_small_and_in_large_ensembles():
    with tiny.exactly():
        critics, batch = tiny.critics(num_critics=4), tiny.batch()
        pair = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[:2]), critics)
        of_four, _, _ = td_gradient(critics, batch, tiny.floats(Y))
        of_two, _, _ = td_gradient(pair, batch, tiny.floats(Y))
    for four, two in zip(jax.tree.leaves(of_four), jax.tree.leaves(of_two), strict=True):
        np.testing.assert_allclose(four[:2], two, rtol=1e-5, atol=1e-6)


def test_the_target_gets_no_gradient():
    gradient = jax.grad(lambda y: td_loss(jnp.asarray([1.0, 2.0]), y))(jnp.asarray([0.0, 5.0]))
    np.testing.assert_array_equal(gradient, np.zeros(2))


def test_the_actor_loss_weighs_entropy_by_a_constant_temperature():
    density, value, alpha = jnp.asarray([0.5, -1.5]), jnp.asarray([2.0, 4.0]), jnp.asarray(0.2)
    loss, slopes = jax.value_and_grad(soft_actor_loss, argnums=(0, 1, 2))(density, value, alpha)
    np.testing.assert_allclose(loss, -3.1, rtol=1e-6)  # (0.2 * 0.5 - 2 + 0.2 * -1.5 - 4) / 2
    np.testing.assert_allclose(slopes[0], [0.1, 0.1], rtol=1e-6)
    np.testing.assert_allclose(slopes[1], [-0.5, -0.5], rtol=1e-6)
    assert float(slopes[2]) == 0.0


def test_the_temperature_loss_is_the_products_mean():
    density = np.array([0.3, -2.0, 1.1])
    expected = soft_actor_critic.temperature_loss(0.7, density, -2.0)
    np.testing.assert_allclose(temperature_loss(jnp.asarray(0.7), tiny.floats(density), -2.0), expected, rtol=1e-6)


@pytest.mark.parametrize(("entropy", "rises"), [(-3.0, True), (-1.0, False)])
def test_entropy_below_the_target_raises_the_temperature(entropy, rises):
    slopes = jax.grad(temperature_loss, argnums=(0, 1))(jnp.asarray(0.5), tiny.floats([-entropy] * 4), -2.0)
    assert (float(slopes[0]) < 0.0) is rises, "Adam steps against the gradient"
    np.testing.assert_array_equal(slopes[1], np.zeros(4))
