"""The scoreboard: which records count, what stands at which updates, and the plan."""

import json
from pathlib import Path
from typing import Any

import pytest

from odaf.studies import rivals, scoreboard
from odaf.studies.published import published_score
from odaf.studies.training import Training


def record_of(
    method: str, seed: int, scores: list[float] | None, task: str = "hopper-medium", preset: str = ""
) -> dict[str, Any]:
    points = [{"step": 10_000 * place, "normalised_score": score} for place, score in enumerate(scores or [], 1)]
    steps = 10_000 * max(len(points), 1)
    return {
        "task": task, "environment": "Hopper-v4", "preset": preset or method, "method": method, "seed": seed,
        "steps": steps, "updates": steps, "data": {"transitions": 90, "normalised_score": 11.25},
        "seconds": {"pretrain": 30.0, "compile": 10.0, "train": 80.0, "evaluate": 500.0, "total": 620.0},
        "final": points[-1] if points else None, "evaluations": points,
    }  # fmt: skip


RECORDS = [
    record_of("td3-bc", 0, [10.0, 20.0, 30.0, 34.0, 50.0]),
    record_of("td3-bc", 1, [20.0, 40.0, 50.0, 50.0, 70.0]),
    record_of("td3-bc-sampling-return", 0, [10.0, 20.0], preset="td3-bc"),
    record_of("td3-bc-sampling-return", 0, [10.0, 20.0, 30.0, 40.0, 90.0], preset="td3-bc"),
    record_of("iql", 0, None),
]


def test_summary_has_mean_seeds_and_seconds_at_each_budget_of_the_longest_runs() -> None:
    board = json.loads(scoreboard.summary(RECORDS))
    assert set(board["hopper-medium"]) == {"td3-bc", "td3-bc-return"}  # a method that diverged has no score
    # 30 + 10 before the first update, then 80 seconds for 50,000.
    assert board["hopper-medium"]["td3-bc"] == {
        "10000": {"mean": 15.0, "seeds": 2, "seconds": pytest.approx(56.0)},
        "20000": {"mean": 30.0, "seeds": 2, "seconds": pytest.approx(72.0)},
        "50000": {"mean": 60.0, "seeds": 2, "seconds": pytest.approx(120.0)},
    }
    assert board["hopper-medium"]["td3-bc-return"]["50000"]["mean"] == 90.0


def test_table_ranks_by_the_last_checkpoint_and_says_how_steady_and_how_fast() -> None:
    lines = scoreboard.table(RECORDS).splitlines()
    # Steadiness: the sample deviations of (30, 34, 50) and (50, 50, 70) are 10.583 and 11.547, their mean is 11.1.
    # The interval of 50 and 70: 60 +- 12.7062 * 10.
    assert lines[-3:] == [
        "| td3-bc-return | 10.0 | 20.0 | 90.0 |  | 1 | one seed | 90.0 | 32.1 | 2.0 | 45.0 |  |",
        "| td3-bc | 15.0 | 30.0 | 60.0 |  | 2 | [-67.1, 187.1] | 50.0 | 11.1 | 2.0 | 30.0 | 60.4 |",
        "| iql | 1 of 1 diverged | | | | | | | | | | |",
    ]
    heads = next(line for line in lines if line.startswith("| method"))
    assert {line.count("|") for line in lines[-3:]} == {heads.count("|")}
    assert "locally generated data" in lines[0]


def test_published_scores_belong_to_the_public_sets_and_to_plain_presets() -> None:
    assert published_score("rebrac", "hopper-medium") == 102.29
    assert published_score("rebrac", "hopper-mixture-80") is None
    assert published_score("odaf-locomotion", "hopper-medium") is None


def test_the_figure_is_drawn_with_a_set_missing_and_a_method_diverged(tmp_path: Path) -> None:
    scoreboard.figure([*RECORDS, record_of("iql", 0, [50.0], task="walker2d-medium")], tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_the_plan_is_the_nine_sets_and_every_method_draws_its_rows_as_its_name_says() -> None:
    phases = scoreboard.STUDY.plan()
    works = [job.do for job in scoreboard.STUDY.jobs() if isinstance(job.do, Training)]
    assert len({work.task.name for work in works}) == 12
    first = [job.do for job in phases[0].jobs if isinstance(job.do, Training)]
    assert len(first) == 9 * 5 * scoreboard.SEEDS and {getattr(work.task.log, "seed", None) for work in works} == {2}
    for work in works:
        learner, name = work.learner(), scoreboard.name_of(work.method)
        assert learner.sampling == ("return" if "return" in name else "best" if "best" in name else "uniform"), name


def test_what_the_rivals_study_measured_on_hopper_counts_here() -> None:
    name = "hopper-medium-td3-bc-seed0-50000"
    ours, theirs = ({job.name: job.do for job in study.jobs()}[name] for study in (scoreboard.STUDY, rivals.STUDY))
    assert ours == theirs
