"""The selection study: ways to choose by hand, and a whole study of tiny size."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from odaf.data.dataset import Dataset
from odaf.studies import selection
from odaf.studies.job import Job, Phase, Study
from odaf.studies.ledger import Ledger
from odaf.training.progress import Silent

SCORES = {"a": 10.0, "b": 40.0, "c": 20.0, "d": 30.0}


def estimate(low: float, verdict: str = "not decided", width: float = 2.0) -> dict[str, Any]:
    difference = {"value": low + width / 2, "low": low, "high": low + width}
    calibrated = {name: 100.0 + number for name, number in difference.items()}
    fqe = {"method": "fqe", "difference": difference, "calibrated": calibrated, "value": calibrated, "verdict": verdict}
    wis = {"method": "wis", "difference": None, "calibrated": None, "value": None, "verdict": "refused"}
    own = {"value": 100.0, "low": 99.0, "high": 101.0}
    return {"estimates": [fqe, wis], "behaviour": own, "unlike": 0.1, "episodes": 20, "confidence": 0.95}


def records(estimates: dict[str, Any]) -> list[dict[str, Any]]:
    log = {"normalised_score": 12.0}
    found = [
        {
            "task": "hopper-medium-train",
            "method": name,
            "final": {"normalised_score": score, "mean_return": 100.0 + score},
            "data": log,
        }
        for name, score in SCORES.items()
    ]
    identity = {"settings": {"members": 8}}
    return [*found, {"kind": "choice", "task": "hopper-medium-train", "estimates": estimates, "identity": identity}]


def test_ways_to_choose_by_hand():
    # Of 10, 20, 30, 40 three are drawn: the best is 30 once in four, else 40.
    estimates = {
        "a": estimate(1.0),
        "b": estimate(9.0, "refused"),
        "c": estimate(2.0, width=50.0),
        "d": estimate(3.0),
    }
    found = json.loads(selection.summary(records(estimates)))["hopper-medium-train"]
    assert found["random"] == 25.0 and found["oracle"] == 40.0 and found["worst"] == 10.0 and found["log"] == 12.0
    assert found["best_of_three"] == pytest.approx((30 + 3 * 40) / 4)
    assert found["chosen"] == 30.0 and found["by_estimator"] == {"fqe": 30.0}
    lines = selection.table(records(estimates)).splitlines()
    assert "| hopper-medium | 12.0 | 10.0 | 25.0 | 30.0 | 37.5 | 40.0 | no |  |" in lines
    # Calibrated values 102, 110, 127, 104 beside true ones 110, 140, 120, 130: ranks 1 3 4 2 and 1 4 2 3.
    beside = found["beside_true_values"]["fqe, calibrated"]
    assert beside["spearman"] == pytest.approx(1 - 6 * (1 + 4 + 1) / 60)
    assert beside["mean_absolute_error"] == pytest.approx((8 + 30 + 7 + 26) / 4 / 30)
    assert beside["coverage"] == 0.25 and "| hopper-medium | fqe, calibrated | 0.40 | 0.59 | 0.25 |" in "\n".join(lines)


def test_refused_policies_are_chosen_only_where_there_are_no_others():
    found = {name: estimate(score, "refused") for name, score in SCORES.items()}
    assert selection.chosen_by(found, "fqe") == "b" and selection.chosen_by(found, "wis") is None


def test_a_diverged_run_counts_as_the_worst_and_a_grid_that_is_not_whole_is_left_out():
    estimates = {name: estimate(score) for name, score in SCORES.items()}
    whole = records(estimates)
    whole[1]["final"] = None
    found = selection.figures(whole)["hopper-medium-train"]
    assert found["worst"] == 10.0 and found["random"] == 17.5 and found["chosen"] == 10.0
    assert selection.figures(records({"a": estimate(1.0)})) == {} and selection.figures(whole[:-1]) == {}


def test_the_plan_chooses_after_the_grid():
    jobs = selection.STUDY.jobs()
    assert len(jobs) == 30
    choices = [job for job in jobs if isinstance(job.do, selection.Choosing)]
    assert [job.name for job in choices] == [f"{name}-choice" for name in selection.SETS]
    assert all(len(job.after) == 9 for job in choices)


TINY = (("members", 2), ("hidden_sizes", (8,)), ("steps", 20), ("batch_size", 8), ("resamples", 20))


def test_a_tiny_study_from_the_simulator_to_its_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from dataclasses import replace

    from odaf.studies.task import Evaluation

    small = (("hidden_sizes", (8,)), ("batch_size", 8))
    grid = tuple(
        replace(
            training,
            task=replace(training.task, evaluation=Evaluation(every=4, episodes=1)),
            form=small,
        )
        for training in (selection.training("hopper-random", weight, rows=400, steps=4) for weight in (1.0, 5.0))
    )
    holdout = selection.PartOfLog("hopper-random", 400, selection.LOG_SEED, part="holdout")
    jobs = [Job(each.name, each) for each in grid]
    jobs.append(
        Job("hopper-random-choice", selection.Choosing(grid, holdout, 30, TINY), tuple(job.name for job in jobs))
    )
    study = Study("selection", "tiny", lambda: [Phase("all", tuple(jobs))], selection.STUDY.tables)
    ledger = Ledger(study, tmp_path / "out")
    for job in jobs:
        assert job.do.log is not None
        dataset = Dataset.load(job.do.log.present(tmp_path / "work"))
        ledger.note_log(job.do.log, [dataset.fingerprint(), dataset.file_fingerprint()])
        ledger.write(job, job.do.do(tmp_path / "work", Silent()))
    assert [one.state for one in map(ledger.standing, jobs)] == ["held"] * 3
    ledger.draw()
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["hopper-random-train"]
    assert {"random", "chosen", "best_of_three", "oracle", "worst"} <= set(found)
    assert found["worst"] <= found["chosen"] <= found["oracle"] and math.isfinite(found["random"])
    parts = [Dataset.load(part.present(tmp_path / "work")) for part in (grid[0].task.log, holdout)]  # type: ignore
    assert sum(map(len, parts)) == 400 and parts[0].num_episodes > parts[1].num_episodes
