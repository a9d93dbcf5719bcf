"""Models of whoever acted in the log, against NumPy, and what their training reports."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import behaviour, networks, tiny
from odaf.components.behaviour_models import (
    BehaviourConfig,
    fit_behaviour_cvae,
    fit_clone,
    init_behaviour_cvae,
)
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError

LATENTS = 2 * tiny.ACT_DIM


def _model():
    structure = jax.eval_shape(lambda: init_behaviour_cvae(jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM, (5, 4)))
    return tiny.filled(structure, 4)


def test_misfit_and_loss_are_means_of_both_parts_and_gradients_reach_the_action_by_both_ways():
    with tiny.exactly():
        model, batch = _model(), tiny.batch()
        noise = model.draw_noise(jr.key(1), tiny.ROWS)
        states, actions = batch.observations, batch.actions

        @jax.jit
        def everything(model, actions):
            misfit = model.misfit(states, actions, noise)
            loss, gradient = jax.value_and_grad(lambda m: m.loss(states, actions, noise))(model)
            return misfit, loss, gradient, jax.grad(lambda a: model.loss(states, a, noise))(actions)

        misfit, loss, gradient, by_action = everything(model, actions)
        expected = behaviour.misfit(model, states, actions, noise)
        np.testing.assert_allclose(misfit, expected, rtol=1e-9)
        np.testing.assert_allclose(loss, expected.mean(), rtol=1e-9)
        tiny.assert_slopes(gradient, lambda m: behaviour.misfit(m, states, actions, noise).mean(), model)
        tiny.assert_slopes(by_action, lambda a: behaviour.misfit(model, states, a, noise).mean(), actions)


def test_the_spread_of_z_is_cut_while_training_and_z_itself_while_drawing():
    with tiny.exactly():
        model, batch = _model(), tiny.batch()
        states = batch.observations
        low = eqx.tree_at(lambda m: m.cvae.encoder.biases[-1], model, replace_fn=lambda b: b.at[LATENTS:].add(-100.0))
        one = jnp.ones((tiny.ROWS, LATENTS))
        np.testing.assert_allclose(
            low.misfit(states, batch.actions, one), behaviour.misfit(low, states, batch.actions, one), rtol=1e-9
        )
        np.testing.assert_allclose(low.cvae.encode(states, batch.actions)[1], np.full((tiny.ROWS, LATENTS), -4.0))
        wide, at_half = model.before_tanh(states, 7.0 * one), model.before_tanh(states, 0.5 * one)
        np.testing.assert_array_equal(wide, at_half)
        beside = np.concatenate([networks.numbers(states), 0.5 * np.ones((tiny.ROWS, LATENTS))], axis=1)
        np.testing.assert_allclose(at_half, networks.mlp(model.cvae.decoder, beside), rtol=1e-9)
        np.testing.assert_allclose(model.act(states, one), np.tanh(at_half), rtol=1e-12)


def _controlled():
    """Actions follow the states, with a little noise; so the mean action is a bad guess."""
    dataset, rng = tiny.linear_dataset(), np.random.default_rng(3)
    followed = np.tanh(dataset.observations[:, :2]) + 0.05 * rng.normal(size=dataset.actions.shape)
    return dataclasses.replace(dataset, actions=np.clip(followed, -1.0, 1.0))


@pytest.mark.parametrize("train", [fit_behaviour_cvae, fit_clone])
def test_what_is_fitted_is_measured_on_other_episodes_against_the_mean_action(train):
    dataset, calls = _controlled(), []
    config = BehaviourConfig(hidden_sizes=(24,), steps=500, batch_size=64, learning_rate=5e-3)
    _, report = train(
        config, dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *done: calls.append(done)
    )
    assert report["warnings"] == [] and report["holdout_rows"] == 25 and calls == [(500, 500)]
    assert report["holdout_error"] < 0.3 * report["mean_action_mse"]


def test_a_model_of_actions_that_follow_nothing_is_warned_of():
    dataset = tiny.linear_dataset()  # its actions are random
    config = BehaviourConfig(hidden_sizes=(24,), steps=500, batch_size=64, learning_rate=5e-3)
    _, report = fit_clone(config, dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *_: None)
    assert "mean action" in report["warnings"][0]


def test_actions_that_ended_episodes_are_learned_from_even_without_a_state_after_them():
    states = np.linspace(-1.0, 1.0, 12)[:, None]
    actions = np.where(states > 0.0, 0.8, -0.8)  # every row is an episode and repeats its own state as a placeholder
    log = Dataset.from_arrays(
        states, actions, states[:, 0], next_observations=states, terminated=[True] * 12, action_bounds=(-1, 1)
    )
    config = BehaviourConfig(hidden_sizes=(8,), steps=1, batch_size=4, holdout=0.25)
    _, report = fit_clone(config, log, Normaliser.fit(log.observations), jr.key(0), lambda *_: None)
    assert report["holdout_rows"] == 3


def test_a_log_of_one_row_is_refused():
    row = np.zeros((1, 1))
    log = Dataset.from_arrays(row, row, [0.0], next_observations=row, terminated=[True], action_bounds=(-1, 1))
    with pytest.raises(DatasetError, match="the log has 1 row; at least 2 are needed, or take"):
        fit_clone(BehaviourConfig(), log, Normaliser.fit(log.observations), jr.key(0), lambda *_: None)


@pytest.mark.parametrize(("field", "value"), [("steps", 0), ("batch_size", 0), ("holdout", 0.0), ("hidden_sizes", ())])
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=f"behaviour.{field}"):
        BehaviourConfig(**{field: value})
