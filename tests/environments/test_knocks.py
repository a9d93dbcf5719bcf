"""Knocks in an environment that counts, and on real bodies."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from odaf.environments.knocks import LEVELS, Knock, Knocked, UnusualStart
from odaf.environments.locomotion import TASKS, Simulator
from odaf.environments.maze import STITCH
from odaf.environments.registry import make_untimed
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import rollout

HOPPER = {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}


class Counter:
    """Observation and reward are the simulator steps so far; it ends truly in the steps listed, and goes on if told."""

    def __init__(self, ends=(), low=-2.0, high=4.0):
        self.ends, self.actions = set(ends), []
        self.action_space = gymnasium.spaces.Box(low, high, (2,), np.float32)
        self.closed = False

    def reset(self, *, seed=None):
        self.steps, self.actions, self.seed = 0, [], seed
        return np.zeros(1), {"start": True}

    def step(self, action):
        self.steps += 1
        self.actions.append(np.asarray(action))
        return np.full(1, self.steps, float), float(self.steps), self.steps in self.ends, False, {"own": True}

    def close(self):
        self.closed = True


def _play(environment, count):
    """Steps with action 1 until the end or `count` are done."""
    environment.reset(seed=3)
    lines: list[Any] = []
    while len(lines) < count and not (lines and (lines[-1][2] or lines[-1][3])):
        lines.append(environment.step(np.ones(2, np.float32)))
    return lines


def test_a_knock_is_not_counted():
    body = Counter(ends=(6, 7))  # true ends within the knock
    lines = _play(Knocked(body, Knock(steps=4, at=5), limit=8), 20)
    assert [float(line[0][0]) for line in lines] == [1, 2, 3, 4, 9, 10, 11, 12]  # steps 6 to 9 are the knock
    assert [line[1] for line in lines] == [1, 2, 3, 4, 5, 10, 11, 12]  # each the reward of the counted step
    assert [line[2] for line in lines] == [False] * 8 and [line[3] for line in lines] == [False] * 7 + [True]
    assert [line[4]["knocked"] for line in lines] == [False] * 4 + [True] * 4
    assert all(line[4]["survived"] and line[4]["own"] for line in lines)
    assert len(body.actions) == 12
    by_policy = [(action == 1.0).all() for action in body.actions]
    assert by_policy == [True] * 5 + [False] * 4 + [True] * 3
    knocked = np.stack(body.actions[5:9])
    assert (knocked >= 0).all() and (knocked <= 1e-3).all() and len(np.unique(knocked)) == 8


def test_a_body_that_is_down_after_the_knock_ends_the_episode_at_the_next_counted_step():
    lines = _play(Knocked(Counter(ends=(7, 8, 9, 10)), Knock(steps=3, at=5), limit=20), 20)
    assert len(lines) == 6 and lines[-1][2] and not lines[-1][3]
    assert lines[-1][4]["knocked"] and not lines[-1][4]["survived"]
    assert sum(line[1] for line in lines) == 1 + 2 + 3 + 4 + 5 + 9


def test_an_episode_that_ends_before_is_not_knocked():
    for end in (3, 5):  # also by the very step that the knock would follow
        body = Counter(ends=(end,))
        lines = _play(Knocked(body, Knock(steps=3, at=5), limit=20), 20)
        assert len(lines) == body.steps == end and not lines[-1][4]["knocked"] and not lines[-1][4]["survived"]


def test_no_knock_leaves_the_counted_steps_alone_and_objects_can_be_used_again():
    environment = Knocked(Counter(), Knock(steps=0, at=500), limit=6)  # a time that no episode reaches
    for _ in range(2):
        lines = _play(environment, 20)
        assert [line[1] for line in lines] == [1, 2, 3, 4, 5, 6] and not lines[-1][4]["knocked"]
    environment.close()
    assert environment.environment.closed


@pytest.mark.parametrize(("action", "std"), [("uniform", 6.0 / np.sqrt(12.0)), ("gaussian", 3.0 * 0.7183)])
def test_other_kinds_of_action(action, std):
    body = Counter()
    _play(Knocked(body, Knock(steps=2000, at=1, action=action), limit=2), 2)
    drawn = np.stack(body.actions[1:2001])
    assert drawn.dtype == np.float32 and drawn.min() >= -2.0 and drawn.max() <= 4.0
    # A standard normal clipped to [-1, 1] has the variance 0.1987 + 0.3173, its square root is 0.7183.
    # 4,000 numbers: the standard error of the mean is below 0.04.
    assert abs(drawn.mean() - 1.0) < 0.2 and abs(drawn.std() / std - 1.0) < 0.04
    again = Counter()
    _play(Knocked(again, Knock(steps=2000, at=1, action=action), limit=2), 2)
    np.testing.assert_array_equal(np.stack(again.actions[1:2001]), drawn)  # equal seeds, equal knocks


def test_levels_and_what_is_refused():
    assert LEVELS == {"none": 0, "slight": 5, "moderate": 10, "large": 15, "extra-large": 30}
    with pytest.raises(ConfigError, match="steps is -1"):
        Knock(steps=-1)
    with pytest.raises(ConfigError, match="at is 0"):
        Knock(at=0)
    with pytest.raises(ConfigError, match="500, but an episode has 200 counted steps.*--knock-at 100"):
        Knocked(Counter(), Knock(), limit=200)
    with pytest.raises(ConfigError, match="'uniform' actions need bounds"):
        Knocked(Counter(low=-np.inf), Knock(action="uniform"), limit=600)


# ---- real bodies ---------------------------------------------------------------------------------------------------


def test_a_knocked_hopper_against_the_bare_simulator():
    build, limit = make_untimed(HOPPER)
    assert limit == 1000
    environment = Knocked(build(), Knock(steps=4, at=3), limit=8)
    bare = Simulator(TASKS["hopper"])
    observation, expected = environment.reset(seed=5)[0], bare.reset(5)
    np.testing.assert_array_equal(observation, expected)
    # The documented draws of a knock: seed [reset seed, 0], U(0, 1e-3) in single precision.
    random = np.random.default_rng([5, 0])
    action = np.array([0.3, -0.2, 0.1], np.float32)
    for counted in range(1, 9):
        observation, reward, terminated, truncated, _ = environment.step(action)
        expected, earned, fell = bare.step(action)
        if counted == 3:
            for _ in range(4):
                expected = bare.step(random.uniform(0.0, 1e-3, 3).astype(np.float32))[0]
        np.testing.assert_array_equal(observation, expected)
        assert (reward, terminated, truncated) == (earned, fell, counted == 8)
    environment.close()


def test_time_limits_are_taken_off_and_told():
    build, limit = make_untimed({**HOPPER, "kwargs": {"max_episode_steps": 3}})
    assert limit == 3
    environment = build()
    environment.reset(seed=0)
    assert not any(environment.step(np.zeros(3, np.float32))[3] for _ in range(5))
    assert "TimeLimit" not in str(environment)
    environment.close()
    build, limit = make_untimed({"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 4})
    assert limit == 4
    environment = build()
    environment.reset(seed=0)
    assert not any(environment.step(np.zeros(2))[3] for _ in range(6))
    with pytest.raises(ConfigError, match="steps is 0"):
        make_untimed({"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 0})


def test_unusual_starts_are_off_by_noise_times_the_spread():
    build, _ = make_untimed(HOPPER)
    std = np.linspace(0.1, 1.1, 11)
    usual, unusual, still = build(), UnusualStart(build(), 0.1, std), UnusualStart(build(), 0.0, std)
    for seed in (0, 1):
        before, after = usual.reset(seed=seed)[0], unusual.reset(seed=seed)[0]
        expected = before + 0.1 * std * np.random.default_rng([seed, 1]).standard_normal(11)
        np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-12)
        assert unusual._body.data.qpos[0] == usual.unwrapped.data.qpos[0]  # type: ignore[attr-defined]
        np.testing.assert_array_equal(still.reset(seed=seed)[0], before)
    for environment in (usual, unusual, still):
        environment.close()


def test_unusual_starts_are_for_bodies_whose_pose_is_observed():
    maze = make_untimed({"name": "pointmaze", "maze": STITCH.to_dict()})[0]()
    with pytest.raises(ConfigError, match="HalfCheetah, Hopper, Walker2d"):
        UnusualStart(maze, 0.1, np.ones(4))
    with pytest.raises(ConfigError, match="is -0.1"):
        UnusualStart(maze, -0.1, np.ones(4))


def test_rollouts_play_them():
    found = rollout(
        lambda rows: np.zeros((len(rows), 2), np.float32), lambda: Knocked(Counter(), Knock(2, 3), limit=5), 2
    )
    np.testing.assert_array_equal(found.lengths, [5, 5])
    np.testing.assert_array_equal(found.returns, [1 + 2 + 3 + 6 + 7] * 2)
    np.testing.assert_array_equal(found.observations[0, :, 0], [0, 1, 2, 5, 6, 7])
    assert found.flags["survived"].all() and found.flags["knocked"].all()
