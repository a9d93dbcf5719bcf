"""Bellman targets, the range of values that rewards allow, and slow copies."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from golden import tiny
from odaf.components.networks import init_mlp
from odaf.components.targets import bellman_target, copy_of, frozen, polyak, value_range


def test_a_true_end_bootstraps_to_zero_and_a_time_out_does_not():
    rewards, next_values = jnp.asarray([1.0, 1.0]), jnp.asarray([10.0, 10.0])
    y = bellman_target(rewards, jnp.asarray([1.0, 0.0]), next_values, 0.5)
    np.testing.assert_array_equal(y, [1.0, 6.0])


def _spec(low: float, high: float, ends: bool):
    return dataclasses.replace(tiny.SPEC, reward_min=low, reward_max=high, ever_terminates=ends)


@pytest.mark.parametrize(
    ("low", "high", "ends", "expected"),
    [
        (0.0, 1.0, False, (0.0, 10.0)),
        (-1.0, 0.0, False, (-10.0, 0.0)),
        (1.0, 2.0, False, (10.0, 20.0)),  # it never stops: even the worst stream earns 1 for ever
        (1.0, 2.0, True, (1.0, 20.0)),  # it may stop after one reward of 1
        (-2.0, -1.0, True, (-20.0, -1.0)),
        (-1.0, 2.0, True, (-10.0, 20.0)),
    ],
)
def test_the_value_range_of_known_rewards(low, high, ends, expected):
    bounds = value_range(_spec(low, high, ends), 0.9)
    np.testing.assert_allclose(np.array(bounds), expected, rtol=1e-12)
    traced = value_range(_spec(low, high, ends), jnp.asarray(0.9))
    np.testing.assert_allclose(np.array(traced), expected, rtol=1e-5)


@given(
    st.floats(-5, 5),
    st.floats(0, 5),
    st.booleans(),
    st.floats(0, 0.99),
    st.integers(1, 60),
    st.randoms(use_true_random=False),
)
def test_no_stream_of_logged_rewards_leaves_the_value_range(low, width, ends, discount, length, random):
    least, most = map(float, value_range(_spec(low, low + width, ends), discount))
    rewards = [random.uniform(low, low + width) for _ in range(length)]
    value = sum(discount**step * reward for step, reward in enumerate(rewards))
    if not ends:  # the stream goes on with its last reward
        value += discount**length * rewards[-1] / (1.0 - discount)
    slack = 1e-9 * (1.0 + abs(value))
    assert least - slack <= value <= most + slack


def _network(seed: int = 0):
    return tiny.filled(jax.eval_shape(lambda: init_mlp(jr.key(0), (3, 4, 2))), seed)


def test_polyak_moves_by_the_rate_and_leaves_what_is_not_a_parameter():
    slow, online = (_network(0), jnp.asarray(3)), (_network(1), jnp.asarray(8))
    moved = jax.jit(lambda one, other: polyak(one, other, 0.25))(slow, online)
    expected = jax.tree.map(lambda s, o: 0.75 * np.asarray(s) + 0.25 * np.asarray(o), slow[0], online[0])
    tiny.assert_close(moved[0], expected, rtol=1e-5, atol=1e-6)
    assert moved[0].activation == slow[0].activation and int(moved[1]) == 3


def test_a_copy_has_buffers_of_its_own():
    network = _network()
    copied = copy_of(network)
    for ours, theirs in zip(jax.tree.leaves(network), jax.tree.leaves(copied), strict=True):
        np.testing.assert_array_equal(ours, theirs)
        assert ours.unsafe_buffer_pointer() != theirs.unsafe_buffer_pointer()


def test_frozen_networks_pass_gradients_to_inputs_only():
    gradients = jax.jit(jax.grad(lambda n, x: jnp.sum(frozen(n)(x)), argnums=(0, 1)))
    by_network, by_rows = gradients(_network(), tiny.batch().observations)
    assert tiny.all_zero(by_network)
    assert np.all(np.asarray(by_rows) != 0.0)
