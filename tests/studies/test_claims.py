"""The studies of the paper's claims: plans, tables, verdicts, the page of a study, and the claims as a whole."""

import json
from pathlib import Path
from typing import Any

import pytest

from odaf.cli.dispatch import main
from odaf.studies import (
    ablation,
    antmaze,
    attacks_table,
    claims,
    knocks_table,
    mixtures,
    mujoco,
    sweeps,
    validation_table,
)
from odaf.studies.final_scores import finals_of, mean_over_tasks
from odaf.studies.ledger import Ledger
from odaf.studies.page import blocks, build
from odaf.studies.pointmaze_methods import MBRCSL, STEPS
from odaf.studies.registry import STUDIES
from odaf.studies.robots import robot_form, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training

NAMES = ("validation", "attacks", "knocks", "ablation", "mixtures", "mujoco", "sweeps")
RESULTS = Path(__file__).parents[2] / "results"


def trained(task: str, method: str, scores: list[float], steps: int = 50_000, **more: Any) -> list[dict[str, Any]]:
    return [
        {
            "task": task, "method": method, "preset": method, "seed": seed, "steps": steps, "changes": {},
            "data": {"transitions": 100_000, "normalised_score": 20.0, "random_percent": 80},
            "final": {"normalised_score": score}, **more,
        }
        for seed, score in enumerate(scores)
    ]  # fmt: skip


def test_every_method_of_every_plan_resolves_and_comes_after_its_training() -> None:
    seen = set()
    for name in NAMES:
        study = STUDIES[name]
        study.jobs()  # no two of one name, none before what it waits for
        assert study.on_files is not None
        for job in study.jobs():
            if isinstance(job.do, Training) and job.do.seed == 0:
                key = (job.do.preset, job.do.setting, job.do.changes, job.do.form, job.do.task.name.split("-")[0])
                if key not in seen:
                    seen.add(key)
                    job.do.learner()
    assert len(seen) > 40


def test_settings_of_a_robot_hold_where_a_task_has_none() -> None:
    task = robot_task("walker2d", "mixture", Evaluation(), percent=90)
    assert task.name == "walker2d-mixture-90" and robot_form("odaf-paper", task) == (("outcome.radius", 0.01),)
    assert (
        robot_form("rebrac-return", task)
        == ()
        == robot_form("odaf-paper", robot_task("hopper", "medium", task.evaluation))
    )
    attack = Training("odaf-paper", robot_task("walker2d", "medium", task.evaluation), 0, 1, setting="attack")
    assert attack.method == "odaf-paper-attack" and attack.learner().terms[0].radius == 0.07


def test_final_scores_are_those_of_the_longest_run_and_a_diverged_one_earns_nothing() -> None:
    records = [
        *trained("a", "m", [1.0, 2.0], steps=10),
        *trained("a", "m", [5.0], steps=20),
        *trained("b", "m", [3.0, 4.0]),
    ]
    records[1]["final"] = None
    assert finals_of(records) == {"a": {"m": {0: 5.0, 1: 0.0}}, "b": {"m": {0: 3.0, 1: 4.0}}}
    assert mean_over_tasks(finals_of(records), "m", ["a", "b"]) == {0: 4.0, 1: 2.0}
    assert mean_over_tasks(finals_of(records), "m", ["a", "c"]) == {}


def test_the_ablation_says_what_the_term_adds_on_each_base() -> None:
    records = []
    for task in (*ablation.first_tasks(), *ablation.nine_tasks()):
        records += trained(task.name, "odaf-paper", [30.0, 31.0, 32.0])
        records += trained(task.name, "odaf-paper-without-outcome", [20.0, 21.5, 21.8])
    assert ablation.verdict(records).verdict == "held"
    assert ablation.verdict(records[6:]).verdict == "not decided"
    assert ablation.ours(records).verdict == "not decided"
    table = ablation.table(records)
    assert "| hopper-mixture-80 | 3 | 31.0 | 21.1 | +9.9 | [+9.0, +10.8] |" in table and "P(gain > 0) 1.00" in table
    worse = [{**one, "final": dict(one["final"])} for one in records]
    for one in worse:
        if (one["task"], one["method"]) == ("hopper-medium", "odaf-paper"):
            one["final"]["normalised_score"] -= 20.0
    found = ablation.verdict(worse)
    assert found.verdict == "not held" and found.part.startswith("hopper-medium: loses less than 5")


