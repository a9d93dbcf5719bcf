"""Adam against its definition, written out in NumPy."""

import jax.numpy as jnp
import numpy as np

from odaf.components.adam import adam_step, initial_moments


def test_three_steps_are_those_of_the_paper():
    rng = np.random.default_rng(0)
    expected = {"weight": rng.normal(size=(3, 2)), "bias": rng.normal(size=2)}
    gradients = [{name: rng.normal(size=value.shape) for name, value in expected.items()} for _ in range(3)]
    parameters = {name: jnp.asarray(value, jnp.float32) for name, value in expected.items()}

    first = {name: np.zeros_like(value) for name, value in expected.items()}
    second = {name: np.zeros_like(value) for name, value in expected.items()}
    moments = initial_moments(parameters)
    for step, gradient in enumerate(gradients, start=1):
        parameters, moments = adam_step(0.01, gradient, moments, parameters)
        for name, slope in gradient.items():
            first[name] = 0.9 * first[name] + 0.1 * slope
            second[name] = 0.999 * second[name] + 0.001 * slope**2
            unbiased = first[name] / (1 - 0.9**step), second[name] / (1 - 0.999**step)
            expected[name] = expected[name] - 0.01 * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-8)

    for name, value in expected.items():
        np.testing.assert_allclose(parameters[name], value, rtol=0, atol=2e-6)
