"""A policy in the hands of its user."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from odaf import training
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError
from odaf.training.policy import Policy


@pytest.fixture
def policy(tiny):
    dataset = tiny.tiny_dataset()
    state = tiny.TinyState(
        step=jnp.asarray(0),
        weights=jnp.asarray([[0.5, -0.5], [0.25, 3.0], [-1.0, 0.0]]),
        slow=jnp.zeros((3, 2)),
        side=jnp.asarray([0.1, -0.2]),
    )
    names = dataset.observation_names
    return Policy(tiny.TinyLearner(), dataset.spec(), Normaliser.fit(dataset.observations), state, names)


def test_one_observation_a_batch_and_names_agree(policy):
    rows = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 6.0]], np.float32)
    batch = policy(rows)
    assert batch.shape == (2, 2) and batch.dtype == np.float32
    for row, action in zip(rows, batch, strict=True):
        np.testing.assert_allclose(policy(row), action, rtol=1e-6)
        named = dict(zip(("level", "flow", "heat"), row, strict=True))
        np.testing.assert_array_equal(policy(named), policy(row))
    columns = {"heat": rows[:, 2], "flow": rows[:, 1], "level": rows[:, 0]}
    np.testing.assert_array_equal(policy(columns), batch)
    np.testing.assert_array_equal(policy([1, 2, 3]), policy(rows[0]))


@settings(max_examples=50)
@given(rows=hnp.arrays(np.float32, (4, 3), elements=st.floats(width=32, allow_nan=False, allow_infinity=False)))
def test_actions_are_finite_and_in_bounds_for_any_finite_observation(tiny_policy, rows):
    actions = tiny_policy(rows)
    assert np.isfinite(actions).all() and (actions >= -1.0).all() and (actions <= 4.0).all()


@pytest.fixture(scope="module")
def tiny_policy(_tiny_module):
    dataset = _tiny_module.tiny_dataset()
    state = _tiny_module.TinyState(jnp.asarray(0), jnp.full((3, 2), 1e-3), jnp.zeros((3, 2)), jnp.zeros(2))
    normaliser = Normaliser.fit(dataset.observations)
    return Policy(_tiny_module.TinyLearner(), dataset.spec(), normaliser, state, dataset.observation_names)


@pytest.mark.parametrize(
    ("observation", "named"),
    [
        (np.zeros(4, np.float32), r"has shape \(4,\).*level, flow, heat"),
        (np.zeros((1, 2, 3), np.float32), "has shape"),
        (np.array([0.0, np.nan, 0.0]), "flow is not a finite number"),
        (np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.inf]]), "heat is not a finite number"),
        ({"level": 1.0, "flow": 2.0}, r"missing \['heat'\]"),
        ({"level": 1.0, "flow": 2.0, "heat": 3.0, "heart": 4.0}, r"unknown \['heart'\]"),
    ],
)
def test_wrong_observations_are_named(policy, observation, named):
    with pytest.raises(DatasetError, match=named):
        policy(observation)


def test_names_and_units_come_from_the_data_and_older_runs_still_load(tiny, tmp_path):
    dataset = dataclasses.replace(
        tiny.tiny_dataset(),
        action_names=("valve", "pump"),
        observation_units=("m", "m³/s", "°C"),
        action_units=("%", ""),
    )
    run = training.fit(tiny.TinyLearner(), dataset, steps=2, directory=tmp_path / "run", progress=False)
    policy = run.policy(seed=0)
    assert policy.observation_names == ("level", "flow", "heat") and policy.action_names == ("valve", "pump")
    assert policy.observation_units == ("m", "m³/s", "°C") and policy.action_units == ("%", "")

    file = tmp_path / "run" / "data.json"
    data = json.loads(file.read_text())
    for field in ("observation_units", "action_units"):
        del data["summary"][field]
    file.write_text(json.dumps(data))
    assert training.RunDirectory(tmp_path / "run").policy(seed=0).observation_units == ()
