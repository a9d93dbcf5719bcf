"""Rollouts of a model whose answers are known, where they end, and the ring that keeps their rows."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import odaf
from golden import tiny
from odaf.components.dynamics import EnsembleConfig, TransitionEnsemble
from odaf.components.dynamics.rollouts import Ring, rollout
from odaf.components.dynamics.terminations import known, never, termination
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError

CONFIG = EnsembleConfig(hidden_sizes=(4,), members=2, elites=2)


@functools.cache
def _counting() -> TransitionEnsemble:
    """Without noise: the first number of the state goes up by 2 of the log's units, 1 of ours; the reward is 7."""
    shape = eqx.filter_eval_shape(lambda: CONFIG.untrained(jr.key(0), 3, 2))
    model = tiny.filled(shape, size=0.0)
    last = jnp.zeros_like(model.network.biases[-1]).at[:, 0].set(2.0).at[:, 3].set(7.0)
    quiet = jnp.full(4, -60.0)
    return eqx.tree_at(
        lambda m: (m.network.biases, m.log_variance_max, m.log_variance_min, m.input_std, m.unit, m.centre),
        model,
        ((model.network.biases[0], last), quiet, quiet, jnp.ones(5), jnp.full(3, 2.0), jnp.asarray([10.0, 0.0, 0.0])),
    )


def _past_15(observations, actions, next_observations):
    """Of the log's units: 10 + 2 * 3 is the first beyond."""
    assert observations.shape == next_observations.shape and actions.shape == (observations.shape[0], 2)
    return next_observations[:, 0] > 15.0


def _half(states, key):
    return 0.0 * jr.normal(key, (states.shape[0], 2)) + 0.5


def test_rollouts_end_with_the_row_that_ends_and_with_one_that_is_not_finite():
    starts = jnp.zeros((4, 3)).at[:, 0].set(jnp.asarray([0.0, 2.0, -9.0, jnp.nan]))
    found = rollout(_counting(), _half, starts, 5, _past_15, jr.key(0))
    rows, kept = found.rows, np.asarray(found.kept).reshape(5, 4)
    #  0 -> 1 -> 2 -> 3 ends;  2 -> 3 ends;  -9 .. -4 never;  not a number is not kept at all
    np.testing.assert_array_equal(kept.sum(axis=0), [3, 1, 5, 0])
    assert np.all(np.diff(kept.astype(int), axis=0) <= 0), "what has ended stays so"
    ended = np.asarray(rows.terminated).reshape(5, 4) * kept
    np.testing.assert_array_equal(ended.sum(axis=0), [1, 1, 0, 0])
    states, after = (np.asarray(c).reshape(5, 4, 3) for c in (rows.observations, rows.next_observations))
    np.testing.assert_allclose(after[kept][:, 0], states[kept][:, 0] + 1.0, rtol=1e-6)
    np.testing.assert_array_equal(states[1:, 2], after[:-1, 2])
    np.testing.assert_array_equal(np.asarray(rows.rewards).reshape(5, 4)[kept], 7.0)
    np.testing.assert_array_equal(np.asarray(rows.actions).reshape(5, 4, 2)[kept], 0.5)
    assert not np.any(found.doubt)


def test_uncertainty_is_measured_where_it_is_asked_for():
    loud = eqx.tree_at(
        lambda m: (m.log_variance_max, m.log_variance_min), _counting(), (jnp.zeros(4), jnp.zeros(4) - 1)
    )
    found = rollout(loud, _half, jnp.zeros((3, 3)), 2, never, jr.key(0), "deviation")
    assert np.all(np.asarray(found.doubt) > 1.0) and not np.any(found.rows.terminated) and np.all(found.kept)
    first, second = (np.asarray(c) for c in (found.rows.next_observations[:3], found.rows.observations[3:]))
    np.testing.assert_array_equal(first, second)
    assert len(np.unique(first[:, 0])) == 3, "each row has noise of its own"


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=5, max_size=5), min_size=1, max_size=6))
def test_the_ring_holds_the_last_rows_that_were_kept(pushes):
    ring, expected = Ring.empty(7, 1, 1), []
    for number, kept in enumerate(pushes):
        marks = 10.0 * number + jnp.arange(5.0) + 1.0
        rows = Transitions(marks[:, None], marks[:, None], marks, marks[:, None], jnp.zeros(5))
        ring = _push(ring, rows, jnp.asarray(kept))
        expected += [float(mark) for mark, keep in zip(marks, kept, strict=True) if keep]
    assert int(ring.filled) == min(len(expected), 7)
    present = np.asarray(ring.rows.rewards)[: int(ring.filled)]
    assert sorted(present) == sorted(expected[-7:])
    for column in (ring.rows.observations, ring.rows.actions, ring.rows.next_observations):
        np.testing.assert_array_equal(column[:, 0], ring.rows.rewards)
    if expected:
        drawn = np.asarray(_sample(ring).rewards)
        assert set(drawn) <= set(present) and drawn.shape == (64,)


