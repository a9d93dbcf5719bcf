"""Pre-training of dynamics models: what is learnt, what is held out, what is reported."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from compilations import counted
from golden import tiny
from odaf.components.dynamics import DynamicsConfig, fit_dynamics, untrained
from odaf.components.pretraining import split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError, DivergenceError

CONFIGS = {
    "deterministic": DynamicsConfig(hidden_sizes=(32,), steps=600, batch_size=64, learning_rate=5e-3),
    "cvae as printed": DynamicsConfig(
        kind="cvae",
        hidden_sizes=(32,),
        residual=False,
        latent_dim=4,
        steps=600,
        batch_size=64,
        learning_rate=5e-3,
        schedule="constant",
    ),
    "cvae that sees the target": DynamicsConfig(
        kind="cvae",
        encoder="transition",
        hidden_sizes=(32,),
        latent_dim=4,
        steps=600,
        batch_size=64,
        learning_rate=5e-3,
    ),
    "ensemble": DynamicsConfig(
        kind="ensemble", hidden_sizes=(32,), members=4, elites=2, steps=600, batch_size=64, learning_rate=5e-3
    ),
}
# Ratio of hold-out error to the error of "no change", about ten times what was measured with four keys
FAR_BELOW = {"deterministic": 1.0, "cvae as printed": 1.0, "cvae that sees the target": 1.0, "ensemble": 1.0}


@functools.cache
def _dataset() -> Dataset:
    return tiny.linear_dataset()


def _split(dataset: Dataset, share: float, key: jax.Array):
    return split_rows(dataset, share, key, "dynamics model", "leave it out")


def _fitted(config: DynamicsConfig, dataset: Dataset | None = None, key: int = 0, calls: list | None = None):
    dataset = _dataset() if dataset is None else dataset
    calls = [] if calls is None else calls
    return fit_dynamics(
        config, dataset, Normaliser.fit(dataset.observations), jr.key(key), lambda *done: calls.append(done)
    )


@pytest.mark.parametrize("name", CONFIGS)
def test_a_linear_system_is_learnt_far_better_than_no_change(name):
    config, calls = CONFIGS[name], []
    model, report = _fitted(config, calls=calls)
    assert report["error_ratio"] < FAR_BELOW[name]
    assert report["holdout_mse"] == pytest.approx(np.mean(report["holdout_mse_by_dimension"]))
    assert report["no_change_mse"] == pytest.approx(np.mean(report["no_change_mse_by_dimension"]))
    assert report["warnings"] == [] and report["kind"] == config.kind
    assert report["holdout_rows"] == 25, "one of twenty episodes of 25 rows"
    assert calls[-1] == (600, 600)

    # checkpoints are read back into the structure of an untrained model
    blank = jax.eval_shape(lambda: untrained(config, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    assert jax.tree.structure(blank) == jax.tree.structure(model)
    assert [leaf.shape for leaf in jax.tree.leaves(blank)] == [leaf.shape for leaf in jax.tree.leaves(model)]

    # the scaling of outputs is measured on the training rows, not learnt
    dataset, normaliser = _dataset(), Normaliser.fit(_dataset().observations)
    if config.residual:
        train, _ = _split(dataset, config.holdout, jr.split(jr.key(0), 4)[0])
        before, after = (normaliser.normalise(c[train]) for c in (dataset.observations, dataset.next_observations))
        change = after - before
        np.testing.assert_allclose(model.shift, change.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(model.scale, change.std(axis=0), rtol=1e-5)
    else:
        np.testing.assert_array_equal(model.shift, np.zeros(tiny.OBS_DIM))
        np.testing.assert_array_equal(model.scale, np.ones(tiny.OBS_DIM))


def test_the_reported_error_is_the_models_error_on_episodes_it_never_saw():
    config = dataclasses.replace(CONFIGS["deterministic"], steps=20)
    dataset, normaliser = _dataset(), Normaliser.fit(_dataset().observations)
    model, report = _fitted(config)
    train, holdout = _split(dataset, config.holdout, jr.split(jr.key(0), 4)[0])
    assert len(holdout) == 25 and len(np.unique(holdout // 25)) == 1, "one whole episode"
    assert sorted([*train, *holdout]) == list(range(len(dataset)))
    states, after = (normaliser.normalise(c[holdout]) for c in (dataset.observations, dataset.next_observations))
    predicted = np.asarray(model.expected(jnp.asarray(states), jnp.asarray(dataset.actions[holdout])))
    assert report["holdout_mse"] == pytest.approx(np.mean((predicted - after) ** 2), rel=1e-4)
    assert report["no_change_mse"] == pytest.approx(np.mean((states - after) ** 2), rel=1e-4)


def test_a_model_no_better_than_no_change_is_reported_with_the_remedy():
    _, report = _fitted(dataclasses.replace(CONFIGS["deterministic"], steps=1, residual=False))
    (warning,) = report["warnings"]
    assert report["error_ratio"] >= 1.0
    assert "no better than predicting 'no change'" in warning and "dynamics.residual=True" in warning


def test_one_key_gives_one_model_bit_for_bit_and_another_key_another():
    config = dataclasses.replace(CONFIGS["ensemble"], steps=5)
    first, again, other = (_fitted(config, key=key)[0] for key in (3, 3, 4))
    for ours, theirs in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.array_equal(jax.tree.leaves(first)[0], jax.tree.leaves(other)[0])


def test_a_loss_that_is_not_finite_stops_with_the_remedy():
    config = dataclasses.replace(CONFIGS["deterministic"], steps=3, learning_rate=1e30, schedule="constant")
    with pytest.raises(DivergenceError, match="deterministic.*not finite after 3 steps.*dynamics.learning_rate"):
        _fitted(config)


def _ends(terminated: list[bool], truncated: list[bool], placeholder: bool = True) -> Dataset:
    rows = np.arange(len(terminated), dtype=np.float32)[:, None] + np.zeros((1, 3), np.float32)
    after = rows + 1.0
    if placeholder:
        after = np.where(np.array(terminated)[:, None], rows, after)
    actions = np.zeros((len(rows), 2))
    return Dataset.from_arrays(
        rows,
        actions,
        rows[:, 0],
        next_observations=after,
        terminated=terminated,
        truncated=truncated,
        action_bounds=(-1, 1),
    )


def test_rows_without_a_logged_successor_teach_nothing():
    ends = [False, True] * 10
    train, holdout = _split(_ends(ends, [False] * 20), 0.2, jr.key(0))
    assert sorted([*train, *holdout]) == list(range(0, 20, 2)), "the true ends repeat their own state"
    train, holdout = _split(_ends(ends, [False] * 20, placeholder=False), 0.2, jr.key(0))
    assert sorted([*train, *holdout]) == list(range(20)), "true ends whose successor is known are kept"


@pytest.mark.parametrize(("episodes", "share", "held"), [(2, 0.05, 1), (10, 0.05, 1), (10, 0.3, 3), (3, 0.99, 2)])
def test_each_side_gets_whole_episodes_and_at_least_one(episodes, share, held):
    length = 4
    ends = [row % length == length - 1 for row in range(episodes * length)]
    train, holdout = _split(_ends([False] * len(ends), ends), share, jr.key(1))
    assert len(holdout) == held * length and len(train) == (episodes - held) * length
    assert not set(train // length) & set(holdout // length)


def test_a_single_episode_is_cut_in_time():
    train, holdout = _split(_ends([False] * 20, [False] * 19 + [True]), 0.25, jr.key(0))
    assert list(train) == list(range(15)) and list(holdout) == list(range(15, 20))


def test_data_without_a_single_successor_is_refused():
    with pytest.raises(DatasetError, match="of 6 rows 0 have a logged successor"):
        _fitted(CONFIGS["deterministic"], _ends([True] * 6, [False] * 6))


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"steps": 0}, "dynamics.steps=0"),
        ({"batch_size": 0}, "dynamics.batch_size=0"),
        ({"patience": 0}, "dynamics.patience=0"),
        ({"holdout": 0.0}, "dynamics.holdout=0.0"),
        ({"holdout": 1.0}, "dynamics.holdout=1.0"),
        ({"elites": 0}, "dynamics.elites=0"),
        ({"kind": "ensemble", "members": 3, "elites": 4}, "dynamics.elites=4"),
        ({"latent_dim": 0}, "dynamics.latent_dim=0"),
        ({"hidden_sizes": (8, 0)}, "dynamics.hidden_sizes"),
        ({"hidden_sizes": ()}, "dynamics.hidden_sizes"),
    ],
)
def test_settings_that_cannot_be_trained_are_refused(fields, named):
    with pytest.raises(ConfigError, match=named):
        DynamicsConfig(**fields)


def test_early_stopping_by_the_error_held_out_is_off_unless_asked_for():
    config = dataclasses.replace(CONFIGS["deterministic"], steps=5000, learning_rate=0.0, hidden_sizes=(2,))
    _, report = _fitted(dataclasses.replace(config, patience=2))
    assert report["steps"] == 3000, "nothing is learnt, so the first of three checks stays the best"
    assert DynamicsConfig().patience is None


def _ragged(lengths: tuple[int, ...]) -> Dataset:
    rng = np.random.default_rng(0)
    rows = sum(lengths)
    ends = np.zeros(rows, bool)
    ends[np.cumsum(lengths) - 1] = True
    states, actions = rng.normal(size=(rows, 3)), rng.uniform(-1, 1, (rows, 2))
    after = states + 0.1
    return Dataset.from_arrays(
        states, actions, states[:, 0], next_observations=after, truncated=ends, action_bounds=(-1, 1)
    )


@pytest.mark.parametrize("kind", ["deterministic", "ensemble", "cvae"])
def test_a_second_seed_and_another_step_size_compile_nothing(kind):
    # episodes of unlike lengths, so that another number of rows is held out
    dataset = _ragged((3, 5, 9, 12))
    config = DynamicsConfig(kind=kind, hidden_sizes=(4,), latent_dim=2, members=3, elites=2, steps=2, batch_size=5)
    held = {_fitted(config, dataset, key)[1]["holdout_rows"] for key in range(2)}
    with counted() as programs:
        for key in (2, 3, 4):
            other = dataclasses.replace(config, learning_rate=1e-2 / (1 + key))
            held.add(_fitted(other, dataset, key)[1]["holdout_rows"])
    assert not programs
    assert len(held) > 1
