"""Environments of all kinds that people bring: played, or refused before anything is trained."""

import json
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import odaf
from odaf.data.spec import Spec
from odaf.errors import ConfigError
from odaf.evaluation.examination import examine

SPEC = Spec(2, 1, (-1.0,), (1.0,), 0.0, 1.0, False, 20)
NAMES = ("state", "goal")


class Plain(gym.Env):
    """Two numbers, one action, twenty steps; subclasses go wrong in one way each."""

    observation_space = gym.spaces.Box(-9, 9, (2,))
    action_space: Any = gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return self.see(), {}

    def see(self) -> Any:
        return np.array([self.t, 7.0], np.float32)

    def pay(self) -> Any:
        return 1.0

    def step(self, action) -> Any:
        self.t += 1
        return self.see(), self.pay(), False, self.t >= 20, {}


class Dictionaries(Plain):
    def see(self):
        return {"goal": np.array([7.0]), "state": np.array([float(self.t)])}


class Nested(Plain):
    def see(self):
        return {"goal": np.array([7.0, 8.0]), "state": {"arm": np.array([1.0]), "leg": np.zeros(0)}, "extra": 3.0}


class Discrete(Plain):
    action_space = gym.spaces.Discrete(3)


class Wide(Plain):
    def see(self):
        return np.zeros(11, np.float32)


class Unmakeable(Plain):
    def __init__(self):
        raise OSError("no licence")


class Unsteppable(Plain):
    def step(self, action):
        raise ZeroDivisionError("division by zero")


class OldGym(Plain):
    def step(self, action) -> Any:
        return self.see(), 1.0, False, {}


class Words(Plain):
    def pay(self):
        return "good"


class Greedy(Plain):
    """Writes into the action it is given, and pays with an array of one."""

    def step(self, action):
        assert action[0] != 0.0, "somebody's copy was written into"
        action[:] = 0.0
        return super().step(action)

    def pay(self):
        return np.ones(1)


class GlobalDice(Plain):
    """Draws from the global generator, as some mazes do."""

    def see(self):
        return np.random.normal(size=2).astype(np.float32)  # noqa: NPY002


class GoalWhenMade(Plain):
    """Draws its goal when it is made, as some manipulation tasks do."""

    made = 0

    def __init__(self):
        GoalWhenMade.made += 1
        self.goal = GoalWhenMade.made

    def pay(self):
        return float(self.goal)


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        (Discrete, r"its actions are Discrete\(3\), but the data's are 1 numbers .*continuous"),
        (Wide, r"observations have shape \(11,\), the data's \(2,\).*--env"),
        (Unmakeable, r"cannot be made \(OSError: no licence\)"),
        (Unsteppable, r"its step fails \(ZeroDivisionError: division by zero\)"),
        (OldGym, "its step gives 4 results"),
        (Words, "reward: expected one number, the environment's step gave 'good'"),
    ],
)
def test_what_cannot_work_is_refused_with_the_remedy(kind, named):
    with pytest.raises(ConfigError, match=named):
        examine(kind, "Probe", SPEC, NAMES)


def test_dictionaries_are_joined_in_the_order_of_the_data_or_refused():
    environment = examine(Dictionaries, "Probe", SPEC, NAMES).make_env()
    environment.reset(seed=1)
    np.testing.assert_array_equal(environment.step(np.zeros(1))[0], [1.0, 7.0])  # state first, as the data have it
    nested = Spec(3, 1, (-1.0,), (1.0,), 0.0, 1.0, False, 20)
    joined = examine(Nested, "Probe", nested, ("state/arm", "goal_0", "goal_1")).make_env()
    np.testing.assert_array_equal(joined.reset(seed=1)[0], [1.0, 7.0, 8.0])
    refusal = r"dictionaries of goal \[1\], state \[1\].*\(obs_0, obs_1\) do not say which.*Rollouts\(make_env\)"
    with pytest.raises(ConfigError, match=refusal):
        examine(Dictionaries, "Probe", SPEC, ("obs_0", "obs_1"))


@pytest.mark.parametrize(
    ("kind", "what"), [(GlobalDice, "the first observations differ"), (GoalWhenMade, "the rewards of one step differ")]
)
def test_an_environment_that_ignores_its_seed_is_named(kind, what):
    found = examine(kind, "Probe", SPEC, NAMES)
    assert what in found.ignores_seed
    assert "ignores its seed" in found.warnings["unseeded-environment"]
    assert examine(Plain, "Probe", SPEC, NAMES).warnings == {}


@pytest.fixture
def data() -> odaf.Dataset:
    rng = np.random.default_rng(0)
    return odaf.Dataset.from_arrays(
        rng.normal(size=(60, 2)), rng.uniform(-1, 1, (60, 1)), rng.normal(size=60),
        episode=np.repeat(np.arange(6), 10), action_bounds=(-1, 1), observation_names=list(NAMES),
    )  # fmt: skip


