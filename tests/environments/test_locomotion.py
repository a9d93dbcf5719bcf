"""The bare simulator gives Gymnasium's own bits, and can be put back to where it was."""

import warnings

import gymnasium
import numpy as np
import pytest

from odaf.environments.locomotion import TASKS, Simulator, task_of
from odaf.errors import ConfigError


@pytest.mark.parametrize(
    ("name", "version"), [("halfcheetah", "v4"), ("hopper", "v4"), ("walker2d", "v4"), ("hopper", "v5")]
)
def test_the_bits_of_the_wrapped_environment(name, version, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = TASKS[name]
    simulator = Simulator(task, version)
    assert list(tmp_path.iterdir()) == [], "the simulator's notices are kept from the folder"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wrapped = gymnasium.make(task.environment_id(version))
    rng = np.random.default_rng(0)
    for seed in (3, 4):
        observation, expected = simulator.reset(seed), wrapped.reset(seed=seed)[0]
        np.testing.assert_array_equal(observation, expected)
        assert observation.shape == (task.obs_dim,) and simulator.body().shape == (2 * task.positions,)
        for _ in range(30):
            action = rng.uniform(-1.0, 1.0, task.act_dim).astype(np.float32)
            observation, reward, terminated = simulator.step(action)
            expected, earned, fell, _, _ = wrapped.step(action)
            np.testing.assert_array_equal(observation, expected)
            assert (reward, terminated) == (earned, fell)
            if terminated:
                break


def test_going_on_from_a_saved_state_gives_the_same_bits():
    simulator, other = Simulator(TASKS["hopper"]), Simulator(TASKS["hopper"])
    simulator.reset(0)
    other.reset(9)
    rng = np.random.default_rng(1)
    for _ in range(5):
        simulator.step(0.1 * rng.uniform(-1.0, 1.0, 3))
    other.restore(simulator.physics())
    for _ in range(5):
        action = 0.1 * rng.uniform(-1.0, 1.0, 3)
        first, second = simulator.step(action), other.step(action)
        np.testing.assert_array_equal(first[0], second[0])
        assert first[1:] == second[1:]


def test_unknown_tasks_and_versions_are_named():
    with pytest.raises(ConfigError, match="ant.*halfcheetah, hopper, walker2d"):
        task_of("ant")
    with pytest.raises(ConfigError, match="v3.*v4, v5"):
        task_of("hopper", "v3")
