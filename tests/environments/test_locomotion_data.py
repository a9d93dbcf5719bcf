"""Recorded locomotion sets: their rows, their ends, their names, and that acceptance notices a wrong policy."""

import json

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.environments import recorder
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.locomotion import TASKS, Simulator
from odaf.environments.locomotion_acceptance import (
    PUBLISHED,
    acceptance_of,
    findings_of,
    statistics_of,
    widest_spread,
)
from odaf.environments.locomotion_data import NAMES, generate, shares
from odaf.environments.shipped_policies import (
    Phase,
    ShippedPolicies,
    facts_of_edition,
    pack_policies,
    shipped,
    unpack_policies,
)
from odaf.errors import ConfigError
from odaf.studies.logs import policies_print
from odaf.training.files import write_arrays


def policy_of(task_name: str, seed: int = 0) -> GaussianPolicy:
    """A small random policy of a task."""
    rng, task = np.random.default_rng(seed), TASKS[task_name]
    sizes = [(task.obs_dim, 8), (8, 2 * task.act_dim)]
    weights = [0.3 * rng.normal(size=size).astype(np.float32) for size in sizes]
    return GaussianPolicy(weights, [np.zeros(size[1], np.float32) for size in sizes])


def policies_of(task_name: str) -> ShippedPolicies:
    """Policies of all levels, none of which is any good."""
    one, two = policy_of(task_name, 1), policy_of(task_name, 2)
    return ShippedPolicies(one, two, (Phase(100, None), Phase(200, one), Phase(100, two)), {"training": {"seed": 1}})


@pytest.mark.parametrize("name", ["hopper-random", "hopper-medium-replay", "walker2d-medium-expert"])
def test_rows_are_exact_in_bounds_and_follow_one_another(name):
    dataset = generate(name, 333, seed=0, policies=policies_of(name.split("-")[0]))
    assert len(dataset) == 333 and np.abs(dataset.actions).max() <= 1.0
    last = np.cumsum(dataset.episode_lengths()) - 1
    inner = np.setdiff1d(np.arange(333), last)
    np.testing.assert_array_equal(dataset.next_observations[inner], dataset.observations[inner + 1])
    np.testing.assert_array_equal(dataset.terminated[last] ^ dataset.truncated[last], True)
    assert dataset.terminated.sum() > 5, "random bodies fall"
    assert dataset.provenance["origin"] == "locally generated data"
    assert dataset.environment == {"name": "gymnasium", "id": f"{TASKS[name.split('-')[0]].family}-v4", "kwargs": {}}


def test_the_stored_bodies_give_the_stored_rows_back():
    """Set the simulator from qpos and qvel, play the action: reward and successor of the row."""
    dataset = generate("hopper-random", 60, seed=3)
    simulator = Simulator(TASKS["hopper"])
    simulator.reset(0)
    environment = simulator._environment
    for row in range(0, 60, 7):
        environment.set_state(dataset.infos["qpos"][row], dataset.infos["qvel"][row])
        np.testing.assert_allclose(environment._get_obs(), dataset.observations[row], atol=1e-6)
        observation, reward, terminated = simulator.step(dataset.actions[row])
        np.testing.assert_allclose(observation, dataset.next_observations[row], atol=1e-4)
        assert reward == pytest.approx(dataset.rewards[row], abs=1e-4)
        assert terminated == dataset.terminated[row] or dataset.truncated[row]
    np.testing.assert_allclose(dataset.infos["action_log_probs"], -3 * np.log(2.0), rtol=1e-6)


def test_a_body_that_does_not_fall_is_cut_after_a_thousand_steps_and_the_record_where_it_ends():
    dataset = generate("halfcheetah-random", 2100, seed=0)
    assert dataset.episode_lengths().tolist() == [1000, 1000, 100]
    assert not dataset.terminated.any()
    statistics = dataset.provenance["statistics"]
    assert (statistics["episodes"], statistics["whole_episodes"]) == (3, 2)
    returns = dataset.episode_returns()[:2]
    assert statistics["mean"] == pytest.approx(returns.mean(), rel=1e-5)
    assert statistics["normalised_mean"] == pytest.approx(100 * (returns.mean() + 280.178953) / 12415.178953, rel=1e-4)