def _fit(data, directory, environment, **changes):
    learner = odaf.BehaviourCloning(hidden_sizes=(4,), batch_size=8)
    rollouts = odaf.Rollouts(environment, episodes=2, every=2)
    return odaf.fit(learner, data, steps=2, directory=directory, evaluate=rollouts, progress=False, **changes)


def test_nothing_is_trained_for_an_environment_that_does_not_fit(data, tmp_path):
    with pytest.raises(ConfigError, match="the data's"):
        _fit(data, tmp_path / "run", Wide)
    assert not (tmp_path / "run").exists()


def test_a_class_is_played_recorded_and_asked_for_again(data, tmp_path):
    run = _fit(data, tmp_path / "run", Greedy)
    assert run.scores().by_seed[0].returns == (20.0, 20.0)
    where = f"{Greedy.__module__}.Greedy"
    assert run.config["evaluate"]["environment"] == {"name": "callable", "made_by": where}
    with pytest.raises(ConfigError, match=rf"evaluated in what {re.escape(where)} builds.*odaf\.Rollouts\(MyEnv"):
        odaf.resume(run.directory, 4, dataset=data, progress=False)
    odaf.resume(run.directory, 4, dataset=data, evaluate=odaf.Rollouts(Greedy, episodes=2, every=2), progress=False)
    scores = odaf.evaluate(run.directory, environment=Dictionaries, episodes=3)
    assert scores.by_seed[0].returns == (20.0, 20.0, 20.0) and scores.environment is None


def test_a_module_is_imported_before_its_environment_is_made(data, tmp_path, monkeypatch):
    (tmp_path / "plant_worlds.py").write_text(
        "import gymnasium as gym, numpy as np\n"
        "class Plant(gym.Env):\n"
        "    observation_space, action_space = gym.spaces.Box(-9, 9, (2,)), gym.spaces.Box(-1, 1, (1,))\n"
        "    def reset(self, *, seed=None, options=None): return np.zeros(2, np.float32), {}\n"
        "    def step(self, action): return np.zeros(2, np.float32), 2.0, True, False, {}\n"
        "gym.register('Plant-v0', entry_point=Plant)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    run = _fit(data, tmp_path / "run", "plant_worlds:Plant-v0")
    assert run.scores().by_seed[0].returns == (2.0, 2.0)
    with pytest.raises(ConfigError, match=r"'no_such_worlds' cannot be imported.*PYTHONPATH"):
        _fit(data, tmp_path / "other", "no_such_worlds:Plant-v0")


def test_the_warning_about_the_seed_is_in_the_run_and_beside_the_scores(data, tmp_path):
    run = _fit(data, tmp_path / "run", GoalWhenMade)
    (warning,) = run.summary[0]["warnings"]
    assert warning["kind"] == "unseeded-environment" and "ignores its seed" in warning["message"]
    assert "ignores its seed" in odaf.evaluate(run.directory, environment=GlobalDice, episodes=1).notes[0]


class BreaksLater(Plain):
    """Fails in a way of its own once it has been used for a while."""

    steps = 0

    def step(self, action):
        BreaksLater.steps += 1
        if BreaksLater.steps > 30:
            raise ValueError("unstable")
        return super().step(action)


def test_a_failure_on_the_way_names_what_is_saved_and_how_to_go_on(data, tmp_path):
    BreaksLater.steps = 0
    with pytest.raises(ConfigError, match=r"after update 2 \(ValueError: unstable\).*is saved in .*--no-evaluation"):
        _fit(data, tmp_path / "run", BreaksLater)
    assert odaf.load_run(tmp_path / "run").summary[0]["step"] == 2
    run = odaf.resume(tmp_path / "run", 4, dataset=data, evaluate=None, progress=False)
    assert run.summary[0]["status"] == "finished" and run.summary[0]["step"] == 4


def test_every_episode_is_in_the_json_of_evaluate(data, tmp_path, monkeypatch):
    from odaf.cli import main

    run = _fit(data, tmp_path / "run", Plain)
    monkeypatch.setitem(run.config, "evaluate", None)
    gym.register("Plain-v0", entry_point=lambda **options: Plain())
    file = tmp_path / "scores.json"
    try:
        words = ["evaluate", str(run.directory), "--env", "Plain-v0", "--episodes", "3", "--json", str(file)]
        assert main(words) == 0
    finally:
        del gym.registry["Plain-v0"]
    entry = json.loads(Path(file).read_text())["seeds"]["0"]
    assert entry["returns"] == [20.0] * 3 and entry["lengths"] == [20] * 3 and entry["std_return"] == 0.0
