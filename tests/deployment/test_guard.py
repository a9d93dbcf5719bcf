"""A guarded policy: what its score is made of, that its promise holds, and that no reading deafens it."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import odaf
from golden.runs import untrained_run
from golden.tiny import linear_dataset
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.dynamics import DynamicsConfig, untrained
from odaf.components.policies import init_deterministic_actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.deployment import GuardedPolicy, guard
from odaf.deployment.guard import judged
from odaf.deployment.make_guard import parts_of
from odaf.deployment.score import MISSING, PARTS, GuardScore
from odaf.deployment.why import Explainer
from odaf.errors import CheckpointError, ConfigError, DatasetError
from odaf.training.policy import Policy

TINY: dict[str, Any] = {"steps": 2, "hidden_sizes": (4,), "references": 50, "members": 2}
OBS, ACT = 3, 2


@pytest.fixture(scope="module")
def log() -> Dataset:
    return linear_dataset(episodes=40, length=12, seed=0, noise=0.05)


@pytest.fixture(scope="module")
def aside() -> Dataset:
    return linear_dataset(episodes=60, length=12, seed=1, noise=0.05)


@pytest.fixture(scope="module")
def policy(log: Dataset) -> Policy:
    actor = init_deterministic_actor(jax.random.key(3), OBS, ACT, (4,))
    names = log.observation_names, log.action_names
    return Policy(actor, Normaliser.fit(log.observations), (-1.0, -1.0), (1.0, 1.0), *names)


@pytest.fixture(scope="module")
def made(policy: Policy, log: Dataset, aside: Dataset) -> GuardedPolicy:
    return guard(policy, aside, log=log, false_alarms=0.05, reaction="clone", **TINY)


def reacting(made: GuardedPolicy, reaction: str, threshold: float | None = None) -> GuardedPolicy:
    calibration = made.calibration
    if threshold is not None:
        calibration = dataclasses.replace(calibration, threshold=threshold)
    return dataclasses.replace(made, reaction=reaction, calibration=calibration)


def played(guarded: GuardedPolicy, readings) -> tuple[list, list]:
    carry, actions, carries = guarded.begin(), [], []
    for reading in readings:
        action, carry = guarded.act(carry, np.asarray(reading, np.float32))
        actions.append(action)
        carries.append(carry)
    return actions, carries


def test_the_score_is_its_four_formulas(policy: Policy, log: Dataset):
    """Against NumPy in double precision, written from the formulas."""
    rng = np.random.default_rng(0)
    keys = jax.random.split(jax.random.key(0))
    outcome = untrained(DynamicsConfig(hidden_sizes=(4,)), keys[0], OBS, ACT)
    critics = CriticEnsemble(init_critics(keys[1], OBS, ACT, (4,), 3, "none", None))
    white, error_white = (np.eye(n) + 0.1 * np.ones((n, n)) for n in (OBS + ACT, OBS))
    points, levels = rng.normal(size=(7, OBS + ACT)), np.array([1.5, 2.0, 0.01, 3.0])
    centre, half = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 0.5])
    mean, scale = policy.normaliser.mean.astype(float), policy.normaliser.scale.astype(float)
    numbers = [jnp.asarray(x, jnp.float32) for x in (mean, 1 / scale, centre, half, white, points, error_white, levels)]
    score = GuardScore(outcome, critics, *numbers)
    seen, action = rng.normal(size=(5, OBS)), rng.uniform(-1, 1, (5, ACT))
    before = rng.normal(size=(5, OBS)), rng.uniform(-1, 1, (5, ACT))
    before[0][4] = np.nan

    z = (seen - mean) / scale
    found = judged(score, policy.actor, seen, action, before)

    def predicted(state, acts):
        return np.asarray(outcome.expected(jnp.asarray(state, jnp.float32), jnp.asarray(acts, jnp.float32)), float)

    after = jnp.asarray(predicted(z, action), jnp.float32)
    values = np.asarray(critics(after, policy.actor.mode(after)), float)
    gaps = (np.concatenate([z, action], axis=1) @ white)[:, None] - points[None]
    surprise = np.linalg.norm((z - predicted(*before)) @ error_white, axis=1)
    wanted = (
        np.stack(
            [
                (np.abs(seen - centre) / half).max(axis=1),
                np.linalg.norm(gaps, axis=-1).min(axis=1),
                values.std(axis=0),
                np.where(np.arange(5) == 4, 0.0, surprise),
            ],
            axis=1,
        )
        / levels
    )
    np.testing.assert_allclose(found.parts, wanted, rtol=2e-4, atol=1e-4)
    np.testing.assert_allclose(found.score, wanted.max(axis=1), rtol=2e-4)
    np.testing.assert_array_equal(found.part, wanted.argmax(axis=1))


def test_the_rate_is_kept_on_fresh_episodes(made: GuardedPolicy):
    """500 fresh episodes at a promised rate of 3/61: 24.6 on average, and over calibrations a spread of about 14.

    With n = 60 and rank 58 the rate of one calibration follows Beta(3, 58): below 0.15 but in one of 1,000 of them.
    """
    fresh = linear_dataset(episodes=500, length=12, seed=2, noise=0.05)
    parts = parts_of(made.score, made.policy, fresh)
    largest = np.maximum.reduceat(parts.max(axis=1), fresh.episode_starts)
    assert made.calibration.promised == pytest.approx(3 / 61)
    assert np.mean(largest > made.calibration.threshold) < 0.15
    assert made.facts["alarms"] == 60 - 58


def test_the_rate_is_that_of_playing_the_log_step_by_step(made: GuardedPolicy, aside: Dataset):
    """What is calibrated is what acts: alarms of logged episodes, acted one row after another."""
    recorded = reacting(made, "warn")
    expected = parts_of(made.score, made.policy, aside).max(axis=1)
    carry = recorded.begin(3)
    for step in range(12):
        rows = aside.episode_starts[:3] + step
        _, carry = recorded.act(carry, aside.observations[rows])
        own = parts_of(made.score, made.policy, aside, own=True).max(axis=1)[rows]
        np.testing.assert_allclose(carry.score, own, rtol=1e-4)
        np.testing.assert_array_equal(carry.alarm, ~(own <= made.calibration.threshold))
        carry = recorded.acted(carry, aside.actions[rows])
    assert len(expected) == len(aside)


@pytest.mark.parametrize("reaction", ["warn", "hold", "clone"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_missing_reading_is_an_alarm_and_deafens_nothing(made, aside, reaction, bad):
    guarded = reacting(made, reaction)
    whole, spoilt = aside.observations[:6].copy(), aside.observations[:6].copy()
    spoilt[2, 1] = bad
    actions, carries = played(guarded, spoilt)
    undisturbed, others = played(guarded, whole)
    assert carries[2].alarm[0] and not carries[1].alarm[0]
    assert guarded.said(carries[2]) == (f"reading '{aside.observation_names[1]}' is no finite number",)
    assert carries[2].part[0] == MISSING and np.isnan(carries[2].score[0])
    np.testing.assert_array_equal(actions[2], actions[1])  # nothing can be computed of it, so the last action is held
    for step in (3, 4, 5):  # the next finite reading is acted on and judged as if nothing had been
        np.testing.assert_array_equal(actions[step], undisturbed[step])
        assert np.isfinite(carries[step].score[0])
    # only surprise needs the step before; one step later all is as it was
    np.testing.assert_array_equal(carries[4].score, others[4].score)
    far = whole[5] + 1_000.0
    assert guarded.act(carries[5], far)[1].alarm[0], "deaf after a missing reading"


def test_a_missing_reading_before_anything_was_done_leaves_the_action_to_somebody_else(made, aside):
    reading = aside.observations[0].copy()
    reading[0] = np.nan
    action, carry = made.act(made.begin(), reading)
    assert np.isnan(action).all() and carry.alarm[0]
    assert np.isfinite(made.act(carry, aside.observations[0])[0]).all()


def test_reactions(made: GuardedPolicy, aside: Dataset):
    usual, far = aside.observations[0], aside.observations[0] + 50.0
    own = made.policy(far)
    first = made.policy(usual)
    for reaction, wanted in (("warn", own), ("hold", first), ("stop", np.full(ACT, np.nan))):
        actions, carries = played(reacting(made, reaction), [usual, far])
        np.testing.assert_array_equal(actions[1], wanted)
        assert carries[1].alarm[0] and not carries[0].alarm[0]
    assert made.clone is not None
    actions, _ = played(made, [usual, far])
    state = (far - made.policy.normaliser.mean) / made.policy.normaliser.scale
    clone = made.clone.mode(jnp.asarray(state[None], jnp.float32))[0]
    np.testing.assert_allclose(actions[1], clone, rtol=1e-4)
    # a stop lasts until a new episode; the others go on by themselves
    actions, carries = played(reacting(made, "stop"), [usual, far, usual])
    assert carries[2].alarm[0] and np.isnan(actions[2]).all()
    # with nothing to hold, the policy's own action
    np.testing.assert_array_equal(played(reacting(made, "hold"), [far])[0][0], own)


def test_why_names_the_part_and_the_column(made: GuardedPolicy, aside: Dataset):
    far = aside.observations[0].copy()
    far[1] += 1_000.0
    for start in ([], [aside.observations[0]]):
        _, carries = played(made, [*start, far])
        (said,) = made.said(carries[-1])
        assert "times its limit, mostly 'observation_1'" in said
    assert made.said(made.begin()) == ("",)
    # a push that leaves every column in its range is seen by the step before alone
    _, carries = played(reacting(made, "warn", threshold=1e9), [aside.observations[0], -aside.observations[0]])
    parts = np.asarray(
        judged(
            made.score,
            made.policy.actor,
            carries[1].state * made.policy.normaliser.scale + made.policy.normaliser.mean,
            carries[1].action,
            (carries[0].state, carries[0].action),
        ).parts
    )[0]
    assert parts[PARTS.index("surprise")] > parts[PARTS.index("range")]


def test_saved_and_loaded_it_acts_with_the_same_bits(made: GuardedPolicy, aside: Dataset, tmp_path: Path):
    made.save(tmp_path / "guard.safetensors")
    again = GuardedPolicy.load(tmp_path / "guard.safetensors")
    readings = [*aside.observations[:4], aside.observations[4] + 20.0]
    for ours, theirs in zip(played(made, readings), played(again, readings), strict=True):
        for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
            np.testing.assert_array_equal(one, other)
    assert again.calibration == made.calibration and str(again) == str(made)
    content = (tmp_path / "guard.safetensors").read_bytes()
    for broken, said in (
        (content[:-5], "was cut or grew"),
        (content.replace(b"deterministic-dynamics", b"deterministic_dynamics"), "sha256"),
    ):
        (tmp_path / "broken.safetensors").write_bytes(broken)
        with pytest.raises(CheckpointError, match=said):
            GuardedPolicy.load(tmp_path / "broken.safetensors")
    made.policy.save(tmp_path / "policy.safetensors")
    with pytest.raises(CheckpointError, match="expected 'odaf-guard'"):
        GuardedPolicy.load(tmp_path / "policy.safetensors")


def test_a_run_with_critics_and_dynamics_of_its_own_fits_nothing(log: Dataset, aside: Dataset, tmp_path: Path):
    log.save(tmp_path / "log.h5")
    learner = dataclasses.replace(odaf.preset("odaf"), hidden_sizes=(4,), num_critics=3)
    run = untrained_run(tmp_path / "run", learner, log, seeds=(0,), data=tmp_path / "log.h5")
    told: list[tuple[int, int]] = []
    made = odaf.guard(run, aside, false_alarms=0.05, references=20, progress=lambda *done: told.append(done))
    assert (made.facts["critics"], made.facts["dynamics"]) == ("the run's own 3", "the run's own")
    assert not told
    assert made.score.critics.networks.weights[0].shape[0] == 3


def test_what_cannot_be_promised_is_refused(policy: Policy, log: Dataset, aside: Dataset, tmp_path: Path):
    for arguments, error, said in (
        ({"false_alarms": 0.001}, DatasetError, "needs 999 episodes set aside, and there are 60"),
        ({"log": None}, ConfigError, "a single policy does not say"),
        ({"refferences": 3}, ConfigError, "no setting of a guard"),
        ({"members": 1}, ConfigError, "members=1"),
        ({"step": 3}, ConfigError, "choose a policy of a run"),
    ):
        with pytest.raises(error, match=said):
            guard(policy, aside, **({"log": log, "false_alarms": 0.05, **TINY, **arguments}))
    with pytest.raises(DatasetError, match="learned from 5 of the 60 episodes set aside, such as episode 0"):
        mixed = [log.episode(index) for index in range(5)]
        rows = np.concatenate([np.arange(part.start, part.stop) for part in mixed])
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(log, name)[rows], getattr(aside, name)[60:]])
            for name in ("observations", "actions", "rewards", "next_observations", "terminated", "truncated")
        }
        guard(policy, Dataset.from_arrays(**columns, action_bounds=(-1.0, 1.0)), log=log, **TINY)
    other = dataclasses.replace(policy, observation_names=("a", "b", "c"))
    with pytest.raises(DatasetError, match="the policy has a, b, c"):
        guard(other, aside, log=log, **TINY)
    wider = dataclasses.replace(policy, action_high=(2.0, 2.0))
    with pytest.raises(DatasetError, match="bounds are"):
        guard(wider, aside, log=log, **TINY)


def test_one_long_recording_is_cut_into_episodes_and_that_is_said(policy: Policy, log: Dataset):
    long = linear_dataset(episodes=1, length=400, seed=5, noise=0.05)
    with pytest.raises(DatasetError, match="there are 1, .*episode_steps="):
        guard(policy, long, log=log, false_alarms=0.05, **TINY)
    made = guard(policy, long, log=log, false_alarms=0.05, episode_steps=20, **TINY)
    assert (made.calibration.episodes, made.calibration.episode_steps) == (20, 20)
    assert "pieces of 20 rows" in str(made) and "an episode is 20 rows of a recording" in str(made)


def test_a_column_that_never_varied_is_in_range_until_it_moves(policy: Policy, log: Dataset, aside: Dataset):
    def stuck(dataset: Dataset) -> Dataset:
        names = ("observations", "next_observations")
        columns = {name: getattr(dataset, name).copy() for name in names}
        for column in columns.values():
            column[:, 2] = 7.0
        return dataclasses.replace(dataset, **columns)

    fixed = dataclasses.replace(policy, normaliser=Normaliser.fit(stuck(log).observations))
    made = guard(fixed, stuck(aside), log=stuck(log), false_alarms=0.05, **TINY)
    reading = stuck(aside).observations[0].copy()
    assert not made.act(made.begin(), reading)[1].alarm[0]
    reading[2] = 7.5
    _, carry = made.act(made.begin(), reading)
    assert made.said(carry)[0].startswith("range") and "observation_2" in made.said(carry)[0]


def test_the_log_is_asked_for_what_it_knows(made: GuardedPolicy, log: Dataset):
    why = Explainer(made, log).ask(log.observations[17], log.actions[17], 3)
    assert why.neighbours[0].row == 17 and why.neighbours[0].distance == pytest.approx(0.0, abs=1e-5)
    assert [each.distance for each in why.neighbours] == sorted(each.distance for each in why.neighbours)
    text = str(why)
    assert text.startswith("no alarm") and "asked" in text and "rest of episode" in text
    far = Explainer(made, log).ask(log.observations[17] + np.array([0.0, 99.0, 0.0]))
    assert str(far).startswith("an alarm") and far.column == "observation_1"
    with pytest.raises(DatasetError, match="give 2 finite numbers"):
        Explainer(made, log).ask(log.observations[17], np.array([np.nan, 0.0]))


def test_a_policy_on_readings_is_guarded_on_what_it_computes_of_them(tmp_path: Path):
    def table(seed: int, episodes: int = 40) -> Dataset:
        rng = np.random.default_rng(seed)
        level = rng.normal(size=(episodes, 12)).cumsum(axis=1)
        columns = {
            "level": level.ravel(),
            "valve": rng.uniform(-1, 1, episodes * 12),
            "shift": np.repeat(np.arange(episodes), 12),
            "profit": rng.normal(size=episodes * 12),
        }
        return Dataset.from_dataframe(
            columns,
            observations=["level"],
            actions=["valve"],
            reward="profit",
            episode="shift",
            action_bounds={"valve": (-1.0, 1.0)},
            lags=1,
        )

    log, aside = table(0), table(1)
    log.save(tmp_path / "log.h5")
    run = untrained_run(
        tmp_path / "run", BehaviourCloning(hidden_sizes=(4,)), log, seeds=(0,), data=tmp_path / "log.h5"
    )
    made = guard(run, aside, false_alarms=0.1, reaction="hold", **TINY)
    carry = made.begin()
    action, carry = made.act(carry, np.array([0.1]))
    assert np.isnan(action).all() and not carry.alarm[0]  # it has no history yet: somebody else acts
    carry = made.acted(carry, np.array([0.2]))
    first, carry = made.act(carry, np.array([0.2]))
    assert np.isfinite(first).all() and not carry.alarm[0]
    held, carry = made.act(carry, np.array([np.nan]))
    assert carry.alarm[0] and "reading 'level'" in made.said(carry)[0]
    np.testing.assert_array_equal(held, first)
    action, carry = made.act(carry, np.array([0.3]))
    assert np.isfinite(action).all() and np.isfinite(carry.score[0])
