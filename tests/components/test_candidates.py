"""The best of several actions a state."""

import dataclasses

import jax
import numpy as np
import pytest

from golden import networks, tiny
from odaf.components.candidates import best_candidate, best_soft_value, fixed_normal

DRAWS = 7


def _problem():
    rng = np.random.default_rng(2)
    states, actions = rng.normal(size=(tiny.ROWS, tiny.OBS_DIM)), rng.uniform(-1, 1, (DRAWS, tiny.ROWS, tiny.ACT_DIM))
    return tiny.floats(states), tiny.floats(actions)


@pytest.mark.parametrize("norm", ["none", "layer"])
def test_critics_are_reduced_before_actions(norm):
    with tiny.exactly():
        critics, (states, actions) = tiny.critics(norm, num_critics=3), _problem()
        values = np.stack([networks.q_values(critics, states, draw) for draw in actions])  # [draws, critics, rows]
        soft = 0.75 * values.min(axis=1) + 0.25 * values.max(axis=1)
        found = jax.jit(best_soft_value)(critics.networks, states, actions, 0.75)
        np.testing.assert_allclose(found, soft.max(axis=0), rtol=1e-9)
        best = values.max(axis=0)  # of each critic: the other order
        assert np.abs(found - (0.75 * best.min(axis=0) + 0.25 * best.max(axis=0))).max() > 1e-3


def test_the_best_candidate_is_the_one_that_the_critic_values_most():
    with tiny.exactly():
        critics, (states, actions) = tiny.critics("none", num_critics=2), _problem()
        first = jax.tree.map(lambda leaf: leaf[0], critics.networks)
        values = np.stack([networks.q_values(critics, states, draw)[0] for draw in actions])
        expected = np.asarray(actions)[values.argmax(axis=0), np.arange(tiny.ROWS)]
        np.testing.assert_array_equal(best_candidate(first, states, actions), expected)
        assert len(set(values.argmax(axis=0))) > 1


def test_a_network_of_draws_is_the_network_of_both_parts_side_by_side():
    with tiny.exactly():
        network = jax.tree.map(lambda leaf: leaf[0], tiny.critics("layer").networks)
        states, actions = _problem()
        for kind in ("relu", "silu"):
            network = dataclasses.replace(network, activation=kind)
            expected = [networks.mlp(network, np.concatenate([states, draw], axis=1)) for draw in actions]
            np.testing.assert_allclose(network.of_draws(states, actions), expected, rtol=1e-9)


def test_fixed_noise_is_the_same_each_time():
    np.testing.assert_array_equal(fixed_normal(5, 2), fixed_normal(5, 2))
    assert fixed_normal(5, 2).shape == (5, 2)
