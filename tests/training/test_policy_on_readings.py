"""A policy whose log computed observations from readings: at work it takes the readings and computes the very same."""

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import polars as pl
import pytest
from jaxtyping import Array

from odaf import training
from odaf.components.policies import Actor, init_gaussian_actor
from odaf.data.dataset import Dataset
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.errors import CheckpointError, ConfigError, DatasetError
from odaf.training.policy import Carry, Policy

LENGTH, EPISODES = 8, 3
FORMULAS = ["error = level - setpoint", "effort = exp(error) / 3"]


def plant() -> pl.DataFrame:
    """Three shifts of eight rows, in numbers that float32 rounds."""
    rng, rows = np.random.default_rng(0), LENGTH * EPISODES
    names = ("level", "setpoint", "temperature")
    readings = {name: rng.normal(size=rows) for name in names}
    return pl.DataFrame({"shift": np.arange(rows) // LENGTH, **readings, "valve": rng.uniform(0, 100, rows)})


def log(**options: Any) -> Dataset:
    return Dataset.from_dataframe(
        plant(),
        observations=["level", *FORMULAS, "temperature"],
        actions=["valve"],
        reward="1 - abs(level - setpoint)",
        episode="shift",
        action_bounds=(0.0, 100.0),
        **options,
    )


def policy_of(dataset: Dataset) -> Policy:
    """One with random parameters on the observations of the log."""
    actor = init_gaussian_actor(jr.key(0), dataset.obs_dim, 1, (8,))
    weights = tuple(50.0 * weight for weight in actor.network.weights)
    return Policy(
        dataclasses.replace(actor, network=dataclasses.replace(actor.network, weights=weights)),
        Normaliser.fit(dataset.observations),
        (0.0,),
        (100.0,),
        tuple(dataset.observation_names),
        ("valve",),
        derivation=Derivation.from_provenance(dataset.provenance),
    )


KINDS = [{}, {"lags": 2}, {"differences": True}, {"lags": 3, "differences": True}]


@pytest.fixture(scope="module", params=KINDS, ids=lambda options: "+".join(options) or "formulas")
def logged(request: pytest.FixtureRequest) -> tuple[Dataset, Policy]:
    dataset = log(**request.param)
    return dataset, policy_of(dataset)


@pytest.fixture(scope="module")
def lagged() -> Policy:
    return policy_of(log(lags=2))


def played(policy: Policy, rows: list[dict[str, Any]], form: type) -> list[np.ndarray]:
    """Actions for the readings of one episode, in which the plant did what the log says."""
    carry, actions = policy.begin(), []
    for row in rows:
        readings = {name: row[name] for name in policy.reading_names}
        action, carry = policy.act(carry, readings if form is dict else np.array(list(readings.values())))
        carry = policy.acted(carry, [row["valve"]] if form is dict else {"valve": row["valve"]})
        actions.append(action)
    return actions


@pytest.mark.parametrize("form", [dict, np.ndarray])
@pytest.mark.parametrize("first", [0, 2])
def test_from_readings_come_the_bits_that_the_log_s_observations_give(
    logged: tuple[Dataset, Policy], form: type, first: int
):
    """Over whole episodes, and over episodes that somebody else began."""
    dataset, policy = logged
    history = policy.history
    assert policy.reading_names == ("level", "setpoint", "temperature")
    plain = policy.without_derivation()
    frame = plant().with_row_index()
    kept = [index for index in range(len(frame)) if history <= index % LENGTH < LENGTH - 1]  # the last has no successor
    seen = dict(zip(kept, dataset.observations, strict=True))
    compared = set()
    for shift in range(EPISODES):
        rows = frame.filter(pl.col("shift") == shift).rows(named=True)[first:]
        for place, (row, action) in enumerate(zip(rows, played(policy, rows[:-1], form), strict=False)):
            if place < history:
                assert np.isnan(action).all()
            else:
                expected = plain(seen[row["index"]])
                np.testing.assert_array_equal(action, expected)
                compared.add(float(expected[0]))
    assert len(compared) == EPISODES * (LENGTH - 1 - first - history), "every row has an action of its own"


def test_episodes_side_by_side_act_as_alone(lagged: Policy):
    """Their actions are remembered unless others are told, and each begins when it likes."""
    frames = plant().partition_by("shift")
    alone = [policy_steps(lagged, frame.rows(named=True)) for frame in frames]
    carry = lagged.begin(EPISODES)
    for step in range(LENGTH):
        columns = {name: np.array([frame[name][step] for frame in frames]) for name in lagged.reading_names}
        actions, carry = lagged.act(carry, columns)
        assert actions.shape == (EPISODES, 1)
        np.testing.assert_allclose(actions, [steps[step] for steps in alone], rtol=1e-4)
        if step < lagged.history:
            carry = lagged.acted(carry, np.full((EPISODES, 1), 50.0))
    third = type(carry.memory)(*(part[[0, 2]] for part in carry.memory))
    assert lagged.act(Carry(third, ()), np.ones((2, 3)))[0].shape == (2, 1)


def policy_steps(policy: Policy, rows: list[dict[str, Any]]) -> list[np.ndarray]:
    carry, actions = policy.begin(), []
    for step, row in enumerate(rows):
        action, carry = policy.act(carry, {name: row[name] for name in policy.reading_names})
        if step < policy.history:
            carry = policy.acted(carry, [50.0])
        actions.append(action)
    return actions


def test_formulas_alone_need_no_memory():
    dataset = log()
    policy, frame = policy_of(dataset), plant().filter(pl.int_range(pl.len()) % LENGTH < LENGTH - 1)
    assert not policy.has_memory and policy.history == 0
    rows = frame.select(policy.reading_names).to_numpy()
    expected = policy.without_derivation()(dataset.observations)
    np.testing.assert_array_equal(policy(rows), expected)
    np.testing.assert_array_equal(policy({name: frame[name].to_numpy() for name in policy.reading_names}), expected)
    np.testing.assert_array_equal(policy(rows[3]), policy.without_derivation()(dataset.observations[3]))
    np.testing.assert_array_equal(policy.sample(rows, 3), policy.without_derivation().sample(dataset.observations, 3))


def test_what_is_wrong_at_work_is_named(lagged: Policy):
    readings = {"level": 1.0, "setpoint": 0.5, "temperature": 20.0}
    with pytest.raises(ConfigError, match="has a memory.*policy.begin"):
        lagged(readings)
    for given, message in (
        (
            {"level": 1.0, "temperature": 20.0},
            r"missing \['setpoint'\], unknown none; give exactly level, setpoint, temp",
        ),
        ({**readings, "leval": 1.0}, r"unknown \['leval'\]"),
        ({**readings, "level": np.nan}, "reading 'level' is not a finite number"),
        ({**readings, "level": "Bad"}, "level is 'Bad', which is no number"),
        ({**readings, "level": 1e9}, "'effort = exp.error. / 3' has no finite value for these readings .level 1e.09"),
        ({**readings, "level": [1.0, 2.0]}, "its columns are of different lengths"),
        (
            np.zeros(12),
            r"has shape \(12,\), but this policy takes \[3\] .* level, setpoint, temperature; .*without_deriv",
        ),
        (["level", 1, 2], "holds something else than numbers"),
    ):
        with pytest.raises(DatasetError, match=message):
            lagged.act(lagged.begin(), given)
    action, carry = lagged.act(lagged.begin(), readings)
    assert np.isnan(action).all()
    with pytest.raises(DatasetError, match="that step has none; tell what was done there with carry = policy.acted"):
        lagged.act(carry, readings)
    for wrong, message in (
        ({"vavle": 1.0}, r"action: missing \['valve'\], unknown \['vavle'\]"),
        ([1.0, 2.0], r"action: has shape \(2,\), not \(1, 1\)"),
        ([np.nan], "action: valve is not a finite number"),
    ):
        with pytest.raises(DatasetError, match=message):
            lagged.acted(carry, wrong)
    with pytest.raises(DatasetError, match=r"carry: is not that of 2 episodes"):
        lagged.act(carry, np.zeros((2, 3)))
    with pytest.raises(DatasetError, match="derivation: makes level.*but the policy's observations are a"):
        dataclasses.replace(lagged, observation_names=("a",))
    with pytest.raises(DatasetError, match="derivation: remembers valve, but the policy's actions are pump"):
        dataclasses.replace(lagged, action_names=("pump",))


class Remembering(Actor):
    """Answers with how many steps it saw and what they earned."""

    offset: Array

    def begin(self, rows):
        return jnp.zeros(rows), jnp.zeros(rows)

    def act(self, carry, observations, key=None):
        return (carry[0] + 0.1 * carry[1])[:, None] / 10.0, (carry[0] + 1.0, carry[1])

    def observe(self, carry, rewards):
        return carry[0], carry[1] + rewards


def test_an_actor_with_a_memory_of_its_own_sees_only_steps_that_have_an_observation(lagged: Policy):
    policy = dataclasses.replace(lagged, actor=Remembering(jnp.asarray(0.0)), action_low=(-10.0,), action_high=(10.0,))
    carry, found = policy.begin(2), []
    for step in range(4):
        actions, carry = policy.act(carry, np.full((2, 3), 0.5))
        carry = policy.acted(carry, np.zeros((2, 1))) if step < 2 else policy.observe(carry, [1.0, 2.0])
        found.append(actions[:, 0])
    assert np.isnan(found[:2]).all()
    np.testing.assert_allclose(found[2:], [[0.0, 0.0], [1.1, 1.2]], atol=1e-6)


def test_a_run_s_policy_takes_readings(tiny: Any, tmp_path: Path):
    run = training.fit(tiny.TinyLearner(), log(lags=2), steps=2, directory=tmp_path / "run", progress=False)
    policy = training.RunDirectory(run.path).policy(seed=0)
    assert policy.reading_names == ("level", "setpoint", "temperature") and policy.history == 2
    assert policy.observation_names[:3] == ("level", "error", "effort") and policy.obs_dim == 14


def test_saved_and_loaded_it_is_the_same(logged: tuple[Dataset, Policy], tmp_path: Path):
    _, policy = logged
    policy.save(tmp_path / "policy.safetensors")
    loaded = Policy.load(tmp_path / "policy.safetensors")
    assert loaded.derivation == policy.derivation and loaded.reading_names == policy.reading_names
    rows = plant().head(LENGTH).rows(named=True)
    np.testing.assert_array_equal(played(loaded, rows, dict), played(policy, rows, dict))
    plain = policy.without_derivation()
    plain.save(tmp_path / "plain.safetensors")
    assert b"derivation" not in (tmp_path / "plain.safetensors").read_bytes()
    assert Policy.load(tmp_path / "plain.safetensors").derivation is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"observation_names": tuple("abcdefghijklmn")}, "derivation: makes level, .*which are not the observations"),
        ({"action_names": ("pump",)}, "derivation: remembers valve, which are not the actions"),
    ],
)
def test_a_file_that_contradicts_its_recipes_is_refused(
    lagged: Policy, change: dict[str, Any], message: str, tmp_path: Path
):
    from odaf.training.policy_file import write_policy

    write_policy(tmp_path / "policy.safetensors", {**vars(lagged), **change})
    with pytest.raises(CheckpointError, match=message):
        Policy.load(tmp_path / "policy.safetensors")


def test_damaged_recipes_are_refused_by_name(lagged: Policy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recipes = [{"recipe": "expression", "name": "x", "expression": "system(level)"}]
    for found, message in ((recipes, "derivation: expression .*function system is unknown"), ("x", "expected a list")):
        monkeypatch.setattr(Derivation, "recipes", lambda self, found=found: found)
        lagged.save(tmp_path / "policy.safetensors")
        with pytest.raises(CheckpointError, match=rf"policy\.safetensors: .*{message}"):
            Policy.load(tmp_path / "policy.safetensors")
