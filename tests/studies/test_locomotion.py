"""The locomotion study: its plan, its learners and its table; runs are tested with the work of training."""

from typing import Any

from odaf.runs import presets
from odaf.studies import locomotion as locomotion_study
from odaf.studies.training import Training


def trainings(*phases: int) -> list[Training]:
    plan = locomotion_study.plan()
    jobs = [job for number, phase in enumerate(plan) if not phases or number in phases for job in phase.jobs]
    return [job.do for job in jobs if isinstance(job.do, Training)]


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


def test_the_table_says_of_which_edition_the_data_are() -> None:
    record = record_of("odaf", 0, 40.0)
    record["data"]["edition"] = 1
    lines = locomotion_study.table([record]).splitlines()[-2:]
    before = "| hopper-medium | Hopper-v4 | locally generated data, edition 1, abababab | "
    assert all(line.startswith(before) for line in lines)


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
    runs = trainings()
    assert len({run.title for run in runs}) == len(runs)  # no two runs share a directory
    first = [(run.method, run.task.name, run.seed) for run in trainings(0)[:2]]
    assert first == [("behaviour-cloning", "hopper-medium", 0), ("odaf-locomotion", "hopper-medium", 0)]
    few = {run.preset for run in runs if run.steps == 10_000}
    assert few == {"pbrl", "rorl", "odaf-rorl", "odaf-demo"}
    for task in ("hopper-medium", "halfcheetah-medium"):
        for preset in (
            "behaviour-cloning", "sac-n", "edac", "osr-10", "odaf", "odaf-paper", "odaf-pessimistic",
            "odaf-without-outcome", "odaf-locomotion",
        ):  # fmt: skip
            seeds = [run.seed for run in runs if (run.method, run.task.name, run.steps) == (preset, task, 50_000)]
            assert seeds == [0, 1], (preset, task)


def test_every_learner_takes_its_task_then_the_common_networks_then_its_changes() -> None:
    for run in trainings():
        assert run.learner().hidden_sizes == (256, 256)
    assert presets.load("edac").hidden_sizes != (256, 256)
    tasks = [locomotion_study.locomotion_task(name) for name in ("hopper-medium", "halfcheetah-medium")]
    assert [Training("edac", task, 0, 1).learner().num_critics for task in tasks] == [50, 10]
    assert [run.learner().num_critics for run in trainings(1) if run.preset == "edac"] == [10, 10]
    default = trainings(0)[1].learner()
    assert (default.reward_scale, default.warm_start, default.return_steps) == ("auto", "returns", 5)
