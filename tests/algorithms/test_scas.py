"""SCAS against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.scas import SCAS, actor_loss
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics import DynamicsConfig
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = SCAS(
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    discount=0.9,
    state_noise=0.2,
    dynamics=DynamicsConfig(hidden_sizes=(5, 4), residual=False),
)
EXTRAS = ("successor_known",)  # rows 2 and 5 are ends without a next state of their own


def _mode(actor, observations) -> np.ndarray:
    return np.tanh(networks.mlp(actor.network, observations))


def _values(critics, actor, states) -> np.ndarray:
    return networks.q_values(critics, states, _mode(actor, states))


@pytest.mark.parametrize("reduce", ["min", "mean"])
def test_the_target_is_of_the_lowest_of_four_or_of_their_mean(reduce):
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch(extras=EXTRAS)
        plain = _values(CriticEnsemble(state.critics.slow), state.actor.slow, batch.next_observations)
        critics = tiny.levelled(state.critics.slow, plain)
        state = dataclasses.replace(state, critics=dataclasses.replace(state.critics, slow=critics))
        with tiny.recorded() as drawn:
            y = dataclasses.replace(LEARNER, target=reduce).targets(state, batch, jr.key(5))
        actions = _mode(state.actor.slow, batch.next_observations)
        actions = np.clip(actions + np.clip(0.2 * drawn[0], -0.5, 0.5), -1.0, 1.0)
        values = networks.q_values(CriticEnsemble(critics), batch.next_observations, actions)
    assert len(values) == 4 and len(set(values.argmin(axis=0))) > 1
    ends = np.array([0, 0, 1, 0, 0, 1])  # time-outs are no ends: their rows are like any other
    expected = networks.numbers(batch.rewards) + 0.9 * (1 - ends) * getattr(np, reduce)(values, axis=0)
    np.testing.assert_allclose(y, expected, rtol=1e-9)


def test_the_actor_acts_at_the_state_itself_and_is_drawn_to_good_successors():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch(extras=EXTRAS)
        actor, critics, dynamics = state.actor.now, CriticEnsemble(state.critics.now), state.models
        offsets = tiny.floats(0.2 * np.random.default_rng(2).normal(size=(tiny.ROWS, tiny.OBS_DIM)))
        here, later = (_values(critics, actor, states) for states in (batch.observations, batch.next_observations))
        weights = np.minimum(2.0, np.exp(3.0 * (later.mean(axis=0) - here.mean(axis=0))))
        assert np.any(weights == 2.0) and np.any(weights < 1.0)
        size = np.abs(here.min(axis=0)).mean()

        def expected(actor) -> float:
            beside = np.concatenate(
                [networks.numbers(batch.observations + offsets), _mode(actor, batch.observations)], axis=1
            )
            scale, shift = networks.numbers(dynamics.scale), networks.numbers(dynamics.shift)
            gaps = shift + scale * networks.mlp(dynamics.network, beside) - networks.numbers(batch.next_observations)
            rows = [weights[row] * np.mean(gaps[row] ** 2) for row in (0, 1, 3, 4)]
            climbed = _values(critics, actor, batch.observations).min(axis=0).mean() / size
            return float(0.3 * np.mean(rows) - 0.7 * climbed)

        def loss(actor, critics):
            return actor_loss(actor, critics, batch, dynamics, offsets, 0.3, 3.0, 2.0)

        (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(actor, critics)
        np.testing.assert_allclose(value, expected(actor), rtol=1e-9)
        assert set(metrics) == set(state.actor_metrics)
        np.testing.assert_allclose(metrics["actor/capped"], np.mean(weights == 2.0))
        tiny.assert_slopes(gradient, expected, actor)  # weights and size are constants
        assert tiny.all_zero(jax.grad(lambda c: loss(actor, c)[0])(critics))


def test_an_update_uses_noise_of_its_own_and_published_weights():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER, step=1), tiny.batch(extras=EXTRAS)  # the actor's turn
        with tiny.recorded() as drawn:
            after, metrics = LEARNER.update(state, batch, jr.key(1))
        offsets, _ = drawn
        critics = CriticEnsemble(after.critics.now)
        loss, _ = actor_loss(state.actor.now, critics, batch, state.models, tiny.floats(0.2 * offsets), 0.25, 5.0, 50.0)
    np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-6)  # against the new critics


def test_no_gradient_passes_through_the_weights_however_large():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), tiny.batch(extras=EXTRAS)
        critics = CriticEnsemble(state.critics.now)
        offsets = tiny.floats(np.zeros((tiny.ROWS, tiny.OBS_DIM)))
        gradient = jax.grad(lambda a: actor_loss(a, critics, batch, state.models, offsets, 0.3, 1e6, 50.0)[0])(
            state.actor.now
        )
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


def test_tasks_are_as_published():
    assert len(presets.tasks("scas")) == 18  # the paper has no expert logs
    plain, maze = presets.load("scas", task="hopper-medium"), presets.load("scas", task="antmaze-large-play")
    assert plain == presets.load("scas") == SCAS()
    assert (plain.target, plain.reward_shift, maze.target, maze.reward_shift) == ("min", 0.0, "mean", -1.0)
    assert maze.observation_scaling == "none"
    assert dataclasses.replace(maze, target="min", reward_shift=0.0, observation_scaling="standard") == plain
    medium = presets.load("scas", task="antmaze-medium-play")
    assert dataclasses.replace(medium, observation_scaling="none") == maze  # raw observations in the large mazes alone


@pytest.mark.parametrize(
    ("field", "value"), [("correction", 1.5), ("weight_cap", 0.0), ("state_noise", -1.0), ("inverse_temperature", -1.0)]
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        SCAS(**{field: value})
