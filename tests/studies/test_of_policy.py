"""Works on policies: attacked, knocked, their critics asked; their records, and their place in a plan."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from odaf.studies import attacks_table, knocks_table, validation_table
from odaf.studies.attacks import Attacking
from odaf.studies.identity import differences
from odaf.studies.job import Job, Phase
from odaf.studies.knocks import Knocking
from odaf.studies.of_policy import OfPolicy, below_log, phase_of
from odaf.studies.training import Training
from odaf.studies.validation import Validating
from odaf.training.progress import Silent
from studies.untrained import hopper, without_training

pytest.importorskip("mujoco")
DATA = {"hopper-medium": {"recipe": hopper().log.recipe(), "sha256": []}}


def measured(work: OfPolicy, place: Path) -> dict:
    record = json.loads(json.dumps(work.do(place, Silent())))
    prints = [record["policy"]["data"][kind] for kind in ("rows_sha256", "sha256") if kind in record["policy"]["data"]]
    known = {"hopper-medium": DATA["hopper-medium"] | {"sha256": prints}}
    assert differences(work.recorded(record, known), work.identity(), work.unrecorded()) == []
    other = replace(work, training=replace(work.training, seed=1))
    assert "policy.seed was 0, is 1" in differences(work.recorded(record, known), other.identity(), work.unrecorded())
    assert str(place) not in json.dumps(record)
    return record


def test_a_policy_is_attacked_knocked_and_its_critics_are_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_training(monkeypatch)
    training = hopper()
    attacked = measured(Attacking(training, "min-q", (0.0, 0.3), episodes=2), tmp_path)
    assert attacked["found"]["budgets"] == [0.0, 0.3] and len(attacked["found"]["scores"]) == 2
    mean = sum(attacked["found"]["scores"]) / 2
    assert attacked["found"]["area"] == pytest.approx(mean)
    assert below_log(attacked["found"]["scores"][0], attacked)  # an untrained policy is worse than the log
    table = attacks_table.table([attacked])
    assert "| hopper-medium | min-q | sac-n-" in table and "below its log" in table

    levels = (("none", 0), ("large", 3))
    knocked = measured(Knocking(training, 5, levels, (0.1,), episodes=2, followed=4), tmp_path)
    assert set(knocked["found"]["levels"]) == {"none", "large"} and set(knocked["found"]["starts"]) == {"0.1"}
    after = knocked["found"]["after"]
    assert after["episodes"] == 2 and 0.0 <= after["beyond"] <= 1.0 and len(after["points"][0]) == 2
    assert sum(map(sum, after["log"]["counts"])) <= 600 and "| hopper-medium | 5 |" in knocks_table.table([knocked])
    early = measured(Knocking(training, 900, levels, (), episodes=1, followed=4), tmp_path)
    assert early["found"]["after"] is None  # it has fallen by then

    asked = measured(Validating(training, states=60, model_steps=8, hidden=(4,)), tmp_path)
    found = asked["found"]
    assert set(found["dynamics"]) == {"simulator", "cvae", "deterministic"} and 0 < found["pairs"] <= 60
    assert all(0.0 <= each["auroc"] <= 1.0 for each in found["dynamics"].values())
    assert found["simulator_error"] < 0.05  # the simulator goes where the log went
    assert sum(found["dynamics"]["cvae"]["safe"]["histogram"]) == found["pairs"]
    assert "| hopper-medium | sac-n-" in validation_table.table([asked])


def test_a_policy_that_diverged_leaves_a_record_without_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_training(monkeypatch)
    from odaf.evaluation.runs import Run

    lost = {0: {"status": "diverged", "step": 2, "evaluation": None}}
    monkeypatch.setattr(Run, "summary", property(lambda self: lost))
    work = Attacking(hopper(), "random", (0.0,), episodes=1)
    record = measured(work, tmp_path)
    assert record["found"] is None and work.said(record) == "the policy diverged"
    assert attacks_table.attacked([record]) == []


def test_a_plan_trains_each_policy_once_and_measures_one_thing_at_a_time() -> None:
    training = hopper()
    works = [Attacking(training, name) for name in ("random", "min-q")]
    first = phase_of("first", works)
    assert [job.name for job in first.jobs] == [training.name, works[0].name, works[1].name]
    assert [job.after for job in first.jobs] == [(), (training.name,), (training.name, works[0].name)]
    second = phase_of("second", [Attacking(training, "min-q-std")], [first])
    assert [len(job.after) for job in second.jobs] == [3] and not isinstance(second.jobs[0].do, Training)
    alone = phase_of("alone", works[:1], [Phase("trained", (Job(training.name, training),))])
    assert [job.name for job in alone.jobs] == [works[0].name]
