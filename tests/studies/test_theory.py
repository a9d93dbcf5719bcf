"""The theory study in small: from the experiments to its ledger, its tables and its figure."""

import json
from pathlib import Path

from odaf.studies import theory
from odaf.studies.executor import Here
from odaf.studies.job import Job, Phase, Study, chosen
from odaf.studies.ledger import Ledger
from odaf.studies.news import Display
from odaf.studies.perform import perform
from odaf.theory.experiments import Equivalence, ErrorBound, Trap

SMALL = (ErrorBound(problems=1, draws=4, sizes=(10**3, 10**5), k=100), Equivalence(problems=50), Trap())


def small_study(*experiments: object) -> Study:
    jobs = tuple(Job(each.name, theory.Testing(each)) for each in experiments or SMALL)  # type: ignore[attr-defined]
    return Study("theory", "small", lambda: [Phase("all", jobs)], theory.STUDY.tables)


def test_a_small_study_from_experiments_to_tables(tmp_path: Path):
    ledger = Ledger(small_study(), tmp_path / "out")
    jobs = ledger.study.jobs()
    perform(ledger, jobs[:1], tmp_path / "work", Here(), Display("theory"))
    first = ledger.path(jobs[0]).read_bytes()
    perform(ledger, jobs, tmp_path / "work", Here(), Display("theory"))
    assert ledger.path(jobs[0]).read_bytes() == first  # what is held is not measured again
    assert [ledger.standing(job).state for job in jobs] == ["held"] * 3

    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert list(summary) == ["error-bound", "equivalence", "trap"]  # as on the page, not by name
    assert all(each["passed"] is True and each["corrected"]["verdict"] == "held" for each in summary.values())
    assert summary["equivalence"]["printed"]["verdict"] == "not held" and summary["trap"]["printed"]["verdict"] == "-"
    assert summary["equivalence"]["seed"] == 6 and summary["equivalence"]["repetitions"] == {"problems": 50}
    assert {"of", "what", "figure", "criterion", "verdict"} == set(summary["trap"]["checks"][0])
    table = (tmp_path / "out" / "table.md").read_text()
    assert "| E3 | equivalence | held | not held | 50 problems |" in table
    assert "| corrected | moves to the goal by outcomes in the data | 8 | 8, the shortest path | held |" in table

    other = Ledger(small_study(Equivalence(problems=51)), tmp_path / "out")
    standing = other.standing(other.study.jobs()[0])
    assert standing.state == "stale" and standing.differences == ("settings.problems was 50, is 51",)


def test_a_part_can_be_asked_for_by_label_or_name():
    assert [job.name for job in chosen(theory.STUDY, only=["E2"])] == ["error-bound", "rare-action"]
    assert [job.name for job in chosen(theory.STUDY, only=["trap", "E6"])] == ["trap", "coverage"]


def test_one_failed_check_decides_and_nothing_said_is_said():
    checks = [{"of": "corrected", "verdict": verdict} for verdict in ("held", "says nothing")]
    assert theory.verdicts({"checks": checks}) == {"corrected": "held", "printed": "-"}
    checks += [{"of": "corrected", "verdict": "not held"}, {"of": "printed", "verdict": "says nothing"}]
    assert theory.verdicts({"checks": checks}) == {"corrected": "not held", "printed": "says nothing"}
    assert theory.table([]).endswith("|---|---|---|---|---|\n")


def test_the_figure_needs_the_bound_and_the_trap(tmp_path: Path):
    records = [{"name": each.name, "details": each.measure().details} for each in (SMALL[0], SMALL[2])]
    theory.figure(records[:1], tmp_path / "figure.png")
    assert not (tmp_path / "figure.png").exists()
    theory.figure(records, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
