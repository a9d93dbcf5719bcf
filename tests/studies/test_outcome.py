"""The outcome study: its plan, and the paired gain in its tables; runs are tested with the work of training."""

import json
from pathlib import Path
from typing import Any

from odaf.studies import outcome as outcome_study
from odaf.studies.training import Training

RESULTS = Path(__file__).parents[2] / "results" / "outcome"


def record_of(critics: int, weight: float, seed: int, mean: float | None) -> dict[str, Any]:
    figures = dict.fromkeys(("transitions", "mean_return", "best_return", "direct_return", "ceiling"), 1)
    return {
        "maze": "stitch", "critics": critics, "weight": weight, "seed": seed,
        "steps": 20_000, "updates": 20_000 if mean else 7_000,
        "data": figures, "final": None if mean is None else {"mean_return": mean, "stitched_rate": 0.5},
    }  # fmt: skip


def test_the_gain_is_paired_by_seed() -> None:
    # Differences by seed 20 - 10, 32 - 20, 44 - 30 = 10, 12, 14: mean 12, standard deviation 2, t(0.975, 2) = 4.30265,
    # so 12 +- 4.30265 * 2 / sqrt(3) = 12 +- 4.968. Without pairing it would be about 12 +- 25. Seed 3 has no partner,
    # and neither has the weight 0.3 of four critics.
    zero = [record_of(2, 0.0, seed, mean) for seed, mean in enumerate((10.0, 20.0, 30.0))]
    three = [record_of(2, 3.0, seed, mean) for seed, mean in ((2, 44.0), (0, 20.0), (1, 32.0), (3, 64.0))]
    lines = outcome_study.table([*three, *zero, record_of(4, 0.3, 0, 9.0), record_of(4, 3.0, 1, None)]).splitlines()
    rows = [line for line in lines if line.startswith("| 2 | 0 ") or line.startswith(("| 2 | 3 ", "| 4 "))]
    # Returns 20, 32, 44, 64: mean 40, standard deviation 18.7617, t(0.975, 3) = 3.18245, half width 29.854.
    assert rows == [
        "| 2 | 0 | 20,000 | 3 | 20.0 | [-4.8, 44.8] | 10.0 | 0.50 | | | |",
        "| 2 | 3 | 20,000 | 4 | 40.0 | [10.1, 69.9] | 20.0 | 0.50 | +12.0 | [+7.0, +17.0] | 3 |",
        "| 4 | 0.3 | 20,000 | 1 | 9.0 | one seed | 9.0 | 0.50 | | | |",
    ]
    assert "- 4 critics, weight 3, seed 1: after 7,000 of 20,000 updates" in lines


def test_hopper_has_a_table_of_its_own_in_normalised_scores() -> None:
    def score_of(weight: float, score: float, seed: int = 0) -> dict[str, Any]:
        record = record_of(4, weight, seed, 1000.0)
        record["data"] |= {"normalised_score": 44.0}
        record["final"]["normalised_score"] = score
        del record["maze"]
        return record | {"task": "hopper-medium", "environment": "Hopper-v4"}

    maze = record_of(4, 0.0, 0, 9.0)
    fresh = [score_of(0.0, 50.0, seed=3), score_of(20.0, 55.0, seed=3)]
    text = outcome_study.table([maze, score_of(20.0, 70.0), score_of(0.0, 60.0), *fresh])
    rows = [line for line in text.splitlines() if line.startswith("| 4 ")]
    assert rows == [
        "| 4 | 0 | 20,000 | 1 | 9.0 | one seed | 9.0 | 0.50 | | | |",
        "| 4 | 0 | 20,000 | 1 | 60.0 | one seed | 60.0 | | | |",
        "| 4 | 20 | 20,000 | 1 | 70.0 | one seed | 70.0 | +10.0 | one seed | 1 |",
        "| 4 | 0 | 20,000 | 1 | 50.0 | one seed | 50.0 | | | |",
        "| 4 | 20 | 20,000 | 1 | 55.0 | one seed | 55.0 | +5.0 | one seed | 1 |",
    ]
    assert "mean score 44.0" in text and "Hopper-v4" in text


def test_a_partial_run_answers_for_the_smallest_ensemble_first() -> None:
    phases = [[job.do for job in phase.jobs if isinstance(job.do, Training)] for phase in outcome_study.plan()]
    asked = [
        ({run.task.name for run in phase}, {dict(run.changes)["num_critics"] for run in phase}) for phase in phases
    ]
    maze, hopper = {"stitch"}, {"hopper-medium"}
    assert asked == [(maze, {2}), (maze, {4}), (maze, {10}), (hopper, {4}), (hopper, {4}), (hopper, {10})]
    for number, phase in enumerate(phases, start=1):
        weights = (0.0, 0.3, 3.0) if phase[0].task.name == "stitch" else (0.0, 1.0) if number == 5 else (0.0, 1.0, 20.0)
        pairs = [(run.seed, dict(run.changes)["outcome.weight"]) for run in phase]
        seeds = range(3, 8) if number == 5 else range(3)
        assert pairs == [(seed, weight) for seed in seeds for weight in weights]
        assert {run.steps for run in phase} == {20_000}
    runs = [run for phase in phases for run in phase]
    assert len({run.title for run in runs}) == len(runs) == 27 + 18 + 10


def test_a_weight_of_0_leaves_the_term_out_and_every_record_says_what_is_compared() -> None:
    for phase in outcome_study.plan():
        for job in phase.jobs:
            assert isinstance(job.do, Training)
            notes = dict(job.do.notes)
            record = json.loads((RESULTS / f"{job.name}.json").read_text(encoding="utf-8"))
            assert (record["critics"], record["weight"]) == (notes["critics"], notes["weight"])
            assert bool(record["pretrain"].get("outcome")) == (notes["weight"] != 0.0)
