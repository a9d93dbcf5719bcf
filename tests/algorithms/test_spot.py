"""SPOT against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.random as jr
import numpy as np
import pytest

from golden import behaviour, networks, tiny
from odaf.algorithms.spot import SPOT, actor_loss
from odaf.components.behaviour_models import BehaviourConfig
from odaf.components.critics import CriticEnsemble
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = SPOT(
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    discount=0.9,
    reward_shift=-1.0,
    support_weight=0.7,
    dropout=0.25,
    behaviour=BehaviourConfig(hidden_sizes=(5, 4)),
)


def _mode(actor, observations, masks) -> np.ndarray:
    """The layers of mu one after another; a hidden unit that is kept counts 1 / (1 - 0.25)-fold."""
    x, layers = networks.numbers(observations), actor.network
    for layer, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        x = x @ networks.numbers(weight) + networks.numbers(bias)
        if layer < 2:
            x = np.maximum(x, 0.0) * (np.asarray(masks[layer], float) / 0.75 if masks else 1.0)
    return np.tanh(x)


def test_the_target_asks_the_slow_actor_while_it_drops_units_and_only_ends_cut_it():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch()
        with tiny.recorded("bernoulli") as masks, tiny.recorded() as noise:
            y = LEARNER.target(state, batch, jr.key(5))
        assert [mask.shape for mask in masks] == [(tiny.ROWS, 5), (tiny.ROWS, 4)]
        assert 0 < np.sum(~masks[0]) < masks[0].size
        actions = _mode(state.actor.slow, batch.next_observations, masks)
        actions = np.clip(actions + np.clip(0.2 * noise[0], -0.5, 0.5), -1.0, 1.0)
        values = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, actions).min(axis=0)
        ends = np.array([0, 0, 1, 0, 0, 1])  # time-outs are no ends: their rows are like any other
        expected = networks.numbers(batch.rewards) - 1.0 + 0.9 * (1 - ends) * values
        np.testing.assert_allclose(y, expected, rtol=1e-9)


def test_the_actor_climbs_the_first_critic_and_pays_for_actions_of_low_density():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch()
        actor, critics, model = state.actor.now, CriticEnsemble(state.critics.now), state.models
        noise = model.draw_noise(jr.key(1), tiny.ROWS)
        with tiny.recorded("bernoulli") as masks:
            factors = LEARNER.factors(jr.key(2), tiny.ROWS)
        values = networks.q_values(critics, batch.observations, _mode(actor, batch.observations, masks))
        critics = CriticEnsemble(tiny.levelled(critics.networks, values))
        size = np.abs(values[0] - np.median(values[0])).mean()

        def expected(actor) -> float:
            actions = _mode(actor, batch.observations, masks)
            first = networks.q_values(critics, batch.observations, actions)[0]
            return float(np.mean(0.7 * behaviour.misfit(model, batch.observations, actions, noise) - first / size))

        def loss(actor, critics):
            return actor_loss(actor, critics, batch, model, 0.7, factors, noise)

        (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(actor, critics)
        np.testing.assert_allclose(value, expected(actor), rtol=1e-9)
        assert set(metrics) == set(state.actor_metrics)
        tiny.assert_slopes(gradient, expected, actor)  # the size is a constant; l has a slope by both of its ways
        assert tiny.all_zero(jax.grad(lambda c: loss(actor, c)[0])(critics))


def test_units_are_dropped_by_the_key_alone_and_never_while_acting():
    with tiny.exactly():
        state, states = tiny.twin_delayed_state(LEARNER), tiny.batch().observations
        actor = state.actor.now
        same, again, other = (actor.with_dropout(states, LEARNER.factors(jr.key(key), tiny.ROWS)) for key in (1, 1, 2))
        np.testing.assert_array_equal(same, again)
        assert np.any(np.asarray(same) != np.asarray(other))
        with tiny.recorded("bernoulli") as drawn:
            acted, _ = LEARNER.actor(state).act((), states, jr.key(3))
        np.testing.assert_allclose(acted, _mode(actor, states, []), rtol=1e-9)
    assert drawn == []
    assert dataclasses.replace(LEARNER, dropout=0.0).factors(jr.key(1), tiny.ROWS) == ()


def test_ant_mazes_start_with_small_outputs():
    small = dataclasses.replace(LEARNER, small_outputs=True, hidden_sizes=(3, 40))
    models = small.untrained(jr.key(0), tiny.SPEC)
    state = small.init(jr.key(0), tiny.SPEC, models)
    for network, bound in ((state.actor.now.network, 1e-3), (state.critics.now, 3e-3)):
        largest = float(np.abs(network.weights[-1]).max())
        assert 0.8 * bound < largest <= bound
    plain = dataclasses.replace(small, small_outputs=False).init(jr.key(0), tiny.SPEC, models)
    assert float(np.abs(plain.critics.now.weights[-1]).max()) > 0.1


@pytest.mark.parametrize(
    ("task", "weight"),
    [
        ("halfcheetah-medium", 0.05),
        ("halfcheetah-medium-expert", 1.0),
        ("hopper-medium-replay", 0.1),
        ("hopper-medium-expert", 0.2),
        ("walker2d-medium", 0.2),
        ("walker2d-medium-expert", 0.5),
        ("antmaze-umaze", 0.25),
        ("antmaze-medium-play", 0.05),
        ("antmaze-large-diverse", 0.025),
    ],
)
def test_tasks_are_as_published(task, weight):
    learner = presets.load("spot", task=task)
    assert learner.support_weight == weight
    rest = (learner.actor_learning_rate, learner.dropout, learner.small_outputs, learner.reward_shift)
    assert rest == ((1e-4, 0.0, True, -1.0) if task.startswith("antmaze") else (3e-4, 0.1, False, 0.0))


@pytest.mark.parametrize(
    ("field", "value"), [("support_weight", -1.0), ("dropout", 1.0), ("num_critics", 0), ("actor_decay_updates", -1)]
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        SPOT(**{field: value})
