"""The rivals study: its mixed log, its plan, its table and its summary."""

import json
from pathlib import Path
from typing import Any

import pytest

from odaf.data.dataset import Dataset
from odaf.studies import rivals
from odaf.studies.logs import MixedLog
from odaf.studies.training import Training


def record_of(method: str, seed: int, scores: list[float] | None, task: str = "hopper-mixture-80") -> dict[str, Any]:
    points = [{"normalised_score": score} for score in scores or []]
    return {
        "task": task, "environment": "Hopper-v4", "method": method, "seed": seed, "steps": 40_000,
        "data": {"transitions": 90, "normalised_score": 11.25}, "updates_per_second": 800.0,
        "seconds": {"total": 60.0}, "final": points[-1] if points else None, "evaluations": points,
    }  # fmt: skip


RECORDS = [
    record_of("iql", 0, [99.0, 10.0, 20.0, 30.0]),
    record_of("iql", 1, [0.0, 30.0, 40.0, 50.0]),
    record_of("td3-bc", 0, None),
]


def test_table_has_the_mean_of_the_last_three_and_its_interval_over_seeds() -> None:
    # Means of the last three 20 and 40: mean 30, standard error 10, t(0.975, 1) = 12.7062.
    lines = rivals.table(RECORDS).splitlines()
    assert lines[-6].startswith(
        "**hopper-mixture-80** (Hopper-v4; locally generated data, 90 rows): the log's mean is 11.2"
    )
    assert lines[-2:] == [
        "| iql | 40,000 | 2 | 40.0 | 30.0 | [-97.1, 157.1] | 20.0 | 800 | 60 |",
        "| td3-bc | 40,000 | 1 | 1 of 1 diverged | | | | | |",
    ]


def test_summary_has_each_seed_and_none_where_it_diverged() -> None:
    log = json.loads(rivals.summary(RECORDS))["hopper-mixture-80"]
    assert log["data"] == "locally generated data" and log["log_mean"] == 11.25
    of_an_edition = [{**record, "data": {**record["data"], "edition": 2}} for record in RECORDS]
    assert json.loads(rivals.summary(of_an_edition))["hopper-mixture-80"]["data"] == (
        "locally generated data, edition 2"
    )
    assert log["methods"]["iql"] == {"updates": 40_000, "by_seed": {"0": 20.0, "1": 40.0}}
    assert log["methods"]["td3-bc"]["by_seed"] == {"0": None}


def test_a_mixed_log_has_the_experts_rows_and_then_random_ones(tmp_path: Path) -> None:
    log = MixedLog("hopper", random_percent=75, transitions=400, seed=3)
    mixed = Dataset.load(log.present(tmp_path))
    assert log.name == "hopper-mixture-75-0.4k" and len(mixed) == 400
    assert 100 in mixed.episode_starts  # no episode reaches over the border
    assert mixed.rewards[:100].mean() > 2.0 > mixed.rewards[100:].mean()  # an expert earns about 3.6 a step
    assert mixed.environment is not None
    assert log.recipe() != MixedLog("hopper", 75, 400, seed=4).recipe()


def test_every_method_of_the_plan_resolves_and_draws_its_rows_as_its_name_says() -> None:
    works = [job.do for job in rivals.STUDY.jobs() if isinstance(job.do, Training)]
    for work in works:
        sampling = dict(work.changes).get(
            "sampling", {"behaviour-cloning-best": "best", "rebrac-return": "return"}.get(work.preset, "uniform")
        )
        assert work.learner().sampling == sampling, work.name
    assert {work.seed for work in works if work.task.name == "hopper-mixture-80"} == {0, 1, 2}


@pytest.mark.parametrize("task", [rivals.medium_task(), rivals.mixture_task()])
def test_no_log_of_the_study_is_one_that_settings_were_tried_on(task: Any) -> None:
    assert task.log.seed == 2
