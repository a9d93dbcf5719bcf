"""The ledgers that come with the code: every record counts today, and the tables are drawn from them byte for byte."""

from pathlib import Path

import pytest

from odaf.studies.ledger import Ledger, stale
from odaf.studies.registry import STUDIES

RESULTS = Path(__file__).parents[2] / "results"


@pytest.mark.parametrize("name", STUDIES)
def test_tables_are_redrawn_byte_for_byte(name: str) -> None:
    study, out = STUDIES[name].among(RESULTS), RESULTS / name
    ledger = Ledger(study, out)
    standings = [ledger.standing(job) for job in study.jobs()]
    assert stale(standings) == []
    if not out.exists():
        pytest.skip("not measured yet")
    records = ledger.held()
    assert records
    written = {path.stem for path in out.glob("*.json")} - {"data", *(Path(file).stem for file in study.tables)}
    assert written == {
        one.job.name for one in standings if one.state == "held"
    }  # nothing lies there that no plan names
    for file, table in study.tables.items():
        assert table(records) == (out / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["pointmaze", "outcome", "locomotion", "rivals"])
def test_the_logs_of_every_ledger_are_known(name: str) -> None:
    ledger = Ledger(STUDIES[name].among(RESULTS), RESULTS / name)
    jobs = [job for job in ledger.study.jobs() if ledger.standing(job).state == "held"]
    logs = {job.do.log.name: job.do.log for job in jobs if job.do.log is not None}
    assert (RESULTS / name / "data.json").exists() and logs
    assert {log: ledger.data[log]["recipe"] for log in logs} == {name: log.recipe() for name, log in logs.items()}
