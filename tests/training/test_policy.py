"""A policy in the hands of its user."""

import dataclasses
import json

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jaxtyping import Array

from odaf import training
from odaf.components.policies import Actor, GaussianActor, init_gaussian_actor
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError, DivergenceError
from odaf.training.policy import Policy

NAMES = ("level", "flow", "heat")
LOW, HIGH = (-1.0, -1.0), (4.0, 4.0)


def _normaliser() -> Normaliser:
    return Normaliser(np.array([2.0, 2.0, 2.0]), np.array([3.0, 3.0, 3.0]))


@pytest.fixture(scope="module")
def policy(_tiny_module) -> Policy:
    weights = jnp.asarray([[0.5, -0.5], [0.25, 3.0], [-1.0, 0.0]])
    return Policy(_tiny_module.TinyActor(weights, jnp.asarray([0.1, -0.2])), _normaliser(), LOW, HIGH, NAMES)


@pytest.fixture(scope="module")
def gaussian() -> Policy:
    return Policy(init_gaussian_actor(jr.key(0), 3, 2, (8,)), _normaliser(), LOW, HIGH, NAMES)


def test_one_observation_a_batch_and_names_agree(policy):
    rows = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 6.0]], np.float32)
    batch = policy(rows)
    assert batch.shape == (2, 2) and batch.dtype == np.float32
    for row, action in zip(rows, batch, strict=True):
        np.testing.assert_allclose(policy(row), action, rtol=1e-6)
        np.testing.assert_array_equal(policy(row), policy(row[None])[0])
        named = dict(zip(NAMES, row, strict=True))
        np.testing.assert_array_equal(policy(named), policy(row))
    columns = {"heat": rows[:, 2], "flow": rows[:, 1], "level": rows[:, 0]}
    np.testing.assert_array_equal(policy(columns), batch)
    np.testing.assert_array_equal(policy([1, 2, 3]), policy(rows[0]))


ROWS = hnp.arrays(np.float32, (4, 3), elements=st.floats(width=32, allow_nan=False, allow_infinity=False))


@settings(max_examples=50)
@given(rows=ROWS, key=st.integers(0, 2**32 - 1))
def test_actions_and_draws_are_finite_and_in_bounds_for_any_finite_observation(gaussian, rows, key):
    with np.errstate(over="ignore"):
        for actions in (gaussian(rows), gaussian.sample(rows, key)):
            assert np.isfinite(actions).all() and (actions >= -1.0).all() and (actions <= 4.0).all()


def test_draws_follow_their_key_and_spread_around_the_deterministic_action(gaussian):
    rows = np.tile(np.array([[1.0, 2.0, 3.0]], np.float32), (500, 1))
    draws = gaussian.sample(rows, 3)
    np.testing.assert_array_equal(draws, gaussian.sample(rows, jr.key(3)))
    np.testing.assert_array_equal(draws, gaussian.act(gaussian.begin(500), rows, 3)[0])
    assert not np.array_equal(draws, gaussian.sample(rows, 4))
    assert len(np.unique(draws[:, 0])) > 490, "rows have noise of their own"
    assert abs(np.median(draws[:, 0]) - gaussian(rows[0])[0]) < 0.3
    assert gaussian.sample(rows[0], 5).shape == (2,)


def test_a_policy_without_randomness_draws_its_action(policy):
    row = np.array([1.0, 2.0, 3.0], np.float32)
    np.testing.assert_array_equal(policy.sample(row, 1), policy(row))


@pytest.mark.parametrize(
    ("observation", "named"),
    [
        (np.zeros(4, np.float32), r"has shape \(4,\).*level, flow, heat"),
        (np.zeros((1, 2, 3), np.float32), "has shape"),
        (np.zeros(()), "has shape"),
        (np.array([0.0, np.nan, 0.0]), "flow is not a finite number"),
        (np.array([-np.inf, np.inf, 0.0]), "level is not a finite number"),
        (np.array([0.0, np.inf, 0.0]), "flow is not a finite number"),  # tanh makes tame numbers of it
        (np.array([[0.0, 0.0, 0.0], [-np.inf, 0.0, 0.0]]), "level is not a finite number"),
        (np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.inf]]), "heat is not a finite number"),
        (np.concatenate([np.zeros((99, 3)), [[0.0, np.nan, 0.0]]]), "flow is not a finite number"),
        ({"level": 1.0, "flow": 2.0}, r"missing \['heat'\]"),
        ({"level": 1.0, "flow": 2.0, "heat": 3.0, "heart": 4.0}, r"unknown \['heart'\]"),
    ],
)
def test_wrong_observations_are_named(policy, observation, named):
    for ask in (policy, lambda given: policy.sample(given, 0), lambda given: policy.act((), given)):
        with pytest.raises(DatasetError, match=named):
            ask(observation)


