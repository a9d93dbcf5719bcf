"""Policies whose observations are computed of readings, in environments that give these or the observations."""

from typing import Any

import gymnasium as gym
import jax.random as jr
import numpy as np
import polars as pl
import pytest

import odaf
from odaf.components.policies import init_gaussian_actor
from odaf.data.dataset import Dataset
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.environments.knocks import Knock
from odaf.errors import ConfigError
from odaf.evaluation.attacks import ATTACKS, AttackedPolicy
from odaf.evaluation.examination import examine
from odaf.evaluation.player import Player
from odaf.runs.evaluate_knocks import knock_scores


class Tank(gym.Env):
    """Level and set point; pays what was done, so that a return tells every action. Six steps."""

    observation_space = gym.spaces.Box(-9.0, 9.0, (2,))
    action_space = gym.spaces.Box(0.0, 10.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.level = 0, 1.0
        return self.see(), {}

    def see(self) -> Any:
        return np.array([self.level, 0.5], np.float32)

    def step(self, action) -> Any:
        self.t, self.level = self.t + 1, self.level + 0.1 * float(action[0])
        return self.see(), float(action[0]), False, self.t >= 6, {}


class Named(Tank):
    def see(self):
        level, setpoint = super().see().tolist()
        return {"setpoint": np.array([setpoint]), "level": np.array([level]), "extra": np.zeros(3)}


class Derived(Tank):
    """Gives the observations themselves: level, error, and both with the action of the row before."""

    def see(self):
        level, setpoint = super().see().tolist()
        return np.array([level, level - setpoint, 0.0, 0.0, 0.0], np.float32)


class Wide(Tank):
    def see(self):
        return np.zeros(4, np.float32)


class Empty(Tank):
    """Its level falls to where the formula has no value."""

    def see(self):
        return np.array([1.0 - 2.0 * (self.t >= 3)], np.float32)


def log(formula: str = "error = level - setpoint", **options: Any) -> Dataset:
    rng = np.random.default_rng(0)
    table = pl.DataFrame({"level": rng.uniform(0, 3, 60), "setpoint": 0.5 + rng.uniform(0, 1, 60)})
    table = table.with_columns(valve=pl.Series(rng.uniform(0, 10, 60)), run=pl.int_range(60) // 10)
    roles = {"observations": ["level", formula], "actions": ["valve"], "reward": "-level", "episode": "run"}
    return odaf.Dataset.from_dataframe(table, **roles, action_bounds=(0.0, 10.0), **options)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> odaf.Run:
    """Cloned with one earlier row, and evaluated in the tank while it was."""
    learner = odaf.BehaviourCloning(hidden_sizes=(4,), batch_size=8)
    rollouts = odaf.Rollouts(Tank, episodes=2, every=2)
    path = tmp_path_factory.mktemp("runs") / "run"
    return odaf.fit(learner, log(lags=1), steps=2, directory=path, evaluate=rollouts, progress=False)


def test_an_environment_that_gives_readings_is_played_with_the_observations_of_the_log(run: odaf.Run):
    """The return is what the policy answers to observations put together by hand, after a first step in the middle."""
    policy = run.policy(seed=0)
    assert policy.reading_names == ("level", "setpoint") and policy.history == 1
    plain, level, done = policy.without_derivation(), 1.0, []
    before: list[np.ndarray] = []
    for step in range(6):
        own = np.array([np.float32(level), np.float32(np.float64(np.float32(level)) - 0.5)])
        done.append(5.0 if step == 0 else float(plain(np.concatenate([own, *before]).astype(np.float32))[0]))
        before = [own, np.array([done[-1]])]
        level += 0.1 * done[-1]
    np.testing.assert_allclose(run.scores().by_seed[0].returns, [sum(done)] * 2, rtol=1e-5)
    (warning,) = run.summary[0]["warnings"]
    assert warning["kind"] == "first-steps" and "made of 1 earlier steps" in warning["message"]


@pytest.mark.parametrize("kind", [Named, Derived])
def test_names_or_sizes_tell_what_an_environment_gives(run: odaf.Run, kind: Any):
    scores = odaf.evaluate(run.directory, environment=kind, episodes=2)
    assert np.isfinite(scores.by_seed[0].returns).all()
    alike = np.allclose(scores.by_seed[0].returns, run.scores().by_seed[0].returns, rtol=1e-5)
    assert alike == (kind is Named), "the other plays its first step by itself"


def test_an_environment_of_another_size_is_refused_with_both_sizes(run: odaf.Run):
    with pytest.raises(
        ConfigError, match=r"shape \(4,\), the data's \(5,\), their 2 readings' \(2,\) .level, setpoint."
    ):
        odaf.evaluate(run.directory, environment=Wide)


def test_readings_without_an_observation_break_off_their_episode():
    data = log("root = sqrt(level)")
    derivation = Derivation.from_provenance(data.provenance)
    assert examine(Empty, "Empty", data.spec(), data.observation_names, derivation=derivation).derivation is derivation
    rooted = odaf.Policy(
        init_gaussian_actor(jr.key(0), 2, 1, (4,)),
        Normaliser.fit(data.observations),
        (0.0,),
        (10.0,),
        ("level", "root"),
        ("valve",),
        derivation=derivation,
    )
    found = odaf.rollout(rooted, Empty, episodes=2)
    assert found.broken == dict.fromkeys(range(2), "an action is not finite at step 4")
    mixed = Player(rooted, 2).act(np.array([[1.0], [-1.0]]), np.array([True, True]))
    assert np.isfinite(mixed[0]).all() and np.isnan(mixed[1]).all()


def test_what_measures_in_observations_says_that_it_cannot(run: odaf.Run, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ConfigError, match=r"computes its 5 observations of readings .level, setpoint."):
        AttackedPolicy(run.policy(seed=0), ATTACKS["random"], 0.1, jr.key(0))
    gym.register("Tank-v0", entry_point=lambda **options: Tank())
    try:
        with pytest.raises(ConfigError, match="knock: .* Tank-v0 gives the readings"):
            knock_scores(run.directory, Knock(steps=1, at=2), environment="Tank-v0", episodes=1)
    finally:
        del gym.registry["Tank-v0"]
