"""Rollouts in environments with known answers."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from odaf.components.policies import Actor
from odaf.data.normalisation import Normaliser
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET, MOST_EPISODES
from odaf.errors import ConfigError, DivergenceError
from odaf.evaluation import Episodes, RolloutEvaluator, Rollouts, rollout
from odaf.evaluation.parts import in_one
from odaf.evaluation.rollouts import summarise
from odaf.training.policy import Policy


class Countdown:
    """Lasts as many steps as its seed says (3 + seed % 5); pays its step number; obs is [seed digit, steps so far]."""

    made, closed = 0, 0

    def __init__(self, endless=False):
        Countdown.made += 1
        self.endless = endless

    def reset(self, *, seed=None):
        assert seed is not None
        self.seed, self.steps = seed, 0
        self.length = 3 + seed % 5
        return self._observation(), {}

    def step(self, action):
        assert self.steps < self.length or self.endless, "stepped after the end"
        self.steps += 1
        self.action = np.asarray(action)
        done = self.steps == self.length and not self.endless
        info = {"success": self.length > 5, "stitched": np.bool_(self.length == 4), "length": self.length}
        return (
            self._observation(),
            float(self.steps),
            done and self.length % 2 == 0,
            done and self.length % 2 == 1,
            info,
        )

    def close(self):
        Countdown.closed += 1

    def _observation(self):
        return np.array([self.seed % 5, self.steps], np.float64)


def _constant(rows):
    return np.zeros((len(rows), 1), np.float32)


def test_an_evaluation_in_parts_is_the_whole_one():
    """Episodes of lengths 3 to 7; in the second part two break off, and no sound one is left that tells its flags."""

    def act(rows):
        return np.where(np.isin(rows[:, :1], (2.0, 3.0)), np.nan, 0.0).astype(np.float32)

    whole = rollout(act, Countdown, 7, seed=3)
    parts = [rollout(act, Countdown, count, seed=3, first=first) for first, count in ((0, 2), (2, 2), (4, 3))]
    joined = in_one(parts)
    for name in ("observations", "rewards", "lengths", "returns"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    assert joined.broken == whole.broken and set(whole.broken) == {2, 3} and not parts[1].flags
    assert {name: flag.tolist() for name, flag in joined.flags.items()} == {
        name: flag.tolist() for name, flag in whole.flags.items()
    }
    with pytest.raises(ConfigError, match="episodes: must be from 1 to"):
        rollout(act, Countdown, 2, first=MOST_EPISODES - 1)


def test_each_environment_plays_one_whole_episode_and_no_more():
    Countdown.made = Countdown.closed = 0
    found = rollout(_constant, Countdown, 7)
    lengths = np.array([3, 4, 5, 6, 7, 3, 4])
    np.testing.assert_array_equal(found.lengths, lengths)
    np.testing.assert_array_equal(found.returns, lengths * (lengths + 1) / 2)
    assert found.observations.shape == (7, 8, 2) and found.rewards.shape == (7, 7)
    for row, length in enumerate(lengths):
        np.testing.assert_array_equal(found.observations[row, : length + 1, 1], np.arange(length + 1))
        assert np.isnan(found.observations[row, length + 1 :]).all() and np.isnan(found.rewards[row, length:]).all()
        np.testing.assert_array_equal(found.rewards[row, :length], np.arange(1, length + 1))
    assert set(found.flags) == {"success", "stitched"}  # booleans only
    np.testing.assert_array_equal(found.flags["success"], lengths > 5)
    np.testing.assert_array_equal(found.flags["stitched"], lengths == 4)
    assert Countdown.made == Countdown.closed == 7


def test_policy_is_asked_once_a_step_for_all_rows_and_gets_what_it_sees():
    asked = []

    def policy(rows):
        asked.append(rows.copy())
        return rows[:, :1].astype(np.float32)

    rollout(policy, Countdown, 6)
    assert len(asked) == 7 and all(rows.shape == (6, 2) and np.isfinite(rows).all() for rows in asked)


def test_evaluation_seeds_are_fixed_distinct_and_far_from_data_seeds():
    seeds = {}

    class Recorder(Countdown):
        def reset(self, *, seed=None):
            seeds.setdefault(current, []).append(seed)
            return super().reset(seed=seed)

    for current in (0, 1, 9999):
        rollout(_constant, Recorder, 5, seed=current)
    everything = [seed for group in seeds.values() for seed in group]
    assert len(set(everything)) == 15 and min(everything) == EVALUATION_SEED_OFFSET == 1_000_000
    assert max(everything) < 2**31  # what environments accept as a seed


def test_max_steps_cuts_and_endless_environments_are_refused(monkeypatch):
    found = rollout(_constant, lambda: Countdown(endless=True), 2, max_steps=11)
    np.testing.assert_array_equal(found.lengths, [11, 11])
    monkeypatch.setattr("odaf.evaluation.rollouts._NO_LIMIT", 50)
    with pytest.raises(ConfigError, match="max_steps"):
        rollout(_constant, lambda: Countdown(endless=True), 2)


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"episodes": 0}, "episodes"), ({"every": 0}, "every"), ({"seed": -1}, "seed"), ({"max_steps": 0}, "max_steps")],
)
def test_numbers_out_of_range_are_named(changes, named):
    with pytest.raises(ConfigError, match=named):
        Rollouts(**changes)


def test_rollouts_resolve_their_environment():
    own = {"name": "pointmaze", "maze": {}}
    assert Rollouts().resolved(own).environment == own
    hopper = {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}
    resolved = Rollouts("Hopper-v4", episodes=3, max_steps=9).resolved(own)
    assert resolved.environment == hopper
    assert Rollouts.from_dict(resolved.to_dict()) == resolved
    with pytest.raises(ConfigError, match="names no environment"):
        Rollouts().resolved(None)
    with pytest.raises(ConfigError, match="kind"):
        Rollouts.from_dict({"kind": "guess"})


def test_summary_of_hand_worked_episodes():
    episodes = Episodes(
        observations=np.zeros((4, 2, 1), np.float32),
        rewards=np.array([[1.0], [2.0], [3.0], [6.0]], np.float32),
        lengths=np.ones(4, np.int64),
        returns=np.array([1.0, 2.0, 3.0, 6.0]),
        flags={"success": np.array([True, False, True, True])},
    )
    found = summarise(episodes)
    assert found.headline == found.summary["mean_return"] == found.metrics["evaluation/return_mean"] == 3.0
    assert found.metrics["evaluation/return_std"] == pytest.approx(np.sqrt((4 + 1 + 0 + 9) / 4))
    assert found.metrics["evaluation/success_rate"] == found.summary["success_rate"] == 0.75
    assert found.summary["returns"] == [1.0, 2.0, 3.0, 6.0] and found.summary["episodes"] == 4
    assert "stitched_rate" not in found.summary  # the environment did not report it


class Traced(Actor):
    """Acts on the first observation, and notes every trace."""

    gain: Array
    traces: ClassVar[list[tuple[int, ...]]] = []

    def act(self, carry, observations, key=None):
        Traced.traces.append(observations.shape)
        return jnp.tanh(observations[:, :1] * self.gain), carry


def _policy(actor) -> Policy:
    return Policy(actor, Normaliser.identity(2), (-2.0,), (6.0,), ("digit", "steps"))


def test_policy_is_compiled_once_for_all_steps_checkpoints_and_seeds(tmp_path):
    Traced.traces.clear()
    evaluator = RolloutEvaluator(Rollouts(episodes=5), Countdown)
    Countdown.made = Countdown.closed = 0
    for step, gain in enumerate((0.5, 1.5, 2.5)):
        evaluator(_policy(Traced(jnp.asarray(gain))), tmp_path, step)
    assert Traced.traces == [(5, 2)]
    assert Countdown.made == 5 and Countdown.closed == 0  # environments are reused
    evaluator.close()
    assert Countdown.closed == 5


def test_evaluations_are_deterministic_and_saved_whole(tmp_path):
    policy = _policy(Traced(jnp.asarray(0.5)))
    evaluator = RolloutEvaluator(Rollouts(episodes=6, seed=2), Countdown)
    first, second = evaluator(policy, tmp_path, 10), evaluator(policy, tmp_path, 20)
    assert first == second
    fresh = rollout(policy, Countdown, 6, seed=2)
    for step in (10, 20):
        with np.load(tmp_path / "evaluations" / f"{step:08d}.npz", allow_pickle=False) as saved:
            assert set(saved) == {"observations", "rewards", "lengths", "returns", "success", "stitched"}
            for name in ("observations", "rewards", "lengths", "returns"):
                np.testing.assert_array_equal(saved[name], getattr(fresh, name))
            np.testing.assert_array_equal(saved["success"], fresh.flags["success"])
            assert saved["observations"].dtype == np.float32


class RewardSum(Actor):
    """Its action is a hundredth of all that was earned so far."""

    def begin(self, rows):
        return jnp.zeros(rows)

    def act(self, carry, observations, key=None):
        return carry[:, None] / 100.0, carry

    def observe(self, carry, rewards):
        return carry + rewards


def test_a_policy_with_a_memory_hears_what_its_own_episode_earned():
    played = []

    class Recorder(Countdown):
        def step(self, action):
            played.append((self.seed, float(action[0])))
            return super().step(action)

    policy = Policy(RewardSum(), Normaliser.identity(2), (-1.0,), (1.0,), ("digit", "steps"))
    episodes = rollout(policy, Recorder, 4, seed=1)
    for index, rewards in enumerate(episodes.rewards):
        length = episodes.lengths[index]
        own = [action for seed, action in played if seed % MOST_EPISODES == index][:length]
        np.testing.assert_allclose(own, np.cumsum([0.0, *rewards[: length - 1]]) / 100.0, rtol=1e-5)


class Shaky(Countdown):
    """Fails in episodes of five steps: a reward, an observation or the policy's action is no number at step 2."""

    what = "reward"

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if self.length == 5 and self.steps == 2:
            reward = {"reward": np.nan, "huge": 1e300}.get(self.what, reward)
            observation = observation * np.inf if self.what == "observation" else observation
        return observation, reward, terminated, truncated, info


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("reward", "a reward is not finite at step 2"),
        ("huge", "a reward is not finite at step 2"),
        ("observation", "an observation is not finite at step 2"),
        ("action", "an action is not finite at step 3"),
    ],
)
def test_what_is_no_number_marks_its_episode_and_counts_in_no_mean(monkeypatch, what, expected):
    monkeypatch.setattr(Shaky, "what", what)

    def policy(rows):
        actions = _constant(rows)
        if what == "action":
            actions[(rows[:, 0] == 2) & (rows[:, 1] == 2)] = np.inf
        return actions

    found = rollout(policy, Shaky, 7)  # seeds end in 0 to 4, then 0 and 1: one episode of five steps
    assert found.broken == {2: expected}
    np.testing.assert_array_equal(np.isnan(found.returns), [False, False, True, False, False, False, False])
    assert found.lengths.tolist() == [3, 4, 2, 6, 7, 3, 4]
    assert not found.flags["success"][2]
    summed = summarise(found)
    sound = np.array([3, 4, 6, 7, 3, 4])
    assert summed.summary["mean_return"] == pytest.approx((sound * (sound + 1) / 2).mean())
    assert summed.summary["broken_episodes"] == summed.metrics["evaluation/broken_episodes"] == 1
    assert "1 of 7 episodes broke off" in summed.warnings["broken-episodes"]