def test_mixtures_ask_for_a_higher_mean_and_a_smaller_fall_over_all_shares() -> None:
    records = []
    for robot in ("hopper", "halfcheetah", "walker2d"):
        for place, share in enumerate(mixtures.SHARES):
            records += trained(f"{robot}-mixture-{share}", "odaf-paper", [90.0 - place, 91.0 - place])
            for rival in mixtures.RIVALS:
                records += trained(f"{robot}-mixture-{share}", rival, [60.0 - 9 * place, 60.5 - 9.1 * place])
    assert mixtures.verdict(records).verdict == "held"
    fewer = [one for one in records if not one["task"].endswith("-60")]
    found = mixtures.verdict(fewer)
    assert found.verdict == "not decided" and "4 of 5 shares are measured with both" in found.reasons[0]
    # Means over seeds 90.5, 89.5, ..., 86.5: slope -1 for ten per cent, mean 88.5, fall 4.
    row = "| odaf-paper | 90.5 | 89.5 | 88.5 | 87.5 | 86.5 | -1.0 | 88.5 | 4.0 | 2 |"
    assert "**hopper**, 100,000 rows." in mixtures.table(records) and row in mixtures.table(records)
    public = [{**one, "data": {**one["data"], "transitions": 999_000}} for one in records]  # of the same names
    assert "**hopper**, 999,000 rows." in mixtures.table(public) and row in mixtures.table(public)
    long = [{**one, "task": f"{one['task']}-1000k"} for one in public]
    assert mixtures.table([*records, *long]).count(row) == 6


def test_the_table_of_fifteen_logs_has_the_papers_scores_beside_ours() -> None:
    records = [*trained("hopper-medium", "svr", [50.0, 52.0]), *trained("hopper-medium", "odaf-paper", [3.0, 4.0])]
    assert "| hopper-medium | 51.0 (103.5) | 3.5 (106.3) | 106.3 |" in mujoco.table(records)
    found = mujoco.verdict(records)
    assert found.verdict == "not decided" and "1 of 15 logs are measured with both" in " ".join(found.reasons)
    whole = [record for task in mujoco.SETS for record in trained(task, "odaf-paper", [60.0, 61.0])]
    whole += [
        record for task in mujoco.SETS for rival in mujoco.RIVALS for record in trained(task, rival, [50.0, 50.5])
    ]
    assert mujoco.verdict(whole).verdict == "held"
    two = [record for record in whole if record["method"] in ("odaf-paper", "svr")]
    assert "- odaf-paper over svr: 1.00 [1.00, 1.00], 15 logs" in mujoco.table(two)
    assert mujoco.verdict([*whole, *trained("hopper-medium", "svr", [250.0, 260.0])]).verdict == "not decided"


def test_sweeps_are_compared_with_the_preset_as_it_is() -> None:
    records = [
        *trained("hopper-medium", sweeps.PRESET, [50.0, 60.0], sweep="none"),
        *trained("hopper-medium", f"{sweeps.PRESET}-num_critics-2", [40.0, 52.0], sweep="critics"),
    ]
    for one in records[2:]:
        one["changes"] = {"num_critics": 2}
    assert "| critics | num_critics 2 | 2 | 46.0 | [-30.2, 122.2] | -9.0 | [-21.7, +3.7] |" in sweeps.table(records)


def attacked(task: str, method: str, clean: float, areas: list[float]) -> list[dict[str, Any]]:
    return [
        {
            "measure": "attacked", "task": task, "method": method, "seed": seed,
            "policy": {"data": {"normalised_score": 40.0}},
            "found": {"attack": attack, "budgets": [0.0, 0.3], "scores": [clean, 2 * area - clean], "area": area},
        }
        for attack in attacks_table.ATTACKS
        for seed, area in enumerate(areas)
    ]  # fmt: skip


def test_a_victim_below_its_log_is_not_decided_whatever_its_area() -> None:
    def records(clean: float) -> list[dict[str, Any]]:
        found = []
        for robot in ("hopper", "halfcheetah", "walker2d"):
            found += attacked(f"{robot}-medium", attacks_table.PAPER, 60.0, [50.0, 51.0, 52.0])
            for rival in attacks_table.RIVALS:
                found += attacked(f"{robot}-medium", rival, clean, [20.0, 20.4, 22.0])
        return found

    assert attacks_table.verdict(records(clean=45.0)).verdict == "held"
    found = attacks_table.verdict(records(clean=35.0))
    assert found.verdict == "not decided" and "below its log's mean 40.0" in found.reasons[0] and found.enough is None
    lost = [{**one, "found": None} if one["seed"] == 2 else one for one in records(clean=45.0)]
    found = attacks_table.verdict(lost)
    assert found.verdict == "not decided" and "1 of 3 seeds diverged" in found.reasons[0]


