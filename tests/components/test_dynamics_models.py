"""Dynamics models against their formulas: predictions, training losses, gradients of both."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import dynamics, networks, tiny
from odaf.components.dynamics import untrained
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics

KINDS = {
    "deterministic": {"kind": "deterministic"},
    "deterministic, absolute": {"kind": "deterministic", "residual": False},
    "cvae as printed": {"kind": "cvae", "residual": False},
    "cvae that sees the target": {"kind": "cvae", "encoder": "transition"},
    "ensemble": {"kind": "ensemble"},
    "ensemble, absolute": {"kind": "ensemble", "residual": False},
}
each_kind = pytest.mark.parametrize("fields", KINDS.values(), ids=KINDS)


def _model(fields):
    return tiny.dynamics_model(tiny.dynamics_config(**fields))


def _columns(rows: int = tiny.ROWS, seed: int = 0):
    batch = tiny.batch(rows, seed)
    return batch.observations, batch.actions, batch.next_observations


def _noise(model, fields, rows: int = tiny.ROWS):
    rng = np.random.default_rng(9)
    if fields["kind"] == "ensemble":
        return jnp.asarray(np.arange(rows) % 3), tiny.floats(rng.normal(size=(rows, tiny.OBS_DIM)))
    return tiny.floats(rng.normal(size=(rows, 3))) if fields["kind"] == "cvae" else ()


@each_kind
def test_predictions_follow_the_formula(fields):
    with tiny.exactly():
        model, (states, actions, _) = _model(fields), _columns()
        noise, predict = _noise(model, fields), dynamics.PREDICT[fields["kind"]]
        found, central = jax.jit(lambda m, s, a, n: (m.predict(s, a, n), m.expected(s, a)))(
            model, states, actions, noise
        )
        np.testing.assert_allclose(found, predict(model, states, actions, noise), rtol=1e-10)
        if fields["kind"] == "ensemble":
            calm = np.zeros((tiny.ROWS, tiny.OBS_DIM))
            members = [predict(model, states, actions, (np.full(tiny.ROWS, k), calm)) for k in range(3)]
            np.testing.assert_allclose(central, np.mean(members, axis=0), rtol=1e-10)
        else:
            quiet = jax.tree.map(np.zeros_like, noise)
            np.testing.assert_allclose(central, predict(model, states, actions, quiet), rtol=1e-10)


@each_kind
def test_training_losses_and_their_gradients_follow_the_formula(fields):
    with tiny.exactly():
        model, kind = _model(fields), fields["kind"]
        columns = _columns()
        if kind == "ensemble":  # every member sees rows of its own
            states, actions, after = zip(*(_columns(seed=seed) for seed in range(3)), strict=True)
            columns = (tiny.floats(states), tiny.floats(actions), tiny.floats(after))

        with tiny.recorded() as drawn:
            found = model.loss(*columns, jr.key(2))
        gradient = jax.jit(jax.grad(lambda m: m.loss(*columns, jr.key(2))))(model)
        losses = {
            "deterministic": lambda m: dynamics.deterministic_loss(m, *columns),
            "cvae": lambda m: dynamics.cvae_loss(m, *columns, drawn[0]),
            "ensemble": lambda m: dynamics.ensemble_loss(m, *columns),
        }
        np.testing.assert_allclose(found, losses[kind](model), rtol=1e-10)
        tiny.assert_slopes(gradient, losses[kind], model)


@pytest.mark.parametrize("residual", [True, False])
def test_outputs_and_states_are_each_others_inverse(residual):
    model, (states, _, after) = _model({"kind": "deterministic", "residual": residual}), _columns()
    back = model.to_state(states, model.to_output(states, after))
    np.testing.assert_allclose(back, after, rtol=1e-5, atol=1e-6)


def test_log_variances_stay_softly_between_their_bounds():
    model, (states, actions, _) = _model({"kind": "ensemble"}), _columns()
    model = eqx.tree_at(
        lambda m: (m.log_variance_max, m.log_variance_min), model, (jnp.full(3, 0.5), jnp.full(3, -10.0))
    )

    def log_variance(raw: float):
        # the network's last bias alone decides its output
        silent = jax.tree.map(jnp.zeros_like, model.network)
        muted = eqx.tree_at(lambda n: n.biases[-1], silent, jnp.full_like(silent.biases[-1], raw))
        return np.asarray(eqx.tree_at(lambda m: m.network, model, muted).moments(states, actions)[1])

    np.testing.assert_allclose(log_variance(-4.0), -4.0, atol=0.02)  # far from both bounds it is left alone
    np.testing.assert_allclose(log_variance(1e4), 0.5, atol=1e-4)
    np.testing.assert_allclose(log_variance(-1e4), -10.0, atol=1e-4)
    np.testing.assert_allclose(log_variance(0.5), 0.5 - np.log(2.0), atol=1e-4)


def test_log_variances_start_between_a_half_and_minus_ten():
    config = tiny.dynamics_config(kind="ensemble")
    model = jax.jit(lambda: untrained(config, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))()
    np.testing.assert_array_equal(model.log_variance_max, np.full(3, 0.5, np.float32))
    np.testing.assert_array_equal(model.log_variance_min, np.full(3, -10.0, np.float32))
    np.testing.assert_array_equal(model.scale, np.ones(3))
    np.testing.assert_array_equal(model.shift, np.zeros(3))


def test_the_prior_is_clipped_where_the_encoder_would_need_the_next_state():
    model, (states, actions, _) = _model({"kind": "cvae", "encoder": "transition"}), _columns()
    at = [model.predict(states, actions, jnp.full((tiny.ROWS, 3), z)) for z in (0.5, 3.0, 0.4)]
    np.testing.assert_array_equal(at[0], at[1])
    assert not np.array_equal(at[0], at[2])


def test_an_ensembles_noise_names_members_evenly():
    members, normal = _model({"kind": "ensemble"}).draw_noise(jr.key(0), 3000)
    counts = np.bincount(np.asarray(members), minlength=3)
    assert counts.sum() == 3000 and np.abs(counts - 1000).max() < 130  # five deviations of 26
    assert normal.shape == (3000, tiny.OBS_DIM)


def test_the_best_members_are_kept_best_first():
    with tiny.exactly():
        model = tiny.dynamics_model(tiny.dynamics_config(kind="ensemble", members=6, elites=6))
        states, actions, after = _columns(40)
        inputs = np.concatenate([networks.numbers(states), networks.numbers(actions)], axis=1)
        change = networks.numbers(after) - networks.numbers(states)
        wanted = (change - networks.numbers(model.shift)) / networks.numbers(model.scale)
        errors = [np.mean((dynamics.gaussian_moments(model, inputs, member)[0] - wanted) ** 2) for member in range(6)]
        by_member = np.asarray(model.errors(states, actions, after)).mean(axis=0)
        np.testing.assert_allclose(by_member, errors, rtol=1e-9)
        kept = model.finished(by_member, 3)
        assert isinstance(model, GaussianEnsembleDynamics) and isinstance(kept, GaussianEnsembleDynamics)
        np.testing.assert_array_equal(
            kept.network.weights[0], np.asarray(model.network.weights[0])[np.argsort(errors)[:3]]
        )
