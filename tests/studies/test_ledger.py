"""The ledger: which records count, the logs they stand on, and what it refuses to keep."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from odaf.errors import ConfigError
from odaf.studies.job import Job, Log
from odaf.studies.ledger import Ledger, count, stale
from studies.toy import Count, job, study


@dataclass(frozen=True)
class TextLog(Log):
    """A log that is a word."""

    word: str = "rows"
    version: int = 1

    @property
    def name(self) -> str:
        return "words"

    def recipe(self) -> dict[str, Any]:
        return {"version": self.version}

    def make(self, path: Path) -> None:
        path.write_text(self.word, encoding="utf-8")


def record(name: str, version: int = 1, rate: float = 1.0) -> dict[str, Any]:
    return {"name": name, "identity": {"version": version, "rate": rate}, "seconds": 2.0}


def test_a_record_counts_if_it_says_what_would_be_measured_today(tmp_path: Path) -> None:
    plan = study([job("a"), job("b"), job("c", version=2, rate=3.0), job("d")])
    ledger = Ledger(plan, tmp_path / "out")
    for name in "abc":
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / f"{name}.json").write_text(json.dumps(record(name)), encoding="utf-8")
    standings = [ledger.standing(one) for one in plan.jobs()]
    assert [one.state for one in standings] == ["held", "held", "stale", "missing"]
    assert standings[2].differences == ("version was 1, is 2", "rate was 1.0, is 3.0")
    assert count(standings) == {"held": 2, "stale": 1, "missing": 1}
    assert stale(standings) == ["c: version was 1, is 2; rate was 1.0, is 3.0"]
    assert stale(standings, most=1) == ["c: version was 1, is 2; and 1 more"]
    ledger.draw()
    assert (tmp_path / "out" / "table.md").read_text(encoding="utf-8") == "a\nb\n"  # the stale one is in no table


def test_a_damaged_record_is_named(tmp_path: Path) -> None:
    plan = study([job("a")])
    (tmp_path / "a.json").write_text('{"name": ', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"a\.json: cannot be read as JSON .* remove the file"):
        Ledger(plan, tmp_path).standing(plan.jobs()[0])
    (tmp_path / "a.json").write_text("[1]", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"a\.json: holds list"):
        Ledger(plan, tmp_path).standing(plan.jobs()[0])


def test_what_was_measured_is_kept_only_if_it_is_what_was_asked_for(tmp_path: Path) -> None:
    plan = study([job("a", version=2)])
    ledger, (one,) = Ledger(plan, tmp_path), plan.jobs()
    with pytest.raises(ConfigError, match="not what was asked for: version was 1, is 2"):
        ledger.write(one, record("a"))
    assert not ledger.path(one).exists()
    written = ledger.write(one, record("a", version=2))
    assert written == json.loads(ledger.path(one).read_text(encoding="utf-8"))
    assert (written["study"], written["command"]) == ("toy", "odaf reproduce toy")
    assert ledger.standing(one).state == "held"


@dataclass(frozen=True)
class Reader(Count):
    """A work whose record names the fingerprint of its log, as trainings do."""

    def identity(self) -> dict[str, Any]:
        assert self.source is not None
        return {"print": "known", "recipe": self.source.recipe()}

    def recorded(self, record: Any, data: Any) -> dict[str, Any]:
        entry = data["words"]
        return {"print": "known" if record["data"]["sha256"] in entry["sha256"] else "-", "recipe": entry["recipe"]}


def test_records_stand_on_the_rows_that_are_made_today(tmp_path: Path) -> None:
    def ledger_of(version: int) -> tuple[Ledger, Job]:
        plan = study([Job("a", Reader("a", source=TextLog(version=version)))])
        return Ledger(plan, tmp_path), plan.jobs()[0]

    (tmp_path / "a.json").write_text('{"data": {"sha256": "old"}}', encoding="utf-8")
    ledger, one = ledger_of(1)
    assert ledger.standing(one).state == "held"  # a ledger without data.json is believed
    with pytest.raises(ConfigError, match="stand on data with the fingerprint old; those made here have new,.*--out"):
        ledger.note_log(TextLog(), ["new"])
    assert not (tmp_path / "data.json").exists()
    ledger.note_log(TextLog(), ["rows", "old"])
    assert json.loads((tmp_path / "data.json").read_text()) == {
        "words": {"recipe": {"version": 1}, "sha256": ["old", "rows"]}
    }

    (tmp_path / "a.json").write_text('{"data": {"sha256": "other"}}', encoding="utf-8")
    ledger, one = ledger_of(1)
    assert ledger.standing(one).differences == ("print was '-', is 'known'",)

    (tmp_path / "a.json").write_text('{"data": {"sha256": "old"}}', encoding="utf-8")
    ledger, one = ledger_of(2)  # the log is made in another way now
    assert ledger.standing(one).differences == ("recipe.version was 1, is 2",)
    ledger.note_log(TextLog(version=2), ["new"])
    assert ledger.standing(one).state == "stale"
    assert TextLog(version=2).file(tmp_path) != TextLog(version=1).file(tmp_path)