def knocked(task: str, method: str, clean: float, beyond: list[float | None]) -> list[dict[str, Any]]:
    levels = {"none": {"score": clean}, "large": {"score": clean - 10}}
    return [
        {
            "measure": "knocked", "task": task, "method": method, "seed": seed,
            "policy": {"data": {"normalised_score": 40.0}},
            "identity": {"settings": {"at": 500, "levels": {"none": 0, "large": 15}}},
            "found": {"levels": levels, "starts": {}, "after": None if share is None else {
                "beyond": share, "recovered": 1.0, "median_recovery": 3.0}},
        }
        for seed, share in enumerate(beyond)
    ]  # fmt: skip


def test_knocked_policies_must_come_back_on_two_robots_of_three() -> None:
    records = []
    for robot in ("hopper", "halfcheetah"):
        records += knocked(f"{robot}-medium-expert", "odaf-paper", 60.0, [0.1, 0.12, 0.11])
        records += knocked(f"{robot}-medium-expert", "odaf-paper-without-outcome", 60.0, [0.5, 0.51, 0.55])
    assert knocks_table.verdict(records).verdict == "held"
    lost = knocks_table.verdict([{**one, "found": None} if one["seed"] == 2 else one for one in records])
    assert lost.verdict == "not decided" and "1 of 3 seeds diverged" in lost.reasons[0]
    fallen = [*records[:6], *knocked("halfcheetah-medium-expert", "odaf-paper", 60.0, [None, None])]
    found = knocks_table.verdict(fallen)
    assert found.verdict == "not decided" and "no episode lasted until the knock" in " ".join(found.reasons)
    assert "| halfcheetah-medium-expert | 500 | odaf-paper | 2 | 60.0 | 50.0 | fell before |" in knocks_table.table(
        fallen
    )


def asked(task: str, true: float, model: float, r_squared: float = 0.95) -> list[dict[str, Any]]:
    def one(area: float, gap: float) -> dict[str, Any]:
        return {"auroc": area, "gap": gap, "safe": {"mean": 1.0}, "unsafe": {"mean": 1.0 + gap}}

    return [
        {
            "measure": "outcomes", "task": task, "method": "odaf", "seed": seed,
            "found": {
                "inverse_r_squared": r_squared, "others": {"clone": 0.9}, "unseen": {"share": 0.1, "auroc": 0.9},
                "models": {"cvae": {"normalised_rmse": 0.1}}, "rank_correlation": {"cvae": 0.8},
                "dynamics": {
                    "simulator": one(true + seed / 1000, 2.0),
                    "cvae": one(model + seed / 1000, 1.6 + seed / 100),
                    "deterministic": one(model, 1.0),
                },
            },
        }
        for seed in range(3)
    ]  # fmt: skip


def test_validation_asks_for_both_areas_the_gap_and_a_blind_control() -> None:
    def records(true: float, control: float = 0.5, r_squared: float = 0.95) -> list[dict[str, Any]]:
        return [
            record
            for robot in ("hopper", "halfcheetah", "walker2d")
            for record in (
                *asked(f"{robot}-medium", true, 0.85, r_squared),
                *asked(f"{robot}-random", control, control),
            )
        ]

    assert validation_table.verdict(records(0.9)).verdict == "held"
    assert validation_table.verdict(records(0.7)).verdict == "not held"
    assert validation_table.verdict(records(0.9, control=0.9)).verdict == "not held"
    weak = validation_table.verdict(records(0.9, r_squared=0.8))
    assert weak.verdict == "not decided" and "R2 is 0.80" in weak.reasons[0]
    lost = validation_table.verdict([{**one, "found": None} if one["seed"] == 0 else one for one in records(0.9)])
    assert lost.verdict == "not decided" and "1 of 3 seeds diverged" in lost.reasons[0]
    assert "| hopper-medium | odaf | 3 | 0.90 | 0.85 | 0.85 | 0.81 |" in validation_table.table(records(0.9))


def test_the_claims_are_those_that_the_ledgers_bear_out() -> None:
    answers = claims.decided(RESULTS)
    found = {name: answer.verdict for name, answer in answers.items()}
    written = json.loads((RESULTS / "claims.json").read_text(encoding="utf-8"))
    assert {"mujoco", "mixtures", "stitching", "attacks", "validation"} < set(found)
    assert {"ablation", "knocks", "theory", "antmaze", "cost"} < set(found) and len(found) == 10
    assert {each.verdict for each in found.values()} <= {"held", "not held", "not decided"}
    assert found["antmaze"].verdict == "not decided" and len(found["antmaze"].reasons) == len(antmaze.RIVALS)
    assert found["stitching"].reasons[0].startswith("odaf-paper over the best logged return in the stitching maze")
    assert written["stitching"]["ours"]["verdict"] == "held"
    theory = found["theory"]
    assert theory.verdict == "not held" and "hold" in theory.reasons[-1]
    assert {name: each["verdict"] for name, each in written.items()} == {n: each.verdict for n, each in found.items()}
    assert all({"verdict", "test", "seeds", "interval", "command"} <= set(each) for each in written.values())
    page = RESULTS.parent / "docs" / "claims.md"
    drawn = claims.markdown(answers, RESULTS, page.parent)
    assert page.read_text(encoding="utf-8") == drawn, "draw it again with `odaf claims`"