def test_a_policy_without_an_answer_for_one_row_costs_that_episode_alone():
    def policy(rows):
        if ((rows[:, 0] == 3) & (rows[:, 1] == 1)).any():
            raise DivergenceError("policy: its action is not a finite number")
        return _constant(rows)

    found = rollout(policy, Countdown, 5)
    assert found.broken == {3: "an action is not finite at step 2"}
    assert found.lengths.tolist() == [3, 4, 5, 1, 7]


class Forgetful:
    """A policy with a memory, the number of steps so far, that has no answer in its third step of episode 3."""

    def begin(self, rows, /):
        return np.zeros((rows, 1), np.float32)

    def act(self, carry, observations, /):
        if ((observations[:, 0] == 3) & (carry[:, 0] == 2)).any():
            raise DivergenceError("policy: its action is not a finite number")
        return carry + 0.5, carry + 1

    def observe(self, carry, rewards, /):
        return carry


def test_the_memory_of_the_other_episodes_goes_on():
    played = []

    class Recorder(Countdown):
        def step(self, action):
            played.append((self.seed % MOST_EPISODES, float(action[0])))
            return super().step(action)

    found = rollout(Forgetful(), Recorder, 5)
    assert found.broken == {3: "an action is not finite at step 3"}
    for index, length in enumerate([3, 4, 5, 2, 7]):
        assert [action for episode, action in played if episode == index] == [step + 0.5 for step in range(length)]


def test_where_every_episode_breaks_there_is_no_mean():
    class Void(Countdown):
        def reset(self, *, seed=None):
            return super().reset(seed=seed)[0] * np.nan, {}

    found = rollout(_constant, Void, 2)
    assert set(found.broken.values()) == {"an observation is not finite at the start"}
    assert np.isnan(summarise(found).summary["mean_return"]) and found.observations.shape == (2, 1, 2)
