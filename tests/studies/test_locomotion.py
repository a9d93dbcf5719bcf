"""The locomotion study: records, table, going on after a stop; small runs of the method that compiles soonest."""

import json
from pathlib import Path
from typing import Any

import pytest

from odaf.environments import locomotion_data
from odaf.evaluation.rollouts import RolloutEvaluator
from odaf.runs import presets
from odaf.studies import ledger
from odaf.studies import locomotion as locomotion_study
from odaf.studies.ledger import StudyRun

# The version of the published scores is an old one, and gymnasium says so.

RUNS = [StudyRun("behaviour-cloning", "hopper-medium", seed, 4) for seed in range(2)]
SMALL = {"TRANSITIONS": 1_500, "HIDDEN_SIZES": (8,), "EPISODES": 1, "FINAL_EPISODES": 2, "EVALUATE_EVERY": 2}


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locomotion_study, "plan", lambda: [RUNS[:1], RUNS[1:]])
    monkeypatch.setattr(ledger, "CHECKPOINT_EVERY", 2)
    for name, value in SMALL.items():
        monkeypatch.setattr(locomotion_study, name, value)


def read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.usefixtures("small")
def test_record_and_table(tmp_path: Path) -> None:
    out, work = tmp_path / "results", tmp_path / "work"
    locomotion_study.run(out, phase=[1], work=work)
    assert [path.name for path in out.glob("*.json")] == [f"{RUNS[0].name}.json"]
    record = read(out / f"{RUNS[0].name}.json")
    assert str(tmp_path) not in json.dumps(record)  # a ledger names no folder of the machine
    assert record["algorithm"]["hidden_sizes"] == [8]
    assert [evaluation["step"] for evaluation in record["evaluations"]] == [2, 4]
    assert record["updates"] == record["steps"] == record["final"]["step"] == 4
    assert len(record["final"]["returns"]) == 2  # more episodes than while it trained
    assert record["final"]["mean_return"] == pytest.approx(sum(record["final"]["returns"]) / 2)
    for score in (record["final"], *record["evaluations"]):  # 0 is a return of -20.272305, 100 one of 3234.3
        assert score["normalised_score"] == pytest.approx((score["mean_return"] + 20.272305) / 32.54572305)
    logged = locomotion_data.generate("hopper-medium", SMALL["TRANSITIONS"], 0)
    figures = logged.provenance["statistics"]
    assert record["data"]["sha256"] == logged.fingerprint()
    assert record["data"]["mean_return"] == figures["mean"]
    data, cloning = (out / "table.md").read_text(encoding="utf-8").splitlines()[-2:]
    assert data.startswith("| hopper-medium | Hopper-v4 | locally generated data, ")
    assert f"({figures['whole_episodes']} episodes) | | | {figures['normalised_mean']:.1f} " in data
    assert f"| behaviour-cloning | 4 | 1 | {record['final']['normalised_score']:.1f} | one seed |" in cloning


@pytest.mark.usefixtures("small")
def test_a_stopped_run_goes_on_and_a_finished_one_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, work, other = tmp_path / "results", tmp_path / "work", tmp_path / "other"
    evaluate = RolloutEvaluator.__call__

    def stop_late(self: RolloutEvaluator, policy: Any, directory: Path, step: int) -> Any:
        if step == 4 and RUNS[1].title in str(directory):
            raise KeyboardInterrupt
        return evaluate(self, policy, directory, step)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(RolloutEvaluator, "__call__", stop_late)
        locomotion_study.run(out, work=work)
    finished = out / f"{RUNS[0].name}.json"
    assert list(out.glob("*.json")) == [finished]
    stamp = finished.stat().st_mtime_ns
    checkpoints = work / RUNS[1].title / "seed-1" / "checkpoints"
    (half,) = [path for path in checkpoints.iterdir() if int(path.name) == 2]
    made = half.stat().st_ctime_ns

    locomotion_study.run(out, work=work)
    assert finished.stat().st_mtime_ns == stamp
    assert half.stat().st_ctime_ns == made  # it went on from there, not from the beginning
    record = read(out / f"{RUNS[1].name}.json")
    assert [evaluation["step"] for evaluation in record["evaluations"]] == [2, 4]
    locomotion_study.run(other, phase=[2], work=other)
    assert record["final"] == read(other / f"{RUNS[1].name}.json")["final"]  # the bits of a run without a stop


