"""An assessment: how answers become a verdict, what the page shows, and what happened afterwards."""

import dataclasses
import json
import math
from pathlib import Path

import jax
import numpy as np
import pytest

from golden.tiny import linear_dataset
from odaf.assessment import Assessment, Kept, aftermath, assess
from odaf.assessment.actions import action_columns
from odaf.assessment.after import beside, drifts
from odaf.assessment.page import build
from odaf.assessment.verdict import verdict_of
from odaf.components.policies import init_deterministic_actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError
from odaf.estimation import EstimateSettings, Interval, ValueEstimate
from odaf.training.policy import Policy

TINY = EstimateSettings(members=2, hidden_sizes=(4,), steps=2, batch_size=8, resamples=20)
SOUND = linear_dataset(episodes=4, length=10, seed=5).check()
LOGGED = Interval(0.1, 0.05, 0.2)
BROKEN_MORE = Kept("x < 1", 100, 10, LOGGED, Interval(0.5, 0.3, 0.9), "")
BROKEN_ALIKE = Kept("y < 1", 100, 10, LOGGED, Interval(0.2, 0.1, 0.3), "")


def estimate_of(verdict: str, reason: str = "") -> ValueEstimate:
    one = Interval(1.0, 0.0, 2.0)
    return ValueEstimate("fqe", one, one, one, verdict, reason)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "kept", "verdict", "reason"),
    [
        ("better", (BROKEN_ALIKE,), "better", "surely earns more"),
        ("better", (BROKEN_ALIKE, BROKEN_MORE), "worse", "'x < 1' surely more often"),
        ("worse", (), "worse", "surely earns less"),
        ("not decided", (BROKEN_ALIKE,), "not decided", "holds zero"),
        ("refused", (), "refused", "too thin"),
    ],
)
def test_a_verdict_is_worse_for_any_sure_loss_and_better_only_without_one(value, kept, verdict, reason):
    found, reasons = verdict_of(estimate_of(value, "the overlap is too thin"), kept, SOUND)
    assert found == verdict and reason in "; ".join(reasons)


def test_a_log_with_errors_is_refused_whatever_it_promises():
    finding = dataclasses.replace(SOUND.findings[0], severity="error") if SOUND.findings else None
    assert finding is not None
    found, reasons = verdict_of(estimate_of("better"), (), dataclasses.replace(SOUND, findings=(finding,)))
    assert found == "refused" and finding.message in reasons[0]


def test_actions_are_laid_beside_the_logged_ones_without_steps_across_episodes():
    log = Dataset.from_arrays(
        np.zeros((4, 1)),
        np.array([0.0, 0.2, 0.9, 0.8])[:, None],
        np.zeros(4),
        next_observations=np.zeros((4, 1)),
        truncated=np.array([False, True, False, True]),
        action_bounds=(-1.0, 1.0),
    )
    (column,) = action_columns(log, np.array([-0.5, 0.5, 0.5, 0.4], np.float32)[:, None])
    assert column.outside == 0.25  # -0.5 lies below 0
    assert column.logged_change[2] == pytest.approx(0.2) and column.policy_change[2] == pytest.approx(1.0)
    assert column.jumps == 0.5  # 1.0 and 0.1, above 0.2


@pytest.fixture(scope="module")
def found() -> Assessment:
    log, aside = (linear_dataset(episodes=30, length=12, seed=seed, noise=0.05) for seed in (0, 1))
    actor = init_deterministic_actor(jax.random.key(3), 3, 2, (4,))
    names = log.observation_names, log.action_names
    policy = Policy(actor, Normaliser.fit(log.observations), (-1.0, -1.0), (1.0, 1.0), *names)
    keep = [f"{log.observation_names[0]} < 1.5"]
    changes = {"steps": 2, "hidden_sizes": (4,), "references": 50, "members": 2}
    return assess(policy, aside, keep=keep, log=log, settings=TINY, guard_changes=changes)


def test_a_hold_out_too_small_for_the_rate_promises_what_it_can(found: Assessment):
    assert found.guard is not None and found.guard.calibration.promised == pytest.approx(1 / 31)
    assert found.over_time is not None and len(found.over_time[0]) == 12 and found.over_time[0].max() <= 1.0