_push = jax.jit(lambda ring, rows, kept: ring.pushed(rows, kept))
_sample = jax.jit(lambda ring: ring.sample(jr.key(0), 64))


STANDING = [1.2, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("robot", "changes", "ends"),
    [
        ("hopper", {}, False),
        ("hopper", {0: 0.7}, True),
        ("hopper", {0: 0.71}, False),
        ("hopper", {1: 0.2}, True),
        ("hopper", {1: -0.2}, True),
        ("hopper", {1: -0.19}, False),
        ("hopper", {0: 150.0}, False),  # the height has no upper bound
        ("hopper", {3: 100.0}, True),
        ("hopper", {3: -100.0}, True),  # the bound that a public code does not enforce
        ("walker2d", {}, False),
        ("walker2d", {0: 0.8}, True),
        ("walker2d", {0: 2.0}, True),
        ("walker2d", {1: 1.0}, True),
        ("walker2d", {1: -1.0}, True),
        ("walker2d", {1: -0.99}, False),
        ("walker2d", {2: -100.0}, True),
        ("halfcheetah", {0: -0.5, 1: 3.0}, False),
        ("halfcheetah", {0: -100.0}, True),
        ("never", {0: -100.0}, False),
    ],
)
def test_robots_end_where_their_simulators_end_them(robot, changes, ends):
    state = np.asarray(STANDING)
    for place, value in changes.items():
        state[place] = value
    rows = jnp.asarray(np.stack([np.asarray(STANDING), state]), jnp.float32)
    found = termination(robot)(jnp.zeros((2, 4)), jnp.zeros((2, 1)), rows)
    np.testing.assert_array_equal(found, [False, ends])


def test_a_function_of_ones_own_is_known_by_its_name():
    @odaf.register
    def tank_overflows_in_a_test(observations, actions, next_observations):
        del observations, actions
        return next_observations[:, 0] > 2.5

    assert termination("tank_overflows_in_a_test") is tank_overflows_in_a_test
    assert "tank_overflows_in_a_test" in known() and known()[:2] == ["never", "halfcheetah"]
    with pytest.raises(ConfigError, match="termination='tank_overflow' is not known; known: never, halfcheetah"):
        termination("tank_overflow")

    def hopper(observations, actions, next_observations):
        return next_observations[:, 0] > 0.0

    with pytest.raises(ConfigError, match="termination 'hopper': another function"):
        odaf.register(hopper)
    with pytest.raises(ConfigError, match="has no name that settings could hold"):
        odaf.register(lambda observations, actions, next_observations: observations[:, 0] > 0.0)


def test_functions_that_differ_in_what_they_hold_are_two():
    """One piece of code with another limit is another task; the first one must not stand in for it."""

    def made(limit):
        def held_limit_in_a_test(observations, actions, next_observations):
            return next_observations[:, 0] > limit

        return held_limit_in_a_test

    def with_default(limit):
        def default_limit_in_a_test(observations, actions, next_observations, limit=limit):
            return next_observations[:, 0] > limit

        return default_limit_in_a_test

    for maker in (made, with_default):
        odaf.register(maker(2.5))
        odaf.register(maker(2.5))  # read in again, as in a notebook
        with pytest.raises(ConfigError, match="another function of this process has that name"):
            odaf.register(maker(3.0))
