"""The NumPy policy says what the JAX actor says."""

import dataclasses
import math

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf.components.distributions import exact_sample_tanh_gaussian
from odaf.components.policies import GaussianActor, init_gaussian_actor
from odaf.environments.gaussian_policy import GaussianPolicy


def pair() -> tuple[GaussianActor, GaussianPolicy]:
    """One actor twice, with outputs that are not tiny and log standard deviations on both sides of their limits."""
    network = init_gaussian_actor(jr.key(0), 4, 2, (8, 8)).network
    last = np.random.default_rng(1).normal(size=(8, 4)).astype(np.float32)
    weights = (*network.weights[:-1], jnp.asarray(last * np.array([0.2, 0.2, 40.0, 40.0], np.float32)))
    actor = GaussianActor(dataclasses.replace(network, weights=weights))
    return actor, GaussianPolicy([np.asarray(w) for w in weights], [np.asarray(b) for b in network.biases])


def test_actions_and_densities_agree_with_the_actor():
    actor, policy = pair()
    rng = np.random.default_rng(0)
    observations = rng.normal(size=(50, 4)).astype(np.float32)
    noise = rng.normal(size=(50, 2)).astype(np.float32)
    _, log_std = policy.parameters(observations)
    assert log_std.min() == -5.0 and log_std.max() == 2.0, "this actor must reach both limits"
    actions, densities = policy.sample_with_density(observations, noise)
    mean_and_log_std = actor.parameters(jnp.asarray(observations))
    expected, log_density = exact_sample_tanh_gaussian(*mean_and_log_std, jnp.asarray(noise))
    np.testing.assert_allclose(actions, expected, atol=1e-5)
    assert densities.dtype == np.float32
    np.testing.assert_allclose(densities, log_density, atol=1e-3)  # up to the bounds
    np.testing.assert_array_equal(policy.sample(observations, noise), actions)
    np.testing.assert_allclose(policy.mode(observations), actor.mode(jnp.asarray(observations)), atol=1e-5)
    one = policy.sample(observations[0], noise[0])
    np.testing.assert_allclose(one, actions[0], atol=1e-6)


@pytest.mark.parametrize("before_tanh", [0.0, -0.7, 3.0, 8.0, -12.0, 30.0, 200.0])
def test_the_density_is_right_up_to_the_bounds(before_tanh: float):
    # Standard deviation 1, mean 0. The density of tanh(u) is N(u) / sech(u)^2, here with cosh in long double.
    policy = GaussianPolicy([np.zeros((1, 2), np.float32)], [np.zeros(2, np.float32)])
    _, density = policy.sample_with_density(np.zeros((1, 1)), np.array([[before_tanh]], np.float32))
    u = np.longdouble(before_tanh)
    expected = -0.5 * u**2 - 0.5 * np.log(2 * np.longdouble(np.pi)) + 2 * np.log(np.cosh(u))
    np.testing.assert_allclose(density, [float(expected)], rtol=1e-6)


def test_the_spread_scales_the_standard_deviation_and_leaves_the_mode():
    _, policy = pair()
    wide = dataclasses.replace(policy, spread=1.5)
    observations = np.random.default_rng(0).normal(size=(5, 4))
    mean, log_std = policy.parameters(observations)
    wide_mean, wide_log_std = wide.parameters(observations)
    np.testing.assert_array_equal(mean, wide_mean)
    np.testing.assert_allclose(wide_log_std - log_std, math.log(1.5), rtol=1e-5)
    np.testing.assert_array_equal(policy.mode(observations), wide.mode(observations))