def record_of(
    method: str,
    seed: int,
    score: float | None,
    updates: int = 50_000,
    fingerprint: str = "ab" * 32,
    mean_return: float = 1434.0,
) -> dict[str, Any]:
    data = {
        "sha256": fingerprint, "transitions": 90, "whole_episodes": 9, "mean_return": mean_return, "best_return": 2e3,
        "normalised_score": 44.7,
    }  # fmt: skip
    return {
        "task": "hopper-medium", "environment": "Hopper-v4", "method": method, "seed": seed, "steps": 50_000,
        "updates": updates, "data": data, "updates_per_second": 50.0, "seconds": {"total": 1800.0},
        "final": None if score is None else {"normalised_score": score, "mean_return": 10 * score},
        "evaluations": [] if score is None else [{"normalised_score": score / 2}, {"normalised_score": score}],
    }  # fmt: skip


def test_table_has_the_interval_over_seeds_and_says_what_diverged() -> None:
    # Scores 40 and 60: mean 50, standard error 10, t(0.975, 1) = 12.7062; on the way 20, 40, 30 and 60.
    lines = locomotion_study.table(
        [
            record_of("odaf", 0, 40.0),
            record_of("odaf", 1, 60.0),
            record_of("sac-n", 0, 70.0),
            record_of("sac-n", 1, None, updates=12_000),
            record_of("behaviour-cloning", 0, 30.0),
        ]
    ).splitlines()[-4:]
    before = "| hopper-medium | Hopper-v4 | locally generated data, abababab | "
    assert lines == [
        f"{before}the data themselves (9 episodes) | | | 44.7 | | | 1,434.0 | | |",
        f"{before}behaviour-cloning | 50,000 | 1 | 30.0 | one seed | 22.5 | 300.0 | 50.0 | 0.50 |",
        f"{before}odaf | 50,000 | 2 | 50.0 | [-77.1, 177.1] | 37.5 | 500.0 | 50.0 | 0.50 |",
        f"{before}sac-n | 12,000 and 50,000 of 50,000 | 2 | 1 of 2 diverged | | | | 50.0 | 0.50 |",
    ]


def test_sets_are_told_apart_by_their_rows_not_by_their_notes() -> None:
    same = [record_of("odaf", 0, 40.0), record_of("odaf", 1, 60.0, fingerprint="cd" * 32)]
    lines = locomotion_study.table(same).splitlines()[-2:]
    assert all(
        line.startswith("| hopper-medium | Hopper-v4 | locally generated data, abababab and cdcdcdcd |")
        for line in lines
    )
    assert "| odaf | 50,000 | 2 | 50.0 |" in lines[1]
    other = [record_of("odaf", 0, 40.0), record_of("odaf", 1, 60.0, mean_return=1434.5)]
    lines = locomotion_study.table(other).splitlines()[-4:]
    assert [line.count("| odaf | 50,000 | 1 |") for line in lines] == [0, 1, 0, 1]


def test_the_plan_is_what_the_page_says() -> None:
    phases = locomotion_study.plan()
    runs = [run for phase in phases for run in phase]
    assert len({run.title for run in runs}) == len(runs)  # no two runs share a directory
    first = [(run.method, run.task, run.seed) for run in phases[0][:2]]
    assert first == [("behaviour-cloning", "hopper-medium", 0), ("odaf-locomotion", "hopper-medium", 0)]
    few = {run.preset for run in runs if run.steps == 10_000}
    assert few == {"pbrl", "rorl", "odaf-rorl", "odaf-demo"}
    for task in ("hopper-medium", "halfcheetah-medium"):
        for preset in (
            "behaviour-cloning", "sac-n", "edac", "osr-10", "odaf", "odaf-paper", "odaf-pessimistic",
            "odaf-without-outcome", "odaf-locomotion",
        ):  # fmt: skip
            seeds = [run.seed for run in runs if (run.method, run.task, run.steps) == (preset, task, 50_000)]
            assert seeds == [0, 1], (preset, task)


def test_every_learner_takes_its_task_then_the_common_networks_then_its_changes() -> None:
    for phase in locomotion_study.plan():
        for run in phase:
            assert locomotion_study.learner(run).hidden_sizes == (256, 256)
    assert presets.load("edac").hidden_sizes != (256, 256)
    edac = [locomotion_study.learner(StudyRun("edac", task, 0, 1)) for task in ("hopper-medium", "halfcheetah-medium")]
    assert [learner.num_critics for learner in edac] == [50, 10]
    assert [
        locomotion_study.learner(run).num_critics for run in locomotion_study.plan()[1] if run.preset == "edac"
    ] == [10, 10]
    default = locomotion_study.learner(locomotion_study.plan()[0][1])
    assert (default.reward_scale, default.warm_start, default.return_steps) == ("auto", "returns", 5)
