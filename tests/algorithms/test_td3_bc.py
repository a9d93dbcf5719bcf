"""TD3+BC against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.td3_bc import TD3BC, actor_loss
from odaf.components.critics import CriticEnsemble
from odaf.errors import ConfigError

LEARNER = TD3BC(hidden_sizes=(5, 4), batch_size=tiny.ROWS, discount=0.9, target_rate=0.25, learning_rate=1e-2)


def _mode(actor, observations) -> np.ndarray:
    return np.tanh(networks.mlp(actor.network, observations))


def _target(state, batch, noise) -> np.ndarray:
    actions = np.clip(_mode(state.actor.slow, batch.next_observations) + np.clip(0.2 * noise, -0.5, 0.5), -1.0, 1.0)
    values = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, actions).min(axis=0)
    ends = np.asarray(batch.terminated, np.float64)
    return np.asarray(batch.rewards, np.float64) + 0.9 * (1.0 - ends) * values


def _critic_loss(critics, batch, y) -> float:
    values = networks.q_values(CriticEnsemble(critics), batch.observations, batch.actions)
    return float(np.sum(np.mean((values - y) ** 2, axis=1)))


def _actor_loss(actor, critics, batch, size: float) -> float:
    actions = _mode(actor, batch.observations)
    first = networks.q_values(CriticEnsemble(critics), batch.observations, actions)[0]
    return float(np.mean((actions - np.asarray(batch.actions, np.float64)) ** 2) - 2.5 / size * first.mean())


def test_target_critics_and_actor_follow_their_formulas():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch()
        with tiny.recorded() as drawn:
            y = LEARNER.target(state, batch, jr.key(5))
        large = 20.0 * np.asarray(drawn[0])  # the noise must be cut somewhere, and the action too
        assert np.any(np.abs(0.2 * large) > 0.5)
        np.testing.assert_allclose(y, _target(state, batch, np.asarray(drawn[0])), rtol=1e-9)
        shifted = dataclasses.replace(LEARNER, reward_shift=-1.0).target(state, batch, jr.key(5))
        np.testing.assert_allclose(shifted, y - 1.0, rtol=1e-9)

        critics = CriticEnsemble(state.critics.now)
        size = np.abs(
            networks.q_values(critics, batch.observations, _mode(state.actor.now, batch.observations))[0]
        ).mean()
        (loss, metrics), gradient = jax.value_and_grad(actor_loss, has_aux=True)(state.actor.now, critics, batch, 2.5)
        np.testing.assert_allclose(loss, _actor_loss(state.actor.now, state.critics.now, batch, size), rtol=1e-9)
        assert set(metrics) == set(state.actor_metrics)
        # the size of the values is a constant: the slope is that of the loss with it held fast
        tiny.assert_slopes(gradient, lambda a: _actor_loss(a, state.critics.now, batch, size), state.actor.now)
        by_critics = jax.grad(lambda c: actor_loss(state.actor.now, c, batch, 2.5)[0])(critics)
        assert tiny.all_zero(by_critics)


def test_the_actor_and_all_slow_copies_move_at_every_second_update_against_the_new_critics():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch()
        one, first = LEARNER.update(state, batch, jr.key(1))
        two, second = LEARNER.update(one, batch, jr.key(2))
    tiny.assert_same_bits((one.actor, one.critics.slow), (state.actor, state.critics.slow))
    assert not np.array_equal(one.critics.now.weights[0], state.critics.now.weights[0])
    for before, after in ((one.actor.now, two.actor.now), (one.actor.slow, two.actor.slow)):
        assert before is not None and after is not None
        assert not np.array_equal(before.network.weights[0], after.network.weights[0])
    expected = jax.tree.map(lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), one.critics.slow, two.critics.now)
    tiny.assert_close(two.critics.slow, expected, atol=1e-9)
    with tiny.exactly():
        loss, _ = actor_loss(one.actor.now, CriticEnsemble(two.critics.now), batch, 2.5)
    np.testing.assert_allclose(second["actor/loss"], loss, rtol=1e-6)
    assert float(first["actor/loss"]) == 0.0  # there has been no actor step yet


def test_the_critics_take_one_step_down_the_sum_of_their_squared_errors():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch()
        with tiny.recorded() as drawn:
            one, metrics = LEARNER.update(state, batch, jr.key(1))
        y = _target(state, batch, np.asarray(drawn[0]))
        np.testing.assert_allclose(metrics["critic/loss"], _critic_loss(state.critics.now, batch, y), rtol=1e-9)
        step = jax.tree.map(lambda a, b: b - a, state.critics.now, one.critics.now)
        slope = jax.tree.map(lambda leaf: -np.sign(np.asarray(leaf)), step)  # Adam's first step is the gradient's sign
        assert tiny.slope_along(lambda c: _critic_loss(c, batch, y), state.critics.now, slope) > 0.0


@pytest.mark.parametrize(
    ("field", "value"), [("discount", 1.0), ("target_rate", 0.0), ("actor_delay", 0), ("value_weight", -1.0)]
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        TD3BC(**{field: value})
