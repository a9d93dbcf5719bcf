"""Online training: what is kept of a run, exact resume, and that a run learns something."""

import dataclasses
import json
import shutil

import jax.numpy as jnp
import numpy as np
import pytest

from odaf.behaviour import online
from odaf.behaviour.exact_replay import exact_replay
from odaf.behaviour.export import _nearest, export
from odaf.behaviour.locomotion_task import Played, play
from odaf.behaviour.online import OnlineRun, load_policy, train
from odaf.behaviour.replay import Replay, unpack
from odaf.environments.contact_margins import installed_rule, installed_version, recorded
from odaf.environments.locomotion import TASKS, Simulator
from odaf.environments.locomotion_acceptance import PUBLISHED
from odaf.environments.reference_returns import REFERENCES
from odaf.environments.shipped_policies import unpack_policies
from odaf.errors import ConfigError

TINY = OnlineRun(
    "hopper",
    steps=120,
    random_steps=40,
    batch_size=8,
    stretch=20,
    evaluate_every=40,
    episodes=2,
    snapshot_every=20,
    checkpoint_every=40,
)


@pytest.fixture(scope="module", autouse=True)
def small_networks():
    """Learners of a few units, so that a run takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        whole = OnlineRun.algorithm
        patch.setattr(OnlineRun, "algorithm", lambda run: dataclasses.replace(whole(run), hidden_sizes=(8, 8)))
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run that was never stopped."""
    directory = tmp_path_factory.mktemp("behaviour") / "unbroken"
    train(TINY, directory)
    return directory


