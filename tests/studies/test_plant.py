"""The plant study: claims that are wrong by hand, how its policies come about, and a whole study of tiny size."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from odaf.studies import plant
from odaf.studies.job import Job, Phase, Study
from odaf.studies.ledger import Ledger
from odaf.training.progress import Silent

TINY = (("members", 2), ("hidden_sizes", (4,)), ("steps", 2), ("batch_size", 8), ("resamples", 20))


def judged(verdict: str, true_value: float, low: float = -1.0, high: float = 1.0) -> dict[str, Any]:
    difference = {"value": 0.5 * (low + high), "low": low, "high": high}
    return {
        "verdict": verdict,
        "true_value": true_value,
        "value": {
            "unlike": 0.25,
            "unlike_states": None,
            "estimates": [{"method": "fqe"}, {"method": "blend", "difference": difference}],
        },
    }


def record(seed: int, **policies: dict[str, Any]) -> dict[str, Any]:
    return {"seed": seed, "operators": {"value": -100.0, "low": -120.0, "high": -80.0}, "policies": policies}


@pytest.mark.parametrize(
    ("verdict", "true_value", "wrong"),
    [
        ("better", -99.0, False),
        ("better", -101.0, True),
        ("worse", -101.0, False),
        ("worse", -99.0, True),
        ("not decided", 900.0, False),
        ("refused", 900.0, False),
    ],
)
def test_a_verdict_is_wrong_where_it_claims_what_is_not_so(verdict: str, true_value: float, wrong: bool):
    each = judged(verdict, true_value)
    assert plant.wrong(record(1, a=each), each) == wrong


def test_only_logs_that_judge_are_counted():
    records = [
        record(plant.TUNING, cloned=judged("better", -900.0)),
        record(1, cloned=judged("better", -900.0, 20.0, 40.0), rebrac=judged("better", 300.0, 390.0, 410.0)),
        record(2, cloned=judged("refused", -900.0)),
    ]
    found = json.loads(plant.summary(records))
    assert found["judging"]["better"] == {"policies": 2, "wrong": 1, "covered": 1}
    assert found["judging"]["refused"] == {"policies": 1, "wrong": 0, "covered": 0}
    assert found["logs"]["1"]["cloned"]["true_difference"] == -800.0
    rows = plant.table(records).splitlines()
    assert "| 1 | `cloned` | -800 | +30 (+20 to +40) | 25% | - | **better**, wrongly |" in rows
    assert "| 1 | `rebrac` | +400 | +400 (+390 to +410) | 25% | - | **better** |" in rows


def test_the_plan_settles_on_one_log_and_judges_on_three_others():
    first, others = plant.plan()
    assert [job.name for job in first.jobs] == [f"seed-{plant.TUNING}"]
    assert len(others.jobs) == 3 and all(job.do.identity()["policies"]["contrary"]["reversed"] for job in others.jobs)


def test_a_contrary_policy_learns_to_lose_what_the_log_earned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    given: list[Any] = []

    def fit(learner: Any, log: Any, **settings: Any) -> Any:
        given.append((learner, log, settings))
        return SimpleNamespace(policy=lambda seed: seed)

    monkeypatch.setattr("odaf.runs.fit.fit", fit)
    work = plant.Judging(5, shifts=4)
    learned, aside = work.logs(tmp_path)
    assert learned.num_episodes == aside.num_episodes == 2
    for name in ("rebrac", "contrary"):
        assert work.trained(name, learned, tmp_path, Silent()) == 5
    (held, own, _), (unheld, reversed_, settings) = given
    np.testing.assert_array_equal(own.rewards, learned.rewards)
    np.testing.assert_array_equal(reversed_.rewards, -learned.rewards)
    assert (held.actor_penalty > 0.0, unheld.actor_penalty, unheld.critic_penalty) == (True, 0.0, 0.0)
    assert settings["steps"] == 2_000 and settings["seeds"] == [5]


def test_a_tiny_study_from_the_plant_to_its_summary(tmp_path: Path):
    work = plant.Judging(1, shifts=4, episodes=1, policies=("cloned",), updates=2, settings=TINY)
    job = Job("seed-1", work)
    ledger = Ledger(Study("plant", "tiny", lambda: [Phase("all", (job,))], plant.STUDY.tables), tmp_path / "out")
    ledger.write(job, work.do(tmp_path / "work", Silent()))
    assert ledger.standing(job).state == "held"
    ledger.draw()
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert found["logs"]["1"]["cloned"]["verdict"] in plant.VERDICTS
    assert sum(each["policies"] for each in found["judging"].values()) == 1