def test_the_ant_mazes_are_won_set_by_set_against_every_rival() -> None:
    def one(method: str, task: str, seed: int, success: float | None) -> dict[str, Any]:
        return {"method": method, "task": task, "seed": seed, "final": success and {"normalised_score": success}}

    tasks = [f"set-{number}" for number in range(6)]
    ours = [one("odaf-paper", task, seed, 80.0 + place) for place, task in enumerate(tasks) for seed in (0, 1)]
    rivals = [one(name, task, 0, 60.0 - place) for name in antmaze.RIVALS for place, task in enumerate(tasks)]
    assert claims.ant_mazes(ours + rivals).verdict == "held"
    better = [{**each, "final": {"normalised_score": 99.0}} if each["method"] == "iql" else each for each in rivals]
    assert claims.ant_mazes(ours + better).verdict == "not held"
    lost = [{**each, "final": None} if each["seed"] == 1 else each for each in ours]  # 40 on average
    assert claims.ant_mazes(lost + rivals).verdict == "not held"
    assert claims.ant_mazes(ours + rivals[:-6]).verdict == "not decided"


def test_a_maze_policy_that_diverged_earned_nothing() -> None:
    def one(seed: int, earned: float | None) -> dict[str, Any]:
        final = None if earned is None else {"mean_return": earned}
        return {
            "maze": "stitch", "method": "odaf-paper", "preset": "odaf-paper", "changes": {}, "steps": STEPS,
            "seed": seed, "final": final, "data": {"best_return": 70.0}, "seconds": {"total": 9.0},
        }  # fmt: skip

    assert claims.stitching([one(0, 110.0), one(1, 112.0)]).verdict == "held"
    found = claims.stitching([one(0, 110.0), one(1, 112.0), one(2, None)])
    assert found.verdict == "not decided" and found.seeds == 3


def test_cost_is_decided_by_what_the_stitching_study_plans() -> None:
    records = []
    for job in STUDIES["pointmaze"].jobs():
        work = job.do
        if isinstance(work, Training) and work.preset in (MBRCSL, "odaf-paper") and work.seed < 2:
            seconds = {MBRCSL: 900.0, "odaf-paper": 500.0}[work.preset] + 10.0 * work.seed
            records.append(
                {"maze": work.task.name, **dict(work.notes), "method": work.method, "preset": work.preset,
                 "changes": {}, "steps": work.steps, "seed": work.seed, "final": {"mean_return": 80.0 + work.seed},
                 "data": {"best_return": 70.0}, "seconds": {"total": seconds}}
            )  # fmt: skip
    found = claims.cost(records)
    assert found.verdict == "held" and found.seeds == 2 and "mbrcsl-pointmaze over odaf-paper" in found.part
    assert claims.cost([one for one in records if one["preset"] != MBRCSL]).verdict == "not decided"
    assert claims.cost([{**one, "lanes": 4} for one in records]).verdict == "not decided"  # they share their time


def test_without_records_nothing_is_decided(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["claims", "--results", str(tmp_path / "results"), "--page", str(tmp_path / "claims.md")]) in (0, None)
    written = json.loads((tmp_path / "results" / "claims.json").read_text(encoding="utf-8"))
    assert {each["verdict"] for each in written.values()} == {"not decided"}
    assert "| [knocks](#knocks) |" in (tmp_path / "claims.md").read_text(encoding="utf-8")
    assert "not decided" in capsys.readouterr().out


def test_a_study_has_a_page_of_its_own(tmp_path: Path) -> None:
    ledger = Ledger(STUDIES["theory"], RESULTS / "theory")
    assert build(ledger, tmp_path / "theory.html", "odaf reproduce theory") == "decides no claim"
    page = (tmp_path / "theory.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page and "<td>E1</td>" in page and "odaf reproduce theory" in page


def test_tables_in_markdown_become_blocks() -> None:
    found = list(blocks("one\n**two**\n\n| a | b |\n|---|---|\n| `1` | 2 |\n\n- x\n- y\n"))
    assert [(each.kind, each.lines) for each in found] == [
        ("text", ("one two",)), ("table", ("a\tb", "1\t2")), ("list", ("x", "y")),
    ]  # fmt: skip
    assert found[1].rows == [["a", "b"], ["1", "2"]]