def curve_of(directory):
    lines = [json.loads(line) for line in (directory / "curve.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def test_a_run_keeps_its_curve_snapshots_replay_and_one_checkpoint(finished):
    curve = curve_of(finished)
    assert [line["step"] for line in curve] == [80, 120]
    line = curve[0]
    assert line["environment"] == "Hopper-v4" and line["episodes"] == 2
    assert line["normalised_score"] == pytest.approx(100 * (line["mean_return"] + 20.272305) / 3254.572305)
    assert [path.name for path in sorted((finished / "snapshots").iterdir())] == [
        f"{step:08d}.npz" for step in (60, 80, 100, 120)
    ]
    assert [path.name for path in (finished / "checkpoints").iterdir()] == ["00000120"]


def test_the_replay_holds_every_step_in_order(finished):
    columns = Replay(finished / "replay.npy", TASKS["hopper"], 120).columns(120)
    ends = columns["terminated"] | columns["truncated"]
    inner = np.flatnonzero(~ends[:-1])
    np.testing.assert_array_equal(columns["next_observations"][inner], columns["observations"][inner + 1])
    assert columns["terminated"].sum() >= 2, "uniform actions make a hopper fall"
    np.testing.assert_allclose(columns["qpos"][:, 1:], columns["observations"][:, :5], atol=1e-6)
    np.testing.assert_allclose(np.clip(columns["qvel"], -10, 10), columns["observations"][:, 5:], atol=1e-6)


@pytest.mark.parametrize("stopped_at", [80, 100])
def test_a_stopped_run_goes_on_as_if_it_had_not_been_stopped(finished, tmp_path, monkeypatch, stopped_at):
    """Killed right after step 80 was kept, or at step 100, when step 80 was the last that was."""
    directory = tmp_path / "broken"
    play = online._play

    def dying(*arguments):
        if arguments[-1].step == stopped_at:
            raise KeyboardInterrupt
        play(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(online, "_play", dying)
        train(TINY, directory)
    train(TINY, directory)
    assert curve_of(directory) == curve_of(finished)
    np.testing.assert_array_equal(np.load(directory / "replay.npy"), np.load(finished / "replay.npy"))
    for snapshot in (finished / "snapshots").iterdir():
        ours, theirs = load_policy(snapshot), load_policy(directory / "snapshots" / snapshot.name)
        for first, second in zip(ours.weights, theirs.weights, strict=True):
            np.testing.assert_array_equal(first, second)


def test_a_run_can_be_ended_by_its_curve(tmp_path):
    train(TINY, tmp_path / "run", stop=lambda line: line["step"] == 80)
    assert [line["step"] for line in curve_of(tmp_path / "run")] == [80]
    assert [path.name for path in (tmp_path / "run" / "checkpoints").iterdir()] == ["00000080"]


def test_a_run_can_be_made_longer_and_not_shorter(finished, tmp_path):
    train(dataclasses.replace(TINY, steps=80), tmp_path)
    with pytest.raises(ConfigError, match="80 steps, and 60 were asked for"):
        train(dataclasses.replace(TINY, steps=60), tmp_path)
    train(TINY, tmp_path)
    assert curve_of(tmp_path) == curve_of(finished)
    np.testing.assert_array_equal(np.load(tmp_path / "replay.npy"), np.load(finished / "replay.npy"))
    assert online.run_in(tmp_path) == TINY


def test_a_directory_belongs_to_one_run(finished):
    with pytest.raises(ConfigError, match=r"other settings \(seed 0\); name another"):
        train(dataclasses.replace(TINY, seed=5), finished)


def test_a_run_counts_contact_margins_by_its_rule_and_says_so(finished, tmp_path, monkeypatch):
    """In its steps, its evaluations, its settings, the policies' page and the set that is its replay."""
    old = "added" if installed_rule() == "larger" else "larger"
    run = dataclasses.replace(TINY, steps=80, contact_margins=old)
    train(run, tmp_path / "run")
    assert not np.array_equal(np.load(tmp_path / "run" / "replay.npy"), np.load(finished / "replay.npy")[:80])
    assert curve_of(tmp_path / "run")[0]["mean_return"] != curve_of(finished)[0]["mean_return"]
    assert online.run_in(tmp_path / "run").contact_margins == old
    with pytest.raises(ConfigError, match=f"other settings .contact_margins '{old}'."):
        train(dataclasses.replace(run, contact_margins=None), tmp_path / "run")

    monkeypatch.setattr("odaf.behaviour.export.CLOSE_LOOK", 2)
    monkeypatch.setattr("odaf.behaviour.export.FIRST_LOOK", 1)
    facts = export(tmp_path / "run", tmp_path / "policies", tmp_path / "ledger")
    assert facts["training"]["command"].endswith(f" --contact-margins {old}")

    monkeypatch.setitem(PUBLISHED, "hopper-medium", (-1e6, 0.0))
    dataset = exact_replay("hopper-medium-replay", tmp_path / "run")
    assert recorded(dataset.provenance) == {"mujoco": installed_version(), "contact_margins": old}
    assert dataset.environment is not None and dataset.environment["contact_margins"] == old
    with pytest.raises(ConfigError, match=f"contact margins '{old}', not '{installed_rule()}'"):
        exact_replay("hopper-medium-replay", tmp_path / "run", contact_margins=installed_rule())


def test_a_run_of_before_there_were_rules_goes_on(finished, tmp_path):
    path = shutil.copytree(finished, tmp_path / "run") / "config.json"
    config = json.loads(path.read_text())
    del config["run"]["contact_margins"]
    path.write_text(json.dumps(config))
    with pytest.raises(ConfigError, match="other settings .contact_margins None."):
        train(dataclasses.replace(TINY, contact_margins="larger"), tmp_path / "run")
    train(TINY, tmp_path / "run")
    assert json.loads(path.read_text())["run"]["contact_margins"] is None


def test_settings_that_do_not_fit_the_stretches_are_named():
    with pytest.raises(ConfigError, match="snapshot_every=30.*stretch=20"):
        dataclasses.replace(TINY, snapshot_every=30)


def test_packed_rows_unpack_into_the_learners_columns(tmp_path):
    replay = Replay(tmp_path / "replay.npy", TASKS["hopper"], 3)
    rng = np.random.default_rng(0)
    rows = [(rng.normal(size=11), rng.normal(size=3), i + 0.5, rng.normal(size=11), i == 1, i == 2) for i in range(3)]
    for index, row in enumerate(rows):
        replay.write(index, *row, rng.normal(size=12))
    batch = unpack(jnp.asarray(replay.draw(np.array([2, 0, 1, 1]))), 11, 3)
    for place, index in enumerate((2, 0, 1, 1)):
        observation, action, reward, successor, terminated, _ = rows[index]
        np.testing.assert_allclose(batch.observations[place], observation, rtol=1e-6)
        np.testing.assert_allclose(batch.actions[place], action, rtol=1e-6)
        np.testing.assert_allclose(batch.next_observations[place], successor, rtol=1e-6)
        assert (float(batch.rewards[place]), float(batch.terminated[place])) == (reward, float(terminated))
    assert replay.columns(3)["truncated"].tolist() == [False, False, True]
    with pytest.raises(ValueError, match="remove the folder"):
        Replay(tmp_path / "replay.npy", TASKS["hopper"], 2)


def test_returns_of_a_policy_end_with_its_episodes(finished):
    policy = load_policy(finished / "snapshots" / "00000120.npz")
    bodies = [Simulator(TASKS["hopper"]) for _ in range(2)]
    played = play(policy, bodies, seed=1)
    both, again = played.returns, play(policy, bodies, seed=1).returns
    np.testing.assert_array_equal(both, again)
    rng = np.random.default_rng(1)
    observation, total = bodies[0].reset(int(rng.integers(2**31))), 0.0
    for _ in range(1000):
        observation, reward, terminated = bodies[0].step(policy.mode(observation))
        total += reward
        if terminated:
            break
    assert both[0] == pytest.approx(total, rel=1e-5)


def test_export_ships_the_nearest_snapshot_and_says_that_it_is_not_good_enough(finished, tmp_path, monkeypatch):
    monkeypatch.setattr("odaf.behaviour.export.CLOSE_LOOK", 2)
    monkeypatch.setattr("odaf.behaviour.export.FIRST_LOOK", 1)
    facts = export(finished, tmp_path / "policies", tmp_path / "ledger")
    assert facts["medium"] is None and facts["replay"] == []
    assert facts["expert"]["reached"] is False and facts["expert"]["normalised_score"] < 20
    assert facts["steps"][facts["expert"]["index"]] == facts["expert"]["step"]
    ledger = json.loads((tmp_path / "ledger" / "hopper-seed0.json").read_text())
    assert [line["step"] for line in ledger["curve"]] == [80, 120] and ledger["steps_made"] == 120
    assert str(tmp_path) not in json.dumps(ledger)
    with np.load(tmp_path / "policies" / "hopper.npz", allow_pickle=False) as arrays:
        assert arrays["weight_0"].dtype == np.float16
    with pytest.raises(ConfigError, match="no training run"):
        export(tmp_path, tmp_path / "policies", tmp_path / "ledger")


def test_export_of_a_run_that_reached_its_levels(finished, tmp_path, monkeypatch):
    """Returns are made up so that snapshot 80 is a medium policy and 120 an expert one, with somewhat less noise."""
    scores = {60: 10.0, 80: 45.0, 100: 70.0, 120: 104.0}
    marks = {
        float(load_policy(path).weights[0][0, 0].astype(np.float16)): int(path.stem)
        for path in (finished / "snapshots").iterdir()
    }

    def played(policy, simulators, seed, stochastic):
        score = scores[marks[float(policy.weights[0][0, 0])]] + 5.0 * (1.0 - policy.spread) / 0.15
        returns = np.full(len(simulators), -20.272305 + score / 100 * 3254.572305)
        return Played(returns, np.full(len(simulators), 500), 0.002 if score < 60 else 0.0)

    monkeypatch.setattr("odaf.behaviour.export.play", played)
    facts = export(finished, tmp_path / "policies", tmp_path / "ledger")
    assert (facts["medium"]["step"], facts["medium"]["spread"]) == (80, 1.0)
    assert (facts["expert"]["step"], facts["expert"]["spread"], facts["expert"]["reached"]) == (120, 0.85, True)
    assert [phase["steps"] for phase in facts["replay"]] == [40, 20, 20]
    assert [phase["index"] for phase in facts["replay"]] == [None, 0, 0]
    assert facts["steps"] == [60, 80, 120]

    before = shutil.copytree(tmp_path / "policies", tmp_path / "before")
    scores[100], scores[120] = 109.0, 60.0  # as if this were another run
    with pytest.raises(ConfigError, match=r"hopper.json: nothing is there to add an expert to"):
        export(finished, tmp_path / "empty", tmp_path / "ledger", expert_only=True)
    facts = export(finished, tmp_path / "policies", tmp_path / "other", expert_only=True)
    assert (facts["expert"]["step"], facts["medium"]["step"], facts["steps"]) == (100, 80, [60, 80, 100])
    record = json.loads((tmp_path / "other" / "hopper-seed0.json").read_text())
    assert record["medium"] is None and record["expert"]["step"] == 100
    old, new = (_policies_in(folder) for folder in (before, tmp_path / "policies"))
    assert old.medium is not None and new.medium is not None and old.expert is not None and new.expert is not None
    np.testing.assert_array_equal(new.medium.weights[0], old.medium.weights[0])
    assert len(new.replay) == len(old.replay) and np.any(new.expert.weights[0] != old.expert.weights[0])


def _policies_in(folder):
    with np.load(folder / "hopper.npz", allow_pickle=False) as arrays:
        return unpack_policies(dict(arrays), json.loads((folder / "hopper.json").read_text()))


@pytest.mark.parametrize(
    ("falls", "spreads", "step"),
    [
        ((0.0, 0.1), (0.0, 1e9), 80),
        ((0.01, 0.1), (0.0, 1e9), 100),
        ((0.2, 0.3), (0.0, 1e9), 80),
        ((0.0, 0.1), (100.0, 400.0), 100),
        ((0.0, 0.1), (0.0, 100.0), 80),
        ((0.0, 0.1), (400.0, 900.0), 80),
    ],
)
def test_of_two_near_snapshots_the_one_that_falls_and_varies_as_much_is_taken(
    finished, monkeypatch, falls, spreads, step
):
    """Snapshot 80 scores 44.3 every time and never falls, snapshot 100 scores 45.8 on average, with returns that have a
    standard deviation of 200, and falls in one row of fifty."""
    made_up = {80: (44.3, 0.0, 0.0), 100: (45.8, 200.0, 0.02)}
    policies = {step: load_policy(finished / "snapshots" / f"{step:08d}.npz") for step in made_up}
    marks = {float(policy.weights[0][0, 0]): step for step, policy in policies.items()}

    def played(policy, simulators, seed, stochastic):
        score, std, share = made_up[marks[float(policy.weights[0][0, 0])]]
        mean = -20.272305 + score / 100 * 3254.572305
        return Played(mean + std * np.array([-1.0, 1.0]), np.full(2, 500), share)

    monkeypatch.setattr("odaf.behaviour.export.play", played)
    level = _nearest(policies, [], REFERENCES[TASKS["hopper"].family], 44.32, falls, spreads)
    assert level.step == step


def test_the_exact_replay_is_the_buffer_up_to_the_medium_point(finished, monkeypatch):
    """With the medium level moved to the score of step 120, the set is everything until then; step 80 scored less."""
    first, last = (line["normalised_score"] for line in curve_of(finished))
    monkeypatch.setitem(PUBLISHED, "hopper-medium", (max(first, last), 0.0))
    step = 80 if first >= last else 120
    dataset = exact_replay("hopper-medium-replay", finished)
    assert len(dataset) == step
    judged = dataset.provenance["acceptance"]["passed"] is not None
    assert judged == bool(dataset.terminated.any()), "returns can be judged once an episode has ended by itself"
    columns = Replay(finished / "replay.npy", TASKS["hopper"], 120).columns(step)
    np.testing.assert_array_equal(dataset.actions, columns["actions"])
    np.testing.assert_array_equal(dataset.terminated, columns["terminated"])
    assert set(dataset.infos) == {"qpos", "qvel"}
    with pytest.raises(ConfigError, match="only medium-replay"):
        exact_replay("hopper-medium", finished)
    with pytest.raises(ConfigError, match="holds a run of hopper, v4"):
        exact_replay("hopper-medium-replay", finished, version="v5")
    monkeypatch.setitem(PUBLISHED, "hopper-medium", (1e6, 0.0))
    with pytest.raises(ConfigError, match="120 steps did not reach"):
        exact_replay("hopper-medium-replay", finished)
