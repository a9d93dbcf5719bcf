"""The inverse-dynamics model: outputs and loss against NumPy, and what its training reports."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from compilations import counted
from golden import inverse, tiny
from odaf.components.inverse_dynamics import InverseDynamicsConfig, fit_inverse, untrained_inverse
from odaf.components.pretraining import normalised_rows, split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError, DivergenceError

SMALL = InverseDynamicsConfig(hidden_sizes=(5, 4), latent_dim=3, log_std_min=-5.0)
each_encoder = pytest.mark.parametrize("encode_target", [False, True], ids=["as published", "sees the action"])


def _model(**fields):
    config = dataclasses.replace(SMALL, **fields)
    structure = jax.eval_shape(lambda: untrained_inverse(config, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    return tiny.filled(structure, 4)


@each_encoder
def test_outputs_and_loss_follow_the_formula(encode_target):
    with tiny.exactly():
        model, batch = _model(encode_target=encode_target), tiny.batch()
        noise = model.draw_noise(jr.key(1), tiny.ROWS)
        assert noise.shape == (tiny.ROWS, 3) and np.abs(noise).max() > 0.5
        mean, log_std = model.parameters(batch.observations, batch.next_observations, noise)
        expected_mean, expected_std = inverse.inverse(model, batch.observations, batch.next_observations, noise)
        np.testing.assert_allclose(mean, expected_mean, rtol=1e-9)
        np.testing.assert_allclose(np.exp(log_std), expected_std, rtol=1e-9)

        actions = batch.actions.at[0].set(1.0)  # one that is cut

        def loss(model):
            return model.loss(batch.observations, actions, batch.next_observations, jr.key(2))

        with tiny.recorded() as drawn:
            value = loss(model)

        def expected(model):
            return inverse.inverse_loss(model, batch.observations, actions, batch.next_observations, *drawn)

        np.testing.assert_allclose(value, expected(model), rtol=1e-9)
        tiny.assert_slopes(jax.jit(jax.grad(loss))(model), expected, model)


def test_the_log_standard_deviation_has_outputs_of_its_own():
    """The released code reads the mean's outputs twice; here neither half moves the other."""
    with tiny.exactly():
        model = eqx.tree_at(
            lambda m: m.log_std_offset, _model(log_std_min=-50.0), tiny.floats(-20.0)
        )  # far from both ends
        batch = tiny.batch()
        noise = model.draw_noise(jr.key(1), tiny.ROWS)

        def outputs(shift):
            moved = eqx.tree_at(lambda m: m.cvae.decoder.biases[-1], model, replace_fn=lambda b: b + tiny.floats(shift))
            return moved.parameters(batch.observations, batch.next_observations, noise)

        mean, log_std = outputs([0.0, 0.0, 0.0, 0.0])
        moved_mean, same_log_std = outputs([0.1, 0.2, 0.0, 0.0])
        same_mean, moved_log_std = outputs([0.0, 0.0, 0.1, 0.2])
    np.testing.assert_allclose(moved_mean - mean, np.tile([0.1, 0.2], (tiny.ROWS, 1)), rtol=1e-9)
    scale = float(model.log_std_scale)
    np.testing.assert_allclose(moved_log_std - log_std, scale * np.tile([0.1, 0.2], (tiny.ROWS, 1)), rtol=1e-9)
    np.testing.assert_array_equal(same_log_std, log_std)
    np.testing.assert_array_equal(same_mean, mean)


@pytest.mark.parametrize(
    ("low", "offset", "expected"), [(-5.0, -100.0, -5.0), (-20.0, -100.0, -20.0), (-5.0, 90.0, 2.0)]
)
def test_the_log_standard_deviation_is_held_between_its_ends(low, offset, expected):
    model = eqx.tree_at(lambda m: m.log_std_offset, _model(log_std_min=low), tiny.floats(offset))
    batch = tiny.batch()
    _, log_std = model.parameters(batch.observations, batch.next_observations, model.draw_noise(jr.key(1), tiny.ROWS))
    np.testing.assert_array_equal(log_std, np.full((tiny.ROWS, tiny.ACT_DIM), expected, np.float32))


TRAINED = InverseDynamicsConfig(hidden_sizes=(32,), latent_dim=4, steps=600, batch_size=64, learning_rate=3e-3)


def _fitted(config, dataset: Dataset, calls: list | None = None):
    calls = [] if calls is None else calls
    normaliser = Normaliser.fit(dataset.observations)
    return fit_inverse(config, dataset, normaliser, jr.key(0), lambda *done: calls.append(done), "inverse_dynamics")