@pytest.mark.parametrize("rows", [1, 100])
def test_broken_parameters_are_told_from_wrong_observations(policy, rows):
    broken = dataclasses.replace(policy, actor=dataclasses.replace(policy.actor, offset=jnp.asarray([0.0, jnp.nan])))
    with pytest.raises(DivergenceError, match="training diverged"):
        broken(np.zeros((rows, 3), np.float32))


# ---- memory --------------------------------------------------------------------------------------------------------


class Counting(Actor):
    """Its first action is the number of steps so far over ten, its second the rewards so far over ten."""

    start: Array

    def begin(self, rows):
        return jnp.zeros(rows), jnp.broadcast_to(self.start, (rows,))

    def act(self, carry, observations, key=None):
        steps, earned = carry
        return jnp.stack([steps, earned], axis=1) / 10.0, (steps + 1.0, earned)

    def observe(self, carry, rewards):
        return carry[0], carry[1] + rewards


def test_a_policy_with_a_memory_is_carried_from_step_to_step():
    policy = Policy(Counting(jnp.asarray(0.5)), _normaliser(), (-10.0, -10.0), (10.0, 10.0), NAMES)
    assert policy.has_memory
    rows = np.zeros((2, 3), np.float32)
    carry = policy.begin(2)
    first, carry = policy.act(carry, rows)
    carry = policy.observe(carry, [1.0, -2.0])
    second, carry = policy.act(carry, rows)
    np.testing.assert_allclose(first, [[0.0, 0.5], [0.0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(second, [[1.0, 1.5], [1.0, -1.5]], atol=1e-6)
    single, alone = policy.act(policy.begin(), rows[0])
    assert single.shape == (2,)
    np.testing.assert_allclose(policy.act(policy.observe(alone, 3.0), rows[0])[0], [1.0, 3.5], atol=1e-6)


def test_a_memory_cannot_be_forgotten_or_swapped_by_mistake(policy):
    remembering = Policy(Counting(jnp.asarray(0.0)), _normaliser(), LOW, HIGH, NAMES)
    for ask in (remembering, lambda rows: remembering.sample(rows, 0)):
        with pytest.raises(ConfigError, match="has a memory.*policy.begin"):
            ask(np.zeros(3, np.float32))
    for carry in (remembering.begin(2), ()):
        with pytest.raises(DatasetError, match=r"carry: is not that of 3 episodes.*policy.begin\(3\)"):
            remembering.act(carry, np.zeros((3, 3), np.float32))
    rows = np.ones((4, 3), np.float32)
    actions, carry = policy.act(policy.begin(4), rows)
    assert not policy.has_memory and policy.observe(carry, np.zeros(4)) == ()
    np.testing.assert_array_equal(actions, policy(rows))


# ---- runs ----------------------------------------------------------------------------------------------------------


def test_names_units_and_provenance_come_from_the_run_and_older_runs_still_load(tiny, tmp_path):
    dataset = dataclasses.replace(
        tiny.tiny_dataset(),
        action_names=("valve", "pump"),
        observation_units=("m", "m³/s", "°C"),
        action_units=("%", ""),
    )
    run = training.fit(tiny.TinyLearner(), dataset, steps=2, directory=tmp_path / "run", progress=False, preset="small")
    policy = run.policy(seed=0)
    assert policy.observation_names == ("level", "flow", "heat") and policy.action_names == ("valve", "pump")
    assert policy.observation_units == ("m", "m³/s", "°C") and policy.action_units == ("%", "")
    fingerprint = dataset.file_fingerprint()
    assert policy.provenance == {
        "learner": "tiny",
        "preset": "small",
        "data_sha256": fingerprint,
        "data_rows_sha256": dataset.fingerprint(),
        "seed": 0,
        "step": 2,
    }

    file = tmp_path / "run" / "data.json"
    data = json.loads(file.read_text())
    for field in ("observation_units", "action_units"):
        del data["summary"][field]
    file.write_text(json.dumps(data))
    assert training.RunDirectory(tmp_path / "run").policy(seed=0).observation_units == ()


def test_a_policy_holds_an_actor_and_nothing_of_its_training(gaussian):
    assert {type(value) for value in vars(gaussian).values()} >= {GaussianActor, Normaliser}
    assert not any("state" in name or "algorithm" in name for name in vars(gaussian))
