"""The ant-maze study: its logs, its plan, its table and its summary."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from odaf.studies import antmaze
from odaf.studies.ant_maze_logs import AntMazeLog, walker_print
from odaf.studies.training import Training, kept_paths


def record_of(method: str, seed: int, success: float | None, task: str = "antmaze-umaze") -> dict[str, Any]:
    return {
        "task": task, "environment": "odaf/AntMaze-UMaze-v0", "method": method, "seed": seed, "steps": 300_000,
        "data": {"transitions": 90, "reached_share": 0.75, "flipped_share": 0.25, "goal_walks": 12},
        "seconds": {"total": 60.0 + seed}, "final": None if success is None else {"normalised_score": success},
    }  # fmt: skip


RECORDS = [record_of("iql", 0, 60.0), record_of("iql", 1, 80.0), record_of("td3-bc", 0, None)]


def test_table_and_summary_have_the_success_and_its_interval_over_seeds() -> None:
    # Mean 70, standard error 10, t(0.975, 1) = 12.7062.
    lines = antmaze.table(RECORDS).splitlines()
    assert lines[-2:] == [
        "| iql | 300,000 | 2 | 70.0 | [-57.1, 197.1] | 60 |",
        "| td3-bc | 300,000 | 1 | 1 of 1 diverged | | 60 |",
    ]
    assert "75% of its walks reach their own goal, 25% end on their back; 12 walks end at" in lines[-6]
    summary = json.loads(antmaze.summary(RECORDS))["antmaze-umaze"]
    assert summary["iql"]["interval"] == [pytest.approx(-57.062, abs=1e-3), pytest.approx(197.062, abs=1e-3)]
    figures = {name: value for name, value in summary["iql"].items() if name != "interval"}
    assert figures == {"updates": 300_000, "success": 70.0, "seeds": [0, 1], "diverged": 0, "seconds": 60.5}
    assert summary["td3-bc"]["success"] is None and summary["td3-bc"]["diverged"] == 1


def test_every_method_of_the_plan_resolves_with_its_values_for_the_maze() -> None:
    works = [job.do for job in antmaze.STUDY.jobs() if isinstance(job.do, Training)]
    assert {work.task.name for work in works} == set(antmaze.SMALL + antmaze.OTHERS)
    assert len({work.name for work in works}) == len(works) == 6 * 11 * 4 + 2 * 6 * 2
    learners = {work.method: work.learner() for work in works if work.task.name == "antmaze-medium-play"}
    assert set(antmaze.METHODS) < set(learners) and len(learners) == 11 + 6
    assert (learners["iql"].expectile, learners["iql"].reward_shift) == (0.9, -1.0)
    assert (learners["rebrac"].actor_penalty, learners["rebrac"].reward_scale) == (0.001, 100.0)
    assert (learners["td3-bc"].reward_shift, learners["td3-bc"].value_weight) == (-1.0, 2.5)
    raw = {name for name, learner in learners.items() if learner.observation_scaling == "none"}
    assert raw == {"iql", "rebrac", "spot", "cql", "odaf-antmaze-observation_scaling-none"}


def test_our_recipe_has_rebracs_penalties_and_each_ablation_one_part_less() -> None:
    def learner(name: str, method: str = antmaze.OURS, changes: Any = ()) -> Any:
        return Training(method, antmaze.task_of(name), 0, 1, changes).learner()

    for name in antmaze.SMALL + antmaze.OTHERS:
        ours, rebrac = learner(name), learner(name, "rebrac")
        assert [term.name for term in ours.active_terms] == ["outcome", "behaviour"]
        (behaviour,) = (term for term in ours.terms if term.name == "behaviour")
        assert (behaviour.weight, behaviour.target_weight) == (rebrac.actor_penalty, rebrac.critic_penalty)
        for field in ("discount", "reward_scale", "actor_learning_rate", "critic_learning_rate", "batch_size"):
            assert getattr(ours, field) == getattr(rebrac, field), field
    ours = learner("antmaze-umaze")
    forms = [learner("antmaze-umaze", *form) for form in antmaze.WITHOUT]
    assert [[term.name for term in form.active_terms] for form in forms[:2]] == [["behaviour"], ["outcome"]]
    differing = [
        {field.name for field in dataclasses.fields(form) if getattr(form, field.name) != getattr(ours, field.name)}
        for form in forms
    ]
    assert differing == [
        {"terms"}, {"terms"}, {"return_steps"}, {"warm_start", "target_entropy"}, {"num_critics"},
        {"observation_scaling"},
    ]  # fmt: skip


def test_a_log_is_told_by_its_rows_seed_and_walker() -> None:
    log = AntMazeLog("antmaze-umaze")
    assert log.name == "antmaze-umaze" and AntMazeLog("antmaze-umaze", 100_000).name == "antmaze-umaze-100k"
    assert log.recipe()["walker_sha256"] == walker_print()
    assert log.recipe() != AntMazeLog("antmaze-umaze", seed=1).recipe()


def test_paths_of_the_first_seeds_are_drawn_over_their_mazes(tmp_path: Path) -> None:
    walked = {"places": ["0,0 4,0 8,0", "0,0 0.5,0.25"], "success": [True, False]}
    records = [{**record, "paths": walked} for record in RECORDS[:2]] + [RECORDS[2]]
    kept = kept_paths(records[0])
    assert kept.doing == "reach the goal" and kept.good is not None and kept.good.tolist() == [True, False]
    np.testing.assert_array_equal(kept.positions[0], [[0, 0], [4, 0], [8, 0]])
    np.testing.assert_array_equal(kept.positions[1], [[0, 0], [0.5, 0.25], [np.nan, np.nan]])
    antmaze.figure(records, tmp_path / "paths.png")
    assert (tmp_path / "paths.png").read_bytes().startswith(b"\x89PNG")
    antmaze.figure(RECORDS, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