@each_encoder
def test_the_actions_of_a_linear_system_are_found_far_better_than_by_their_mean(encode_target):
    dataset, calls = tiny.linear_dataset(), []
    config = dataclasses.replace(TRAINED, encode_target=encode_target)
    model, report = _fitted(config, dataset, calls)
    # a uniform action has variance 1/3; the published form reaches a few hundredths of that
    assert report["mean_action_mse"] == pytest.approx(1.0 / 3.0, rel=0.3)
    assert report["warnings"] == [] and report["holdout_rows"] == 25 and calls == [(600, 600)]
    assert report["error_ratio"] < 0.3, report["error_ratio"]
    assert report["error_ratio"] == pytest.approx(report["holdout_mse"] / report["mean_action_mse"])

    # measured on an episode that training never saw
    train, holdout = split_rows(dataset, config.holdout, jr.split(jr.key(0), 3)[0], "model", "leave it out")
    rows = normalised_rows(dataset, Normaliser.fit(dataset.observations), holdout)
    mean, _ = model.parameters(rows[0], rows[2], jnp.zeros((len(holdout), 4)))
    assert report["holdout_mse"] == pytest.approx(float(np.mean((np.tanh(mean) - rows[1]) ** 2)), rel=1e-4)
    naive = np.mean((dataset.actions[train].mean(axis=0) - dataset.actions[holdout]) ** 2)
    assert report["mean_action_mse"] == pytest.approx(naive, rel=1e-4)

    blank = jax.eval_shape(lambda: untrained_inverse(config, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    assert jax.tree.structure(blank) == jax.tree.structure(model)


def test_training_presses_the_standard_deviation_to_its_floor_even_where_actions_cannot_be_told():
    """Why the floor is a setting that matters: the state moves at random here, the action explains little of it."""
    noisy = tiny.linear_dataset(noise=1.0)
    _, free = _fitted(dataclasses.replace(TRAINED, log_std_min=-20.0), noisy)
    _, held = _fitted(TRAINED, noisy)
    assert free["error_ratio"] > 0.3, "an honest standard deviation could not be small"
    assert free["mean_log_std"] < -2.5
    assert held["mean_log_std"] == pytest.approx(TRAINED.log_std_min, abs=0.2)


def test_a_model_that_learnt_nothing_is_reported_with_the_remedy():
    _, report = _fitted(dataclasses.replace(TRAINED, steps=1, learning_rate=1e-6), tiny.linear_dataset(4, 10))
    (warning,) = report["warnings"]
    assert report["error_ratio"] >= 1.0
    assert "no better than always giving the mean action" in warning and "inverse_dynamics.model.steps" in warning


def test_a_loss_that_is_not_finite_stops_with_the_remedy():
    with pytest.raises(DivergenceError, match="inverse-dynamics model: .*lower inverse_dynamics.model.learning_rate"):
        _fitted(dataclasses.replace(TRAINED, steps=3, learning_rate=1e30), tiny.linear_dataset(4, 10))


def test_a_second_seed_compiles_nothing_and_early_stopping_measures_the_central_action():
    dataset = tiny.linear_dataset(4, 10)
    config = dataclasses.replace(TRAINED, hidden_sizes=(4,), steps=4000, learning_rate=0.0, batch_size=5, patience=1)
    normaliser = Normaliser.fit(dataset.observations)

    def fitted(key: int):
        return fit_inverse(config, dataset, normaliser, jr.key(key), lambda *done: None, "inverse_dynamics")[1]

    assert fitted(0)["steps"] == 2000, "nothing is learnt, so the first of two checks stays the best"
    with counted() as programs:
        fitted(1)
    assert not programs


def test_data_without_a_successor_is_refused():
    rows = np.arange(6, dtype=np.float32)[:, None] + np.zeros((1, 3), np.float32)
    dataset = Dataset.from_arrays(
        rows,
        np.zeros((6, 2)),
        rows[:, 0],
        next_observations=rows,
        terminated=[True] * 6,
        truncated=[False] * 6,
        action_bounds=(-1, 1),
    )
    with pytest.raises(DatasetError, match="inverse-dynamics model: of 6 rows 0.*inverse_dynamics.weight=0"):
        _fitted(TRAINED, dataset)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"steps": 0}, "model.steps=0"),
        ({"batch_size": 0}, "model.batch_size=0"),
        ({"patience": 0}, "model.patience=0"),
        ({"latent_dim": 0}, "model.latent_dim=0"),
        ({"hidden_sizes": ()}, "model.hidden_sizes"),
        ({"holdout": 0.0}, "model.holdout=0.0"),
        ({"log_std_min": 2.0}, "model.log_std_min=2.0"),
    ],
)
def test_settings_that_cannot_be_trained_are_refused(fields, named):
    with pytest.raises(ConfigError, match=named):
        InverseDynamicsConfig(**fields)
