"""SVR against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.svr import SVR, actor_loss, critic_gradient, support_weights
from odaf.components.behaviour_models import BehaviourConfig
from odaf.components.critics import CriticEnsemble
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = SVR(
    num_critics=3,
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    discount=0.9,
    support_weight=0.3,
    support_noise=0.5,
    lowest_value=-1.5,
    behaviour=BehaviourConfig(hidden_sizes=(4,)),
)


def _state(step: int = 0):
    """Random networks, with the lowest value that the learner names."""
    state = tiny.twin_delayed_state(LEARNER, step)
    return dataclasses.replace(state, models=dataclasses.replace(state.models, lowest_value=tiny.floats(-1.5)))


def _mode(actor, observations) -> np.ndarray:
    return np.tanh(networks.mlp(actor.network, observations))


def _weights(state, batch) -> np.ndarray:
    """A ratio of two densities of one spread, each with a mean over dimensions in its exponent; at least 0.1."""
    densities = []
    for actor in (state.actor.now, state.models.behaviour):
        gaps = _mode(actor, batch.observations) - networks.numbers(batch.actions)
        densities.append(np.exp(-np.mean(gaps**2, axis=1) / (2.0 * 0.5**2)))
    return np.maximum(0.1, densities[0] / densities[1])


def _critic_loss(critics, batch, y, beside, weights) -> float:
    values = networks.q_values(critics, batch.observations, batch.actions)
    others = networks.q_values(critics, batch.observations, beside)
    support = np.maximum(-1e4, (others + 1.5) ** 2 - weights * (values + 1.5) ** 2)
    return float(np.sum(np.mean((values - y) ** 2, axis=1)) + 0.3 * np.mean(support))


def test_the_target_takes_the_lowest_value_of_the_slow_actors_own_action():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        actions = _mode(state.actor.slow, batch.next_observations)
        values = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, actions)
        critics = tiny.levelled(state.critics.slow, values)
        values = networks.q_values(CriticEnsemble(critics), batch.next_observations, actions)
        state = dataclasses.replace(state, critics=dataclasses.replace(state.critics, slow=critics))
        with tiny.recorded() as drawn:
            y = LEARNER.target(state, batch, jr.key(5))
        assert drawn == []
    assert len(set(values.argmin(axis=0))) > 1  # not one critic alone is the lowest
    ends = np.array([0, 0, 1, 0, 0, 1])  # time-outs are no ends: their rows are like any other
    np.testing.assert_allclose(y, networks.numbers(batch.rewards) + 0.9 * (1 - ends) * values.min(axis=0), rtol=1e-9)


def test_a_logged_action_weighs_what_the_policy_gives_it_against_the_clone_but_never_too_little():
    rng = np.random.default_rng(0)
    actions, cloned, logged = (tiny.floats(rng.uniform(-1.0, 1.0, (tiny.ROWS, 2))) for _ in range(3))
    weights = support_weights(actions, cloned, logged, 0.3, 0.1)
    mean = [np.mean((np.asarray(of) - np.asarray(logged)) ** 2, axis=1) for of in (actions, cloned)]
    plain = np.exp(-mean[0] / 0.18) / np.exp(-mean[1] / 0.18)
    np.testing.assert_allclose(weights, np.maximum(0.1, plain), rtol=1e-4)
    assert np.any(plain < 0.1) and np.any(plain > 1.0)
    assert tiny.all_zero(jax.grad(lambda a: jnp.sum(support_weights(a, cloned, logged, 0.3, 0.1)))(actions))
    assert np.all(np.isfinite(support_weights(logged, -logged, logged, 1e-3, 0.1)))


def test_the_critics_gradient_has_a_mean_over_critics_beside_the_sum_and_a_floor():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        rng = np.random.default_rng(1)
        beside, y = tiny.floats(rng.uniform(-1.0, 1.0, (tiny.ROWS, 2))), tiny.floats(rng.normal(size=tiny.ROWS))
        weights = tiny.floats([0.1, 2.0, 1e15, 0.5, 1.0, 3.0])  # the third row is at the floor
        critics = CriticEnsemble(state.critics.now)
        gradient, values, metrics = critic_gradient(critics, batch, y, beside, weights, -1.5, 0.3)

        def expected(critics) -> float:
            return _critic_loss(critics, batch, np.asarray(y), beside, np.asarray(weights))

        tiny.assert_slopes(gradient, expected, critics)
        np.testing.assert_allclose(values, networks.q_values(critics, batch.observations, batch.actions), rtol=1e-9)
        found = float(metrics["critic/loss"] + 0.3 * metrics["critic/support"])
        np.testing.assert_allclose(found, expected(critics), rtol=1e-9)
        np.testing.assert_allclose(metrics["critic/support/floored"], 1.0 / tiny.ROWS, rtol=1e-9)
        huge = critic_gradient(critics, batch, y, beside, weights.at[2].set(np.exp(80.0)), -1.5, 0.3)[0]
        tiny.assert_close(huge, gradient, rtol=1e-12)  # at the floor there is no slope, however large w


def test_the_actor_climbs_the_lowest_value_alone():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        actor, critics = state.actor.now, CriticEnsemble(state.critics.now)
        values = networks.q_values(critics, batch.observations, _mode(actor, batch.observations))
        critics = CriticEnsemble(tiny.levelled(critics.networks, values))

        def lowest(actor) -> np.ndarray:
            return networks.q_values(critics, batch.observations, _mode(actor, batch.observations)).min(axis=0)

        size = np.abs(lowest(actor)).mean()
        (loss, metrics), gradient = jax.value_and_grad(actor_loss, has_aux=True)(actor, critics, batch)
        np.testing.assert_allclose(loss, -2.5 * lowest(actor).mean() / size, rtol=1e-9)
        assert set(metrics) == set(state.actor_metrics)
        tiny.assert_slopes(gradient, lambda a: -2.5 * lowest(a).mean() / size, actor)
        assert tiny.all_zero(jax.grad(lambda c: actor_loss(actor, c, batch)[0])(critics))


def test_an_update_weighs_by_the_actor_before_its_step_and_the_frozen_clone():
    with tiny.exactly():
        state, batch = _state(step=1), tiny.batch()  # the actor's turn
        with tiny.recorded() as drawn:
            after, metrics = LEARNER.update(state, batch, jr.key(1))
        beside = np.clip(_mode(state.actor.now, batch.observations) + 0.5 * drawn[0], -1.0, 1.0)
        assert len(drawn) == 1 and np.any(np.abs(beside) == 1.0)
        y = np.asarray(LEARNER.target(state, batch, jr.key(0)))
        expected = _critic_loss(CriticEnsemble(state.critics.now), batch, y, beside, _weights(state, batch))
        found = float(metrics["critic/loss"] + 0.3 * metrics["critic/support"])
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        assert np.any(np.asarray(after.actor.now.network.weights[0]) != np.asarray(state.actor.now.network.weights[0]))


def test_the_lowest_value_is_what_the_logged_rewards_allow_unless_it_is_given():
    spec = dataclasses.replace(tiny.SPEC, reward_min=0.0, reward_max=1.0)
    learner = dataclasses.replace(LEARNER, lowest_value="log", discount=0.99)

    def lowest(learner, spec) -> float:
        return float(learner.init(jr.key(0), spec, learner.untrained(jr.key(0), spec)).models.lowest_value)

    assert lowest(learner, spec) == 0.0
    assert lowest(learner, dataclasses.replace(spec, reward_min=-2.0)) == pytest.approx(-200.0)
    assert lowest(learner, dataclasses.replace(spec, reward_min=1.0)) == 1.0  # an end may follow at once
    assert lowest(dataclasses.replace(learner, reward_shift=-1.0), spec) == pytest.approx(-100.0)
    assert lowest(LEARNER, spec) == -1.5


@pytest.mark.parametrize(
    ("task", "weight", "lowest"),
    [
        ("halfcheetah-random", 0.001, -366.0),
        ("hopper-medium-replay", 0.001, -125.0),
        ("walker2d-medium-expert", 0.02, -471.0),
        ("hopper-expert", 0.02, -125.0),
    ],
)
def test_tasks_are_as_published(task, weight, lowest):
    learner = presets.load("svr", task=task)
    assert (learner.support_weight, learner.lowest_value) == (weight, lowest)
    assert len(presets.tasks("svr")) == 15


@pytest.mark.parametrize(("field", "value"), [("support_noise", 0.0), ("weight_floor", -0.1), ("target_noise", -1.0)])
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        SVR(**{field: value})
