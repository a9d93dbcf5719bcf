"""The stitching study: its plan, the search and its rule, the tables of both parts; what is measured on a policy."""

import json
from pathlib import Path
from typing import Any

import pytest

from odaf.studies import pointmaze, pointmaze_first, pointmaze_outcomes, pointmaze_search, pointmaze_table
from odaf.studies.identity import differences
from odaf.studies.ledger import Ledger
from odaf.studies.logs import MazeLog
from odaf.studies.pointmaze_methods import CHEAP, COSTLY, MAZES, MBRCSL, PAPER, STEPS, TRIED, TRIES, maze_task, training
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training
from odaf.training.progress import Silent
from studies.untrained import without_training

NAMED = (
    "behaviour-cloning behaviour-cloning-best td3-bc rebrac rebrac-return iql cql spot svr bear osr osr-10 sdc scas "
    "mopo combo"
)


def record(preset: str, seed: int, earned: float | None, maze: str = "stitch", **more: Any) -> dict[str, Any]:
    final = None if earned is None else {"mean_return": earned, "stitched_rate": 0.5}
    changes = more.pop("changes", {})
    method = "-".join([preset, *(f"{field}-{value}" for field, value in changes.items())])
    return {
        "maze": maze, "map": maze, "log_seed": 2, "broad": False, "percent": 100, "preset": preset, "method": method,
        "changes": changes, "seed": seed, "steps": STEPS, "final": final, "seconds": {"total": 90.0},
        "data": {"transitions": 9, "mean_return": 40.0, "best_return": 70.0, "direct_return": 110.0, "ceiling": 136.0},
        **more,
    }  # fmt: skip


def test_the_first_part_is_what_it_was() -> None:
    phases = pointmaze_first.plan()
    first = [(job.do.method, job.do.seed) for job in phases[0].jobs if isinstance(job.do, Training)]
    methods = ("odaf", "odaf-without-outcome", "behaviour-cloning")
    assert first == [(method, seed) for seed in range(4) for method in methods]
    longer = [job for phase in phases for job in phase.jobs if job.name.endswith("-50000")]
    assert [job.after for job in longer] == [(job.name.replace("-50000", "-20000"),) for job in longer]
    assert len(longer) == 4


def test_the_plan_has_every_method_in_four_mazes_on_a_log_that_nothing_was_tuned_on() -> None:
    phases = pointmaze.plan()
    works = [job.do for phase in phases[:7] for job in phase.jobs]
    table = [one for one in works if isinstance(one, Training)]
    assert len(table) == len(works)
    trained = {(one.preset, dict(one.changes).get("return_steps")) for one in table}
    rivals = {*NAMED.split(), MBRCSL}
    ours = {(preset, steps) for preset in ("odaf", "odaf-without-outcome") for steps in (None, 3)}
    assert trained == {*((preset, None) for preset in (*rivals, PAPER)), *ours}
    assert {*CHEAP, *COSTLY, MBRCSL} == rivals == set(TRIED)
    names = {f"{maze}-log2" for maze in ("stitch", "shaft", "crossroads", "ladder")}
    assert {one.task.name for one in table} == names == {maze_task(maze).name for maze in MAZES}
    assert pointmaze_search.SEARCH_LOG_SEED == 0
    assert {one.steps for one in table if one.preset not in (MBRCSL, "bear")} == {20_000}
    assert {one.task.evaluation.episodes for one in table} == {50}
    early = table[: sum(len(phase.jobs) for phase in phases[:3])]
    assert {one.task.name for one in early} == {"stitch-log2"} and {one.seed for one in early} == {0, 1}
    assert [one.preset for one in early[:2]] == ["behaviour-cloning", "behaviour-cloning-best"]
    assert len({(one.preset, one.changes, one.task, one.seed) for one in table}) == 22 * 4 * 4
    bear = next(one for one in table if one.preset == "bear").learner()
    assert bear.warm_up_steps == 5_000 and pointmaze_table.STEPS_OF["bear"] == 25_000


def test_six_settings_of_every_rival_are_tried_and_each_can_be_trained() -> None:
    learners = {}
    for job in pointmaze_search.STUDY.jobs():
        assert isinstance(job.do, Training) and job.do.task.name == "stitch" and job.do.seed == 0
        learners.setdefault(job.do.preset, set()).add(job.do.learner())
    assert {preset: len(each) for preset, each in learners.items()} == dict.fromkeys(TRIED, TRIES)