def test_a_fall_at_the_thousandth_step_counts_as_the_time_limit():
    class Falling(Simulator):
        """Stands still and falls at a chosen step."""

        def __init__(self, fall: int):
            super().__init__(TASKS["hopper"])
            self.fall, self.count = fall, 0

        def reset(self, seed):
            self.count = 0
            return super().reset(seed)

        def step(self, action):
            self.count += 1
            return np.zeros(11), 1.0, self.count == self.fall

    for fall, terminated in ((1000, False), (999, True)):
        columns = recorder.record([Falling(fall)], None, 999 if terminated else 1000, np.random.default_rng(0))
        assert (bool(columns["terminated"][-1]), bool(columns["truncated"][-1])) == (terminated, not terminated)


def test_short_episodes_are_not_over_counted(monkeypatch):
    """Episodes alternate between 2 and 50 steps; side by side, the short ones end first, but both kinds must be as
    frequent in the record as they were begun."""
    monkeypatch.setattr(recorder, "STEPS_A_SLOT", 50)
    begun = []

    class Alternating(Simulator):
        def reset(self, seed):
            self.length, self.count = (2, 50)[len(begun) % 2], 0
            begun.append(self.length)
            return super().reset(seed)

        def step(self, action):
            self.count += 1
            return np.zeros(11), 1.0, self.count == self.length

    bodies = [Alternating(TASKS["hopper"]) for _ in range(recorder.slots_for(500))]
    assert len(bodies) == 10
    columns = recorder.record(bodies, None, 500, np.random.default_rng(0))
    ends = np.flatnonzero(columns["terminated"] | columns["truncated"])
    lengths = np.diff(np.concatenate([[-1], ends]))
    assert lengths.sum() == 500 and lengths[:-1].tolist() == begun[: len(lengths) - 1]


def test_an_episode_that_is_cut_did_not_fall(monkeypatch):
    """Episodes of 50 and of 2 steps begin together, both fall; a record of 51 rows stops one row before the second
    fall, which therefore is not in it."""
    monkeypatch.setattr(recorder, "STEPS_A_SLOT", 25)
    begun = []

    class Alternating(Simulator):
        def reset(self, seed):
            self.length, self.count = (50, 2)[len(begun) % 2], 0
            begun.append(self.length)
            return super().reset(seed)

        def step(self, action):
            self.count += 1
            return np.zeros(11), 1.0, self.count == self.length

    columns = recorder.record([Alternating(TASKS["hopper"]) for _ in range(2)], None, 51, np.random.default_rng(0))
    assert np.flatnonzero(columns["terminated"]).tolist() == [49]
    assert np.flatnonzero(columns["truncated"]).tolist() == [50]


def test_one_seed_gives_the_same_bits_and_another_does_not(tmp_path):
    policies = policies_of("hopper")
    first, again, other = (generate("hopper-medium-replay", 400, seed, policies=policies) for seed in (3, 3, 4))
    assert first.fingerprint() == again.fingerprint()
    assert (first.actions != other.actions).any(), "the fingerprint covers the seed's number too, so look at the rows"
    first.save(tmp_path / "set.h5")
    loaded = Dataset.load(tmp_path / "set.h5")
    assert loaded.fingerprint() == first.fingerprint()
    np.testing.assert_array_equal(loaded.infos["qpos"], first.infos["qpos"])
    assert loaded.provenance["acceptance"] == first.provenance["acceptance"]


def test_acceptance_notices_a_policy_of_another_level():
    """A policy that falls over is no medium policy; uniform actions are what `random` promises."""
    wrong = generate("hopper-medium", 600, seed=0, policies=policies_of("hopper")).provenance
    assert wrong["acceptance"]["passed"] is False
    assert "normalised_mean" in {check["figure"] for check in wrong["acceptance"]["checks"] if not check["passed"]}
    assert wrong["findings"] and "published set" in wrong["findings"][0]["message"]
    right = generate("hopper-random", 4000, seed=0).provenance
    assert right["acceptance"]["passed"] is True and right["findings"] == []


EPISODES = {"normalised_error": 0.3, "far_below": 1, "whole_episodes": 100}


