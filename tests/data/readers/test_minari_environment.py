"""The environment that a Minari folder names: the recorded one, or a finding and none."""

import json

import numpy as np
import pytest

from odaf.data.readers.minari_environment import REBUILT, environments_of
from odaf.environments import make
from odaf.environments.registry import make_untimed
from odaf.errors import ConfigError

SPEC = {
    "id": "Pendulum-v1",
    "entry_point": "gymnasium.envs.classic_control.pendulum:PendulumEnv",
    "max_episode_steps": 20,
    "kwargs": {"g": 3.0, "render_mode": "human"},
    "additional_wrappers": [],
}


def wrapper(name, kwargs=None, module="gymnasium.wrappers.transform_action"):
    return {"name": name, "entry_point": f"{module}:{name}", "kwargs": kwargs}


def described(asked=None, **changes):
    metadata = {"env_spec": json.dumps({**SPEC, **changes})}
    if asked is not None:
        metadata["eval_env_spec"] = json.dumps(asked)
    entries, findings = environments_of(metadata)
    return entries, [finding["finding"] for finding in findings], " ".join(each["message"] for each in findings)


def test_time_limit_and_settings_are_the_recorded_ones():
    entries, findings, _ = described()
    assert entries["environment"] == {
        "name": "gymnasium",
        "id": "Pendulum-v1",
        "kwargs": {"g": 3.0},
        "max_episode_steps": 20,
    }
    assert findings == []
    environment = make(entries["environment"])()
    assert environment.spec is not None and environment.spec.max_episode_steps == 20
    assert environment.unwrapped.g == 3.0 and environment.unwrapped.render_mode is None  # type: ignore[attr-defined]
    environment.reset(seed=0)
    ends = [environment.step(np.zeros(1, np.float32))[3] for _ in range(20)]
    assert ends == [False] * 19 + [True]
    build, limit = make_untimed(entries["environment"])
    spec = build().spec
    assert limit == 20 and spec is not None and spec.max_episode_steps is None


def test_no_time_limit_where_none_was_recorded_and_the_usual_one_where_nothing_is_said():
    entries, _, _ = described(max_episode_steps=None)
    spec = make(entries["environment"])().spec
    assert spec is not None and spec.max_episode_steps is None
    assert make_untimed(entries["environment"])[1] is None
    entries, findings = environments_of({"env_spec": json.dumps({"id": "Pendulum-v1", "kwargs": {}})})
    assert make_untimed(entries["environment"])[1] == 200 and not findings


def test_wrappers_are_put_around_it_in_their_order():
    inner = wrapper("RescaleAction", {"min_action": [-1.0], "max_action": 1.0})
    outer = wrapper("FrameStackObservation", {"stack_size": 3}, "gymnasium.wrappers.stateful_observation")
    silent = wrapper("RecordEpisodeStatistics", None, "gymnasium.wrappers.common")
    entries, findings, _ = described(additional_wrappers=[inner, silent, outer])
    environment = make(entries["environment"])()
    assert float(environment.action_space.high[0]) == 1.0  # type: ignore[attr-defined]
    assert environment.observation_space.shape == (3, 3) and not findings
    assert type(environment).__name__ == "FrameStackObservation"
    assert [each["name"] for each in entries["environment"]["wrappers"]] == ["RescaleAction", "FrameStackObservation"]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"additional_wrappers": [wrapper("Evil", {}, "os")]}, "its wrapper 'os:Evil' is none of ClipAction"),
        ({"additional_wrappers": [wrapper("RescaleAction", {}, "mine.gymnasium.wrappers.x")]}, "'mine.gymnasium.wr"),
        ({"additional_wrappers": [wrapper("NormalizeObservation", {})]}, "NormalizeObservation' is none of"),
        ({"additional_wrappers": [wrapper("RescaleAction")]}, "RescaleAction was recorded without its settings"),
        (
            {"additional_wrappers": [wrapper("RescaleAction", {"func": 1})]},
            "has the settings {'func': 1}, exp",
        ),
        ({"additional_wrappers": [None]}, "its wrapper None is none of"),
        ({"max_episode_steps": -3}, "max_episode_steps is -3, neither"),
        ({"kwargs": {"g": float("nan")}}, "its settings {'g': nan} hold more than"),
        ({"id": "os:Evil-v0"}, "its id 'os:Evil-v0' has a module imported"),
    ],
)
def test_what_cannot_be_rebuilt_is_named_and_no_environment_is(changes, reason):
    entries, findings, message = described(**changes)
    assert entries == {} and findings == ["environment-not-rebuilt"] and reason in message
    json.dumps(entries, allow_nan=False)


def test_the_environment_for_evaluation_comes_first():
    asked = {**SPEC, "kwargs": {"g": 2.0}, "max_episode_steps": 200}
    entries, findings, message = described(asked)
    assert entries["environment"]["kwargs"] == {"g": 2.0} and entries["recorded_environment"]["kwargs"] == {"g": 3.0}
    assert findings == ["evaluation-environment"] and "Pendulum-v1 with g = 2.0, at most 200 steps" in message
    assert described(SPEC)[0] == described()[0]  # the same twice is no other
    entries, findings, _ = described({**asked, "id": "mine:X-v0"})
    assert "environment" not in entries and "recorded_environment" in entries
    assert findings == ["environment-not-rebuilt"]
    entries, findings, _ = described(asked, id="mine:X-v0")
    assert entries["environment"]["kwargs"] == {"g": 2.0} and findings == ["evaluation-environment"]


def test_nothing_is_said_where_nothing_is_named():
    for text in (None, "", "[1]", "{", "[" * 9_999, json.dumps({"id": 3})):
        assert environments_of({"env_spec": text}) == ({}, [])


def test_every_wrapper_that_is_promised_exists_and_takes_those_settings():
    import inspect

    import gymnasium.wrappers

    for name, settings in REBUILT.items():
        parameters = set(inspect.signature(getattr(gymnasium.wrappers, name).__init__).parameters)
        assert settings <= parameters, name


def test_a_description_names_no_other_wrappers():
    description = {"name": "gymnasium", "id": "Pendulum-v1", "wrappers": [{"name": "TransformReward", "kwargs": {}}]}
    with pytest.raises(ConfigError, match="'TransformReward'.* is unknown; known are ClipAction"):
        make(description)
    ill = {**description, "wrappers": [{"name": "FrameStackObservation", "kwargs": {"stack_size": -2}}]}
    with pytest.raises(ConfigError, match="its wrapper FrameStackObservation cannot be put around it"):
        make(ill)()