def tried(preset: str, earned: list[float | None]) -> list[dict[str, Any]]:
    return [
        record(preset, 0, each, changes=dict(changes)) for each, changes in zip(earned, TRIED[preset], strict=False)
    ]


def test_the_winner_is_found_by_the_rule(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    records = [
        *tried("td3-bc", [60.0, 50.0, 90.0, 90.0, None, 10.0]),
        *tried("iql", [60.0, 50.0, 40.0, 30.0, 20.0]),  # one is missing
        *tried("spot", [70.0, 70.0, 0.0, 0.0, 0.0, 0.0]),
    ]
    found = pointmaze_search.winners(records)
    assert found == {"td3-bc": (("value_weight", 5.0),), "spot": ()}
    text = pointmaze_search.table(records)
    assert "| td3-bc | value_weight 5.0 | 90.0 | 0.50 | 90 | taken |" in text and "| diverged |" in text
    assert json.loads(pointmaze_search.summary(records)) == {"td3-bc": {"value_weight": 5.0}, "spot": {}}

    monkeypatch.setattr(Ledger, "held", lambda ledger: records if ledger.out == tmp_path / "pointmaze-search" else [])
    study = pointmaze.STUDY.among(tmp_path)
    names = [[job.name for job in phase.jobs] for phase in study.plan()]
    assert "stitch-log2-td3-bc-value_weight-5.0-seed0-20000" in names[0]
    assert "stitch-log2-td3-bc-seed0-20000" not in names[0] and "stitch-log2-td3-bc-seed0-20000" in names[7]
    assert "stitch-log2-spot-seed0-20000" in names[0] and len(names[7]) == 2
    assert len({name for each in names for name in each}) == sum(map(len, names))
    drawn = study.tables["table.md"]([record("td3-bc", 0, 80.0, changes={"value_weight": 5.0}), record("iql", 0, 20.0)])
    assert "| td3-bc | value_weight 5.0, best of 6 |" in drawn and "| iql | the preset, not searched |" in drawn
    assert "not the best of 6" in study.tables["table.md"]([record("td3-bc", 0, 60.0)])


def test_the_table_ranks_and_compares_with_the_base() -> None:
    records = [
        *(record("odaf-without-outcome", seed, 120.0 + seed) for seed in range(2)),
        *(record("odaf", seed, 121.0 + seed) for seed in range(2)),
        record("mopo", 0, 30.0), record("mopo", 1, None),
        record("odaf", 0, 150.0, maze="ladder"),
        record("odaf", 0, 1.0, broad=True), record("odaf", 0, 1.0, log_seed=0),
    ]  # fmt: skip
    text = pointmaze_table.table({}, records)
    assert "| odaf | the preset | 121.5 (0.50) |  |  | 150.0 (0.50) | 2 of 2 | 0 of 3 |" in text
    assert "| mopo | the preset, not searched | 15.0 (0.25) |  |  |  | 0 of 1 | 2 of 2 |" in text
    text = text[text.index("**stitch**") :]
    rows = [line for line in text.splitlines() if line.startswith("| ") and "|---" not in line]
    assert [row.split(" | ")[0] for row in rows[1:4]] == ["| odaf", "| odaf-without-outcome", "| mopo"]
    # Pairs (121, 120), (121, 121), (122, 120), (122, 121): three above, one tie.
    assert "| odaf | the preset | 20,000 | 2 | 121.5 | [115.1, 127.9] | 121.0 | +51.5 | 0.50 | 0.88 [" in text
    assert "| mopo | the preset, not searched | 20,000 | 2 | 15.0 |" in text and "| 0.0 | -55.0 | 0.25 | 0.00" in text
    assert rows[3].endswith("| 77.9 +- 41.9 |") and "**ladder**: 9 rows" in text and len(rows) == 6
    assert "Not measured yet." in pointmaze_table.table({}, [])


def shoved(preset: str, seed: int, earned: float) -> dict[str, Any]:
    found = {name: {"mean_return": earned} for name in pointmaze_outcomes.SHOVES}
    return {**record(preset, seed, None), "measure": "shoved", "found": found}


def test_outcomes_are_told_by_log_and_over_all_mazes() -> None:
    records = []
    for maze, percent, broad, ours in (
        ("stitch", 10, False, 100.0),
        ("shaft", 10, False, 90.0),
        ("stitch", 100, True, 50.0),
    ):
        log = {"maze": maze, "percent": percent, "broad": broad}
        for seed in (0, 1):
            records += [
                record("odaf", seed, ours + seed, **log),
                record("odaf-without-outcome", seed, 80.0, **log),
                record("odaf", seed, 500.0, changes={"return_steps": 3}, **log),
            ]
    records += [shoved("odaf", 0, 60.0), shoved("odaf-without-outcome", 0, 70.0)]
    for one in records[-2:]:
        one["percent"] = 10
    text = pointmaze_outcomes.table({}, records)
    assert "above zero on 2\n(stitch 10 % one, shaft 10 % one), below on 1 (stitch 100 % nine); 0 do not" in text
    assert "| 10 % | one | 4 | +15.5 [" in text and "| -10.0 one seed | -10.0 one seed |" in text
    found = json.loads(pointmaze_outcomes.summary({}, records))
    assert [(cell["maze"], cell["percent"], cell["broad"]) for cell in found["cells"]] == [
        ("stitch", 100, True), ("stitch", 10, False), ("shaft", 10, False),
    ]  # fmt: skip
    assert found["cells"][1]["gain"]["as it is"]["mean"] == pytest.approx(20.5)
    assert found["cells"][1]["methods"]["odaf"]["returns"] == {"0": 100.0, "1": 101.0}
    assert found["all_mazes"][4]["gain"]["shove"] == {"mean": -10.0, "interval": None, "pairs": 1}
    assert "Not measured yet." in pointmaze_outcomes.table({}, [record("odaf", 0, 1.0)])


def test_a_policy_is_shoved_and_paths_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    without_training(monkeypatch)
    log = MazeLog("ladder", 2, repeats=1, episodes=1, broad=True)
    small = Training("td3-bc", Task(log, Evaluation(2, 1), field="maze"), 0, 2, (("hidden_sizes", (4,)),))
    work = pointmaze_outcomes.Shoving(small, shoves=(("shove", 3),), episodes=2)
    made = json.loads(json.dumps(work.do(tmp_path, Silent())))
    found = made["found"]["shove"]
    assert 0.0 < found["mean_return"] < 300.0 and 0.0 <= found["recovered"] <= 1.0 and "stitched_rate" in found
    prints = [made["policy"]["data"][kind] for kind in ("rows_sha256", "sha256") if kind in made["policy"]["data"]]
    known = {small.task.name: {"recipe": log.recipe(), "sha256": prints}}
    assert differences(work.recorded(made, known), work.identity(), work.unrecorded()) == []
    other = pointmaze_outcomes.Shoving(small, shoves=(("shove", 4),), episodes=2)
    assert differences(work.recorded(made, known), other.identity(), work.unrecorded())

    paths = {"places": ["-0.5,0.5 -0.5,-0.5 1.5,-0.5", "-0.5,0.5"], "stitched": [True, False]}
    records = [record("odaf", 0, 110.0, paths=paths), record("iql", 0, 60.0, maze="ladder", paths=paths)]
    pointmaze_table.figure(records, tmp_path / "paths.png")
    assert (tmp_path / "paths.png").read_bytes().startswith(b"\x89PNG")


def test_logs_of_another_seed_breadth_or_part_have_names_and_recipes_of_their_own() -> None:
    logs = [maze_task("stitch", seed, broad, percent).log for seed, broad, percent in (
        (0, False, 100), (2, False, 100), (2, True, 10), (2, False, 30))]  # fmt: skip
    assert [log.name for log in logs] == ["stitch", "stitch-log2", "stitch-log2-broad-10", "stitch-log2-30"]
    assert "drivers" not in logs[1].recipe()["config"] and len(logs[2].recipe()["config"]["drivers"]) == 9
    assert [route["repeats"] for route in logs[3].recipe()["config"]["routes"]] == [75] * 4
    made = training("odaf", (), maze_task("stitch"), 0)
    assert dict(made.notes) == {"map": "stitch", "log_seed": 2, "broad": False, "percent": 100} and made.paths == 10
