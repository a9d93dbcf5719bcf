"""A learner that sees observations in the log's units: training, resuming, acting, exporting and recovering."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import odaf
from odaf.data.sampling import training_columns
from odaf.deployment import odaf_policy
from odaf.errors import ConfigError
from odaf.evaluation.recovery import KnownGround

QUIET: dict[str, Any] = {"checkpoint_every": 2, "stretch": 2, "progress": False}


@pytest.fixture
def raw(tiny):
    return tiny.TinyLearner(observation_scaling="none", normaliser_epsilon=1e-3)


@pytest.fixture
def run(tiny, raw, tmp_path):
    directory = tmp_path / "raw"
    odaf.fit(raw, tiny.tiny_dataset(), steps=2, directory=directory, **QUIET)
    return odaf.resume(directory, steps=4, dataset=tiny.tiny_dataset(), progress=False)


def test_batches_hold_the_log_itself(tiny, raw):
    dataset = tiny.tiny_dataset()
    columns = training_columns(dataset, raw.normaliser(dataset), raw.drawn_view())
    np.testing.assert_array_equal(columns.observations, dataset.observations)  # type: ignore
    standard = training_columns(dataset, dataclasses.replace(raw, observation_scaling="standard").normaliser(dataset))
    np.testing.assert_allclose(np.mean(standard.observations, axis=0), 0.0, atol=1e-5)  # type: ignore


def test_the_policy_of_a_resumed_run_acts_on_what_sensors_read(tiny, run):
    state = run.files.state(0)
    rows = tiny.tiny_dataset().observations[:3]
    expected = 1.5 + 2.5 * np.tanh(rows @ np.asarray(state.weights) + np.asarray(state.offset))  # bounds -1 and 4
    policy = run.policy(0)
    np.testing.assert_allclose(policy(rows), expected, atol=1e-5)


def test_an_exported_policy_acts_so_too(tiny, tmp_path):
    dataset = tiny.tiny_dataset()
    learner = odaf.BehaviourCloning(hidden_sizes=(4,), batch_size=8, observation_scaling="none")
    trained = odaf.fit(learner, dataset, steps=2, directory=tmp_path / "run", **QUIET)
    trained.policy(0).save(tmp_path / "policy.safetensors")
    loaded = odaf.Policy.load(tmp_path / "policy.safetensors")
    np.testing.assert_array_equal(loaded(dataset.observations), trained.policy(0)(dataset.observations))
    odaf.export(trained.policy(0), tmp_path / "out", forms=["numpy"])
    carried = odaf_policy.Policy(tmp_path / "out" / "policy.safetensors")
    carried.begin()
    action = carried.act(dataset.observations[0])
    assert action is not None
    np.testing.assert_allclose(action, trained.policy(0)(dataset.observations[0]), atol=1e-5)


def test_distances_from_the_log_count_in_spreads_all_the_same(tiny):
    dataset = tiny.tiny_dataset()
    raw, standard = (
        KnownGround.of(dataset, odaf.data.Normaliser.fit(dataset.observations, applied=a)) for a in (False, True)
    )
    assert raw.threshold == standard.threshold


def test_another_word_is_refused(tiny, raw, tmp_path):
    learner = dataclasses.replace(raw, observation_scaling="unit")  # type: ignore
    with pytest.raises(ConfigError, match="observation_scaling"):
        odaf.fit(learner, tiny.tiny_dataset(), steps=2, directory=tmp_path, **QUIET)