def test_page_and_json_hold_the_verdict_and_need_no_network(found: Assessment, tmp_path: Path):
    page = build(found, tmp_path / "assess.html", "valve <1>").read_text()
    assert (
        "valve &lt;1&gt;" in page
        and found.verdict.capitalize() in page
        and "http" not in page.replace("www.w3.org", "")
    )
    assert page.count("<svg") >= 5
    record = json.loads(json.dumps(found.to_dict()))
    assert record["verdict"] == found.verdict and record["keep"][0]["episodes"] == 30
    assert record["guard"]["calibration"]["episodes"] == 30 and len(record["actions"]) == 2
    with pytest.raises(ConfigError, match="is a folder"):
        build(found, tmp_path, "valve")


def test_afterwards_the_promise_stands_beside_what_happened(found: Assessment, tmp_path: Path):
    aside = found.holdout
    shift = np.array([30.0, 0.0, 0.0], np.float32) * aside.observations.std(axis=0)
    moved = dataclasses.replace(
        aside,
        observations=aside.observations + shift,
        next_observations=aside.next_observations + shift,
        actions=found.own,
        source="new",
    )
    after = aftermath(found, moved)
    assert after.own < 1.0 and after.episodes == 30  # the policy sees other states than those it was asked in
    assert [each.moved for each in after.drift] == [True, False, False]
    assert after.drift[0].shift.value == pytest.approx(30.0, abs=1e-2)
    beyond = np.concatenate([moved.observations[:, :1], moved.next_observations[:, :1]], axis=1).max(axis=1) >= 1.5
    assert after.kept[0].broken == np.logical_or.reduceat(beyond, moved.episode_starts).sum() > 20
    assert after.alarms is not None and after.alarms > 20
    assert aftermath(found, aside).drift[0].shift.value == 0.0
    page = build(found, tmp_path / "after.html", "valve", after).read_text()
    assert "Promised, and happened" in page and json.dumps(after.to_dict())
    other = Dataset.from_arrays(
        np.zeros((4, 1)), np.zeros((4, 1)), np.zeros(4), truncated=np.array([0, 1, 0, 1], bool), action_bounds=(-1, 1)
    )
    with pytest.raises(DatasetError, match="has the columns"):
        aftermath(found, other)


def test_a_refused_estimate_promises_nothing(found: Assessment):
    estimates = tuple(dataclasses.replace(each, verdict="refused") for each in found.valuation.estimates)
    refused = dataclasses.replace(found, valuation=dataclasses.replace(found.valuation, estimates=estimates))
    assert refused.decisive.value is not None and refused.promised is None
    assert aftermath(refused, found.holdout).beside == "nothing was promised"
    assert "value of an episode: refused" in str(refused)


def test_a_condition_that_every_episode_broke_shows_no_way_to_keep_it(found: Assessment):
    names = found.holdout.observation_names
    changes = {"steps": 1, "hidden_sizes": (4,), "references": 10, "members": 2}
    again = assess(found.policy, found.holdout, keep=[f"{names[0]} < -99"], settings=TINY, guard_changes=changes)
    assert "every logged episode broke it, so that nothing shows how it is kept" in again.kept[0].reason
    assert again.guard is None and "does not say where the data are" in again.no_guard


def test_promises_are_kept_where_intervals_meet():
    happened = Interval(5.0, 4.0, 6.0)
    assert beside(Interval(3.0, 2.0, 4.0), happened) == "as promised"
    assert beside(Interval(8.0, 6.1, 9.0), happened) == "less than promised"
    assert beside(Interval(1.0, 0.0, 3.9), happened) == "more than promised"
    assert beside(None, happened) == beside(Interval(1.0, math.nan, math.nan), happened) == "nothing was promised"


def test_the_interval_of_a_drift_covers_a_shift_that_is_none():
    logs = [linear_dataset(episodes=40, length=12, seed=seed) for seed in (0, 1)]
    for drift in drifts(logs[0], logs[1], 0.95, np.random.default_rng(0)):
        assert drift.shift.low < drift.shift.value < drift.shift.high and not drift.moved