def test_each_half_of_medium_expert_is_judged_on_its_own():
    """Halves whose mean is right together but wrong one by one are not accepted."""
    low, high = (
        {"normalised_mean": score, "std": 300.0, "terminal_row_share": 0.0, "largest_action": 1.0} | EPISODES
        for score in (20.0, 109.0)
    )
    judged = acceptance_of(TASKS["halfcheetah"], "medium-expert", {"medium": low, "expert": high})
    assert [check["figure"] for check in judged["checks"] if not check["passed"]] == [
        "medium/normalised_mean",
        "expert/normalised_mean",
    ]
    good = [{**low, "normalised_mean": PUBLISHED[f"halfcheetah-{level}"][0]} for level in ("medium", "expert")]
    assert acceptance_of(TASKS["halfcheetah"], "medium-expert", dict(zip(("medium", "expert"), good, strict=True)))[
        "passed"
    ]


@pytest.mark.parametrize(("std", "passed"), [(0.0, True), (533.0, True), (534.0, False)])
def test_returns_may_spread_up_to_one_and_a_half_times_as_widely_as_published(std, passed):
    """The published set of halfcheetah-medium has 355.75; one and a half times that is 533.6."""
    figures = {"normalised_mean": 40.68, "std": std, "terminal_row_share": 0.0, "largest_action": 1.0} | EPISODES
    judged = acceptance_of(TASKS["halfcheetah"], "medium", {"medium": figures})
    assert judged["passed"] is passed
    assert [check["figure"] for check in judged["checks"] if not check["passed"]] == ([] if passed else ["std"])


def test_a_figure_outside_its_limits_comes_with_what_explains_it():
    """A hundred episodes: 96 earn 11,000, four 1,000. Mean 10,600, standard deviation 10,000 sqrt(0.04 * 0.96) =
    1,959.6; standard error 195.96, of 12,415.18 between random and expert 1.6 points."""
    returns = np.repeat(np.r_[np.full(96, 11.0), np.full(4, 1.0)], 1000)
    ends = np.zeros(100_000, bool)
    ends[999::1000] = True
    falls, actions = np.zeros_like(ends), np.ones((100_000, 6))
    columns = {"rewards": returns, "terminated": falls, "truncated": ends, "actions": actions}
    figures = statistics_of(columns, TASKS["halfcheetah"], "v4")
    assert figures["std"] == pytest.approx(1959.592) and figures["far_below"] == 4
    assert figures["normalised_error"] == pytest.approx(1.57838, rel=1e-5)
    (spread,) = findings_of(acceptance_of(TASKS["halfcheetah"], "expert", {"expert": figures}))
    assert spread["message"].startswith("std is 1960 (4 of 100 episodes earn 20% less than the median, or worse), the")
    mean, _ = findings_of(acceptance_of(TASKS["halfcheetah"], "medium", {"medium": figures}))
    assert mean["message"].startswith("normalised_mean is 87.64 (standard error 1.6), the")


def test_an_earlier_edition_has_the_levels_that_were_others_then():
    facts = {
        "task": "hopper",
        "medium": "c",
        "expert": "z",
        "earlier": [{"medium": "a", "expert": "y"}, {"medium": "b"}],
    }
    levels = {edition: facts_of_edition(facts, edition) for edition in (None, 1, 2, 3)}
    assert levels[None] == levels[3] == {"task": "hopper", "medium": "c", "expert": "z", "edition": 3}
    assert levels[2] == {"task": "hopper", "medium": "b", "expert": "z", "edition": 2}
    assert levels[1] == {"task": "hopper", "medium": "a", "expert": "y", "edition": 1}
    with pytest.raises(ConfigError, match="edition 4: hopper has editions 1 to 3"):
        facts_of_edition(facts, 4)


def test_the_first_edition_of_halfcheetah_plays_as_it_did():
    first, newest = shipped(TASKS["halfcheetah"], edition=1), shipped(TASKS["halfcheetah"])
    assert (first.facts["medium"]["step"], first.facts["medium"]["spread"]) == (140_000, 1.0)
    assert newest.facts["medium"]["step"] != 140_000
    assert (
        newest.facts["medium"]["std_return"] < widest_spread("halfcheetah-medium") < first.facts["medium"]["std_return"]
    )
    before = policies_print("halfcheetah-medium", 1)
    assert before is not None and before.startswith("1201d4e4")  # as records name it that were made before the second
    assert policies_print("halfcheetah-medium") != policies_print("halfcheetah-medium", 1)
    assert policies_print("hopper-medium", 1) == policies_print("hopper-medium")


