"""The tanh-squashed Gaussian: its density, its floor, its policy in bounds."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import integrate, stats

from golden import networks, tiny
from odaf.components.distributions import (
    exact_sample_tanh_gaussian,
    gaussian_divergence,
    sample_tanh_gaussian,
    symmetric_gaussian_divergence,
)
from odaf.components.policies import (
    GaussianActor,
    NarrowGaussianActor,
    init_deterministic_actor,
    init_gaussian_actor,
)

draw = jax.jit(sample_tanh_gaussian)


def _log_density(actions: np.ndarray, mean: float, log_std: float) -> np.ndarray:
    """What the package says about given actions, by handing it the noise that leads to them."""
    noise = (np.arctanh(actions) - mean) / np.exp(log_std)
    column = noise[:, None]
    sampled, density = draw(np.full_like(column, mean), np.full_like(column, log_std), column)
    np.testing.assert_allclose(np.asarray(sampled)[:, 0], actions, rtol=1e-9, atol=1e-12)
    return np.asarray(density)


def test_the_density_of_an_action_integrates_to_one():
    with tiny.exactly():
        actions = np.tanh(np.linspace(-6.0, 6.0, 4001))
        for mean, log_std in ((0.0, -0.5), (0.7, -1.5), (-1.0, 0.0)):
            density = np.exp(_log_density(actions, mean, log_std))
            assert abs(integrate.trapezoid(density, actions) - 1.0) < 2e-4


def test_log_density_is_normal_minus_the_change_of_variables():
    with tiny.exactly():
        z, mean, log_std = 0.4, -0.3, -0.7
        by_hand = stats.norm.logpdf(z, mean, np.exp(log_std)) - np.log(1.0 - np.tanh(z) ** 2 + 1e-6)
        assert abs(_log_density(np.array([np.tanh(z)]), mean, log_std)[0] - by_hand) < 1e-9


def test_log_densities_of_dimensions_add_up():
    mean, log_std, noise = np.array([[[0.1, -0.2, 0.3]], [[0.0, -1.0, 0.5]], [[1.0, 0.5, -2.0]]], np.float32)
    _, together = draw(mean, log_std, noise)
    apart = [draw(mean[:, i : i + 1], log_std[:, i : i + 1], noise[:, i : i + 1])[1] for i in range(3)]
    np.testing.assert_allclose(together, np.sum(apart, axis=0), rtol=1e-5)


def test_a_saturated_action_costs_at_most_the_floor():
    far = np.array([[50.0]], np.float32)
    action, density = draw(far, np.zeros_like(far), np.zeros_like(far))
    assert float(action[0, 0]) == 1.0
    # one plus 1e-6 is rounded in single precision: up to 5 % of 1e-6, which is 0.05 of its logarithm
    np.testing.assert_allclose(density[0], -0.5 * np.log(2 * np.pi) - np.log(1e-6), atol=0.06)


def _actor(size: float = 0.6) -> GaussianActor:
    return tiny.filled(jax.eval_shape(lambda: init_gaussian_actor(jr.key(0), 3, 2, (4, 4))), size=size)


def test_the_exact_density_of_a_draw_has_no_floor():
    with tiny.exactly():
        mean, log_std, noise = (tiny.floats(part) for part in ([[0.3, 12.0]], [[-0.5, 0.1]], [[1.2, -0.4]]))
        action, density = exact_sample_tanh_gaussian(mean, log_std, noise)
        z = np.array([0.3 + 1.2 * np.exp(-0.5), 12.0 - 0.4 * np.exp(0.1)])
        np.testing.assert_allclose(action[0], np.tanh(z), rtol=1e-12)
        normal = stats.norm.logpdf(z, [0.3, 12.0], np.exp([-0.5, 0.1]))
        np.testing.assert_allclose(density[0], np.sum(normal + 2.0 * np.log(np.cosh(z))), rtol=1e-9)


def test_the_narrow_actor_keeps_its_deviation_between_a_hundredth_and_one_and_never_loses_the_slope():
    with tiny.exactly():
        network = tiny.filled(
            jax.eval_shape(lambda: init_gaussian_actor(jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM, (4,)).network), 3
        )
        rows = tiny.batch().observations
        output = networks.mlp(network, rows)
        mean, log_std = NarrowGaussianActor(network).parameters(rows)
        np.testing.assert_allclose(mean, output[:, :2], rtol=1e-9)
        np.testing.assert_allclose(log_std, -5.0 + 2.5 * (np.tanh(output[:, 2:]) + 1.0), rtol=1e-9)


def test_the_actor_clips_its_log_standard_deviation_and_not_its_mean():
    rows = np.float32(np.random.default_rng(0).normal(size=(40, 3)))
    mean, log_std = _actor(size=10.0).parameters(jnp.asarray(rows))
    assert np.min(log_std) == -5.0 and np.max(log_std) == 2.0
    assert np.min(mean) < -5.0 and np.max(mean) > 5.0


def test_the_first_actions_are_near_zero_and_spread_out():
    actor = jax.jit(lambda: init_gaussian_actor(jr.key(0), 3, 2, (16, 16)))()
    mean, std = networks.gaussian(actor, np.random.default_rng(0).normal(size=(20, 3)))
    assert np.abs(mean).max() < 0.05 and np.abs(np.log(std)).max() < 0.05


def test_sample_and_mode_follow_the_formula():
    with tiny.exactly():
        rng = np.random.default_rng(0)
        actor, rows, noise = _actor(), tiny.floats(rng.normal(size=(6, 3))), tiny.floats(rng.normal(size=(6, 2)))
        actions, log_density = actor.sample(rows, noise)
        expected, density = networks.act(actor, rows, noise)
        np.testing.assert_allclose(actions, expected, rtol=1e-10)
        np.testing.assert_allclose(log_density, density, rtol=1e-9)
        np.testing.assert_allclose(actor.mode(rows), networks.mode(actor, rows), rtol=1e-10)


@jax.jit
def _everything(gaussian, deterministic, states, noise):
    return *gaussian.sample(states, noise), gaussian.mode(states), deterministic.mode(states)


@settings(max_examples=60)
@given(
    hnp.arrays(np.float32, (2, 3), elements=st.floats(-(2.0**99), 2.0**99, width=32)),
    hnp.arrays(np.float32, (2, 2), elements=st.floats(-10, 10, width=32)),
)
def test_actions_stay_in_bounds_for_any_finite_state(states, noise):
    cloner = tiny.filled(jax.eval_shape(lambda: init_deterministic_actor(jr.key(0), 3, 2, (8,))))
    actions, log_density, mode, cloned = _everything(_actor(size=5.0), cloner, states, noise)
    for found in (actions, mode, cloned):
        assert np.all(np.abs(np.asarray(found)) <= 1.0)
    assert np.all(np.isfinite(np.asarray(log_density)))


def test_divergences_of_normals_are_integrals_of_their_definition():
    with tiny.exactly():
        x = np.linspace(-15.0, 15.0, 20001)
        for m, r, n, k in ((0.3, -0.5, -0.4, 0.2), (1.0, 0.4, 1.0, 0.4), (-1.0, -1.0, 0.5, -0.3)):
            log_p, log_q = stats.norm.logpdf(x, m, np.exp(r)), stats.norm.logpdf(x, n, np.exp(k))
            forth = integrate.trapezoid(np.exp(log_p) * (log_p - log_q), x)
            back = integrate.trapezoid(np.exp(log_q) * (log_q - log_p), x)
            numbers = [tiny.floats([[v]]) for v in (m, r, n, k)]
            assert abs(float(gaussian_divergence(*numbers)[0, 0]) - forth) < 1e-9
            assert abs(float(symmetric_gaussian_divergence(*numbers)[0, 0]) - (forth + back)) < 1e-9


def test_the_divergence_of_close_normals_keeps_its_digits_in_single_precision():
    numbers = [tiny.floats([[v]]) for v in (0.5, -1.0, 0.5 + 2.0**-12, -1.0 + 2.0**-12)]
    exact = 2.0 * np.sinh(2.0**-12) ** 2 + 2.0**-25 * (np.exp(2.0) + np.exp(2.0 - 2.0**-11))
    assert abs(float(symmetric_gaussian_divergence(*numbers)[0, 0]) / exact - 1.0) < 1e-5
