"""The ensemble of transitions: its loss and draws against NumPy, and what training, elites and the report go by."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import tiny, transitions
from odaf.components.dynamics import EnsembleConfig, TransitionEnsemble, fit_transitions, transition_fit
from odaf.components.pretraining import split_rows
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DivergenceError

SMALL = EnsembleConfig(
    hidden_sizes=(16,), members=4, elites=2, epochs=24, epoch_steps=20, batch_size=32, learning_rate=1e-2, holdout=0.2
)
DECAY = jnp.asarray([0.3, 0.2, 0.1])
NOISE = 0.3


@functools.cache
def _model() -> TransitionEnsemble:
    """Three members with random parameters everywhere, of which two answer."""
    config = EnsembleConfig(hidden_sizes=(5, 4), members=3, elites=2)
    shape = eqx.filter_eval_shape(lambda: config.untrained(jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    model = tiny.filled(shape, 1)
    positive = (jnp.abs(model.input_std) + 0.5, jnp.abs(model.unit) + 0.5)
    return eqx.tree_at(lambda m: (m.input_std, m.unit), model, positive)


def _rows(rows: int, seed: int = 0):
    batch = tiny.batch(rows, seed)
    return batch.observations, batch.actions, batch.rewards, batch.next_observations


def test_the_loss_is_the_members_likelihoods_with_decay_by_layer_and_bounds():
    by_member = tuple(jnp.stack(parts) for parts in zip(*(_rows(6, seed) for seed in range(3)), strict=True))
    states, actions, rewards, following = by_member
    found = _model().loss(states, actions, rewards, following, DECAY)
    np.testing.assert_allclose(found, transitions.loss(_model(), states, actions, rewards, following, DECAY), rtol=2e-5)


def test_transitions_are_the_inverse_of_targets_and_states_go_back_to_the_users_units():
    states, _, rewards, following = _rows(6)
    after, earned = _model().transition(states, _model().targets(states, rewards, following))
    np.testing.assert_allclose(after, following, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(earned, rewards)
    normaliser = Normaliser(mean=np.array([1.0, 2.0, 3.0]), std=np.array([0.5, 4.0, 1.0]), constant=(2,))
    unit = jnp.asarray([0.5, 4.0, 1.0])
    model = eqx.tree_at(lambda m: (m.centre, m.unit), _model(), (jnp.asarray(normaliser.mean), unit))
    states = states.at[:, 2].set(0.0)  # as a learner sees a column that never varied
    np.testing.assert_allclose(model.in_user_units(states), normaliser.denormalise(states), rtol=1e-6)


@pytest.mark.parametrize("kind", ["deviation", "disagreement", "spread"])
def test_uncertainty_is_that_of_all_members_in_the_logs_units(kind):
    states, actions, _, _ = _rows(6)
    model = _model()
    _, _, doubt = jax.jit(lambda key: model.draw_and_doubt(states, actions, key, kind))(jr.key(0))
    np.testing.assert_allclose(doubt, transitions.uncertainty(model, states, actions, kind), rtol=2e-5)


def _means() -> tuple[TransitionEnsemble, np.ndarray]:
    """Without noise, and what each member then says of (s', r) for seven rows: [members, rows, obs_dim + 1]."""
    quiet = jnp.full(tiny.OBS_DIM + 1, -60.0)
    model = eqx.tree_at(lambda m: (m.log_variance_max, m.log_variance_min), _model(), (quiet, quiet - 1.0))
    states, actions, _, _ = _rows(7)
    said = []
    for member in range(3):
        mean, _ = transitions.moments(model, states, actions, member)
        after = np.asarray(states, float) + mean[:, :-1] / np.asarray(model.unit, float)
        said.append(np.concatenate([after, mean[:, -1:]], axis=1))
    return model, np.stack(said)


@pytest.mark.parametrize("of_all", [False, True])
def test_every_row_comes_from_an_elite_of_its_own_drawn_anew_each_time(of_all):
    model, said = _means()
    states, actions, _, _ = _rows(7)  # not a multiple of the elites

    @jax.jit
    def draw(key):
        found = (
            model.draw_and_doubt(states, actions, key, "deviation")[:2] if of_all else model.draw(states, actions, key)
        )
        return jnp.concatenate([found[0], found[1][:, None]], axis=1)

    picks = []
    for seed in range(60):
        apart = np.abs(said - np.asarray(draw(jr.key(seed)))[None]).max(axis=2)  # members, rows
        assert apart.min(axis=0).max() < 1e-5, "each row is one member's answer"
        picks.append(apart.argmin(axis=0))
    picks = np.asarray(picks)
    assert picks.max() == 1, "the third member is no elite"
    # 60 draws of one in two: 12 to 48 is five deviations either way; so are neighbours that agree
    assert np.all(np.abs(picks.sum(axis=0) - 30) < 18)
    together = np.asarray([[np.sum(picks[:, one] == picks[:, two]) for one in range(7)] for two in range(7)])
    assert np.all(np.abs(together[~np.eye(7, dtype=bool)] - 30) < 20)


def test_draws_have_the_spread_that_the_member_says():
    states, actions, _, _ = _rows(1)
    one = eqx.tree_at(lambda m: m.network, _model(), jax.tree.map(lambda leaf: leaf[:1], _model().network))
    one = dataclasses.replace(one, elites=1)
    many = jnp.broadcast_to(states, (4000, 3)), jnp.broadcast_to(actions, (4000, 2))
    mean, variance = transitions.moments(one, states, actions, 0)
    ways = jax.jit(lambda key: one.draw(*many, key)), jax.jit(lambda key: one.draw_and_doubt(*many, key, "spread"))
    for draw in ways:
        after, rewards = draw(jr.key(0))[:2]
        found = np.concatenate([(after - states) * one.unit[None], rewards[:, None]], axis=1)
        # of 4000 draws: a mean is off by 0.016 deviations, a variance by 2.2 %
        np.testing.assert_allclose(found.mean(axis=0), mean[0], atol=0.08 * float(np.sqrt(variance.max())))
        np.testing.assert_allclose(found.var(axis=0), variance[0], rtol=0.12)


@functools.cache
def _dataset():
    return tiny.linear_dataset(noise=NOISE)


@functools.cache
def _fitted(**changes):
    dataset = _dataset()
    normaliser = Normaliser.fit(dataset.observations)
    calls = []
    config = dataclasses.replace(SMALL, **changes)
    found = fit_transitions(config, dataset, normaliser, jr.key(0), lambda *done: calls.append(done))
    return *found, calls


def _held_out():
    dataset, normaliser = _dataset(), Normaliser.fit(_dataset().observations)
    train, holdout = split_rows(dataset, SMALL.holdout, jr.split(jr.key(0), 4)[0], "model", "leave it")
    states, after = (normaliser.normalise(c) for c in (dataset.observations, dataset.next_observations))
    return dataset, states, after, train, holdout


def test_a_noisy_linear_system_is_learnt_and_the_spread_covers_what_comes():
    model, report, calls = _fitted()
    assert report["kind"] == "transition ensemble" and report["warnings"] == []
    assert report["holdout_rows"] == 100 and calls[-1][1] == 24 * 20
    noise = float(np.mean(np.square(NOISE / np.asarray(model.unit))))  # no model can be better but by chance
    assert 0.7 * noise < report["holdout_mse"] < 1.5 * noise < report["no_change_mse"]
    assert report["reward_mse"] < 0.1 * report["mean_reward_mse"]
    assert 0.35 < report["coverage_50"] < 0.65 and 0.8 < report["coverage_90"] < 0.97
    assert len(report["coverage_90_by_dimension"]) == tiny.OBS_DIM + 1
    blank = jax.eval_shape(lambda: SMALL.untrained(jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    assert jax.tree.structure(blank) == jax.tree.structure(model)
    assert [leaf.shape for leaf in jax.tree.leaves(blank)] == [leaf.shape for leaf in jax.tree.leaves(model)]


def test_the_report_is_of_episodes_never_seen_and_inputs_are_scaled_by_those_seen():
    model, report, _ = _fitted()
    dataset, states, after, train, holdout = _held_out()
    rows = np.concatenate([states[train], dataset.actions[train]], axis=1)
    np.testing.assert_allclose(model.input_mean, rows.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(model.input_std, rows.std(axis=0), rtol=1e-4)
    held, actions, rewards = states[holdout], dataset.actions[holdout], dataset.rewards[holdout]
    means, variances = zip(*(transitions.moments(model, held, actions, member) for member in range(4)), strict=True)
    unit = np.asarray(model.unit, float)
    wanted = np.concatenate([(after[holdout] - held) * unit, rewards[:, None]], axis=1)
    by_member = [np.mean((mean - wanted) ** 2) for mean in means]
    np.testing.assert_allclose(report["error_by_member"], by_member, rtol=1e-3)
    assert report["error_by_member"] == sorted(report["error_by_member"]), "elites come first"
    mean = np.mean(means[:2], axis=0)
    predicted = held + mean[:, :-1] / unit
    assert report["holdout_mse"] == pytest.approx(np.mean((predicted - after[holdout]) ** 2), rel=1e-3)
    assert report["no_change_mse"] == pytest.approx(np.mean((held - after[holdout]) ** 2), rel=1e-3)
    assert report["reward_mse"] == pytest.approx(np.mean((mean[:, -1] - rewards) ** 2), rel=1e-3)
    # the chance of less by the two elites together, from many draws
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(2, 4000, *wanted.shape))
    draws = np.stack(means[:2])[:, None] + np.sqrt(np.stack(variances[:2]))[:, None] * noise
    low, high = np.quantile(draws.reshape(-1, *wanted.shape), [0.05, 0.95], axis=0)
    inside = (wanted >= low) & (wanted <= high)
    assert report["coverage_90"] == pytest.approx(inside.mean(), abs=0.02)


def test_each_member_is_kept_at_its_best_and_training_ends_when_none_gains():
    """Steps so large that members get worse at different times."""
    changes = {"learning_rate": 0.1, "epochs": 30, "patience": 2}
    _, report, calls = _fitted(**changes)
    assert 20 < report["steps"] < 600, "it ended by itself"
    one_by_one = []
    for epochs in range(1, report["steps"] // 20 + 1):
        _, found, _ = _fitted(**{**changes, "epochs": epochs})
        one_by_one.append(found["error_by_member"])
    assert np.all(np.diff(one_by_one, axis=0) <= 1e-9), "members only get better"
    assert np.all(np.diff(one_by_one, axis=0)[-2:] == 0.0), "the last two epochs brought nothing"
    assert len(calls) == report["steps"] // 20


def test_weights_decay_by_layer():
    plain, decayed = (_fitted(weight_decay=decay)[0] for decay in ((0.0,), (3.0, 0.0)))
    first, second = (
        [float(jnp.sum(jnp.square(weight))) for weight in model.network.weights] for model in (plain, decayed)
    )
    assert second[0] < 0.2 * first[0] and second[1] > 0.5 * first[1]
    layers = EnsembleConfig(hidden_sizes=(4,) * 6, weight_decay=(1.0, 2.0, 3.0)).decays()
    assert layers == (1.0, 2.0, 3.0, 3.0, 3.0, 3.0, 3.0)
    assert EnsembleConfig(hidden_sizes=(4,)).decays() == (2.5e-5, 1e-4)
    assert EnsembleConfig().decays() == (2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4)


def test_initial_weights_are_small_normal_numbers_cut_at_two_deviations():
    model = EnsembleConfig(hidden_sizes=(64, 64), members=2, elites=1).untrained(jr.key(0), 40, 24)
    for weight in model.network.weights:
        in_deviations = 2.0 * weight.shape[1] ** 0.5 * np.asarray(weight)
        assert np.abs(in_deviations).max() <= 2.0 and 0.8 < in_deviations.std() < 0.95, "0.88 of a cut normal"
    assert all(not np.any(bias) for bias in model.network.biases)


def test_a_model_that_learnt_nothing_is_reported_with_the_remedy():
    _, report, _ = _fitted(epochs=1, learning_rate=3.0)
    assert "no better than predicting 'no change'" in report["warnings"][0]
    assert "dynamics.epochs" in report["warnings"][0]


def test_a_spread_that_does_not_cover_is_reported(monkeypatch):
    monkeypatch.setattr(transition_fit, "LOW_COVERAGE", 0.99)
    _, report, _ = _fitted.__wrapped__()
    (warning,) = report["warnings"]
    assert f"{100 * report['coverage_90']:.0f} % of the held-out targets lie inside its 90 % intervals" in warning


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"elites": 8}, "dynamics.elites=8 cannot be kept of dynamics.members=7"),
        ({"weight_decay": (-1.0,)}, "dynamics.weight_decay"),
        ({"least_gain": 1.0}, "dynamics.least_gain=1.0"),
        ({"holdout": 0.0}, "dynamics.holdout=0.0 must lie between 0 and 1"),
        ({"epochs": 0}, "dynamics.epochs=0 must be at least 1"),
        ({"hidden_sizes": ()}, "dynamics.hidden_sizes"),
    ],
)
def test_settings_that_make_no_ensemble_are_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        EnsembleConfig(**fields)


def test_a_loss_that_is_not_finite_stops_with_the_remedy():
    with pytest.raises(DivergenceError, match=r"transition ensemble.*not finite.*dynamics.learning_rate"):
        _fitted(learning_rate=1e30, epochs=1)