@pytest.mark.parametrize(
    ("kind", "players"),
    [
        ("random", None),
        ("medium", {"medium"}),
        ("expert", {"expert"}),
        ("medium-replay", {"replay"}),
        ("medium-expert", {"medium", "expert"}),
    ],
)
def test_a_set_says_who_played_and_of_which_edition_they_are(kind, players):
    sets = {edition: generate(f"halfcheetah-{kind}", 40, edition=edition) for edition in (None, 1)}
    told = {edition: dataset.provenance["policies"] for edition, dataset in sets.items()}
    if players is None:
        assert told == {None: {}, 1: {}}
        return
    assert [told[edition]["edition"] for edition in (None, 1)] == [2, 1]
    for edition, each in told.items():
        facts = shipped(TASKS["halfcheetah"], edition).facts
        assert each == {name: facts[name] for name in {"edition", "training", *players}}
    assert ("medium" in players) == (told[None].get("medium") != told[1].get("medium"))


def test_without_a_whole_episode_nothing_is_claimed():
    dataset = generate("halfcheetah-random", 50)
    assert dataset.provenance["acceptance"]["passed"] is None
    assert dataset.provenance["findings"][0]["finding"] == "acceptance-unknown"


def test_a_fall_where_bodies_do_not_fall_is_a_finding():
    columns = {
        "rewards": np.ones(4, np.float32),
        "actions": np.ones((4, 6), np.float32),
        "terminated": np.array([False, True, False, True]),
        "truncated": np.zeros(4, bool),
    }
    task = TASKS["halfcheetah"]
    judged = acceptance_of(task, "random", {"random": statistics_of(columns, task, "v4")})
    assert [finding for finding in findings_of(judged) if "terminal_row_share" in finding["message"]]


def test_shares_keep_proportions_and_the_total():
    phases = [Phase(10, None), Phase(30, policy_of("hopper")), Phase(0, None), Phase(60, policy_of("hopper"))]
    assert [phase.steps for phase in shares(phases, 1000)] == [100, 300, 600]
    assert sum(phase.steps for phase in shares(phases, 997)) == 997
    assert [phase.steps for phase in shares(phases, 1)] == [1]


def test_policies_survive_packing(tmp_path):
    one, two = policy_of("hopper", 1), policy_of("hopper", 2)
    write_arrays(tmp_path / "policies.npz", pack_policies([one, two]))
    with np.load(tmp_path / "policies.npz", allow_pickle=False) as content:
        layers = {name: content[name] for name in content.files}
    facts = {
        "medium": {"index": 1, "spread": 0.5},
        "expert": None,
        "replay": [{"steps": 5, "index": None}, {"steps": 7, "index": 0}],
    }
    found = unpack_policies(layers, json.loads(json.dumps(facts)))
    assert found.expert is None and found.medium is not None and found.medium.spread == 0.5
    observations = np.random.default_rng(0).normal(size=(4, 11))
    np.testing.assert_allclose(found.medium.mode(observations), two.mode(observations), atol=5e-3)
    assert [(phase.steps, phase.policy is None) for phase in found.replay] == [(5, True), (7, False)]


def test_what_is_missing_is_explained():
    with pytest.raises(ConfigError, match="ant-medium.*not known.*hopper-medium"):
        generate("ant-medium", 10)
    with pytest.raises(ConfigError, match="transitions=0"):
        generate("hopper-random", 0)
    nothing = ShippedPolicies(policy_of("hopper"), None, (), {})
    with pytest.raises(ConfigError, match="no expert policy of hopper.*odaf behaviour train hopper"):
        generate("hopper-medium-expert", 10, policies=nothing)
    with pytest.raises(ConfigError, match="no snapshots"):
        generate("hopper-medium-replay", 10, policies=nothing)


def test_a_task_without_shipped_policies_says_how_to_make_them(monkeypatch, tmp_path):
    monkeypatch.setattr("odaf.environments.shipped_policies.files", lambda package: tmp_path)
    with pytest.raises(ConfigError, match="odaf behaviour train hopper.*odaf behaviour export"):
        shipped(TASKS["hopper"])


def test_every_name_has_published_figures():
    assert set(NAMES) == set(PUBLISHED) and len(NAMES) == 15
