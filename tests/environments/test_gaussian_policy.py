"""The NumPy policy says what the JAX actor says."""

import dataclasses
import math

import jax.numpy as jnp
import jax.random as jr
import numpy as np

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
    expected, log_density = actor.sample(jnp.asarray(observations), jnp.asarray(noise))
    np.testing.assert_allclose(actions, expected, atol=1e-5)
    free = np.abs(actions).max(axis=1) < 0.999  # near the bounds, the density amplifies rounding in single precision
    assert free.sum() >= 5
    np.testing.assert_allclose(densities[free], np.asarray(log_density)[free], atol=2e-3)
    np.testing.assert_allclose(densities, log_density, atol=1.0)
    np.testing.assert_array_equal(policy.sample(observations, noise), actions)
    np.testing.assert_allclose(policy.mode(observations), actor.mode(jnp.asarray(observations)), atol=1e-5)
    one = policy.sample(observations[0], noise[0])
    np.testing.assert_allclose(one, actions[0], atol=1e-6)


def test_the_spread_scales_the_standard_deviation_and_leaves_the_mode():
    _, policy = pair()
    wide = dataclasses.replace(policy, spread=1.5)
    observations = np.random.default_rng(0).normal(size=(5, 4))
    mean, log_std = policy.parameters(observations)
    wide_mean, wide_log_std = wide.parameters(observations)
    np.testing.assert_array_equal(mean, wide_mean)
    np.testing.assert_allclose(wide_log_std - log_std, math.log(1.5), rtol=1e-5)
    np.testing.assert_array_equal(policy.mode(observations), wide.mode(observations))
