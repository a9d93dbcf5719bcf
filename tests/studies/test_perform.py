"""Doing a study: order, dependencies, the time that is given, and going on after a stop."""

import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from odaf.studies import perform as performing
from odaf.studies.cost import Costs
from odaf.studies.executor import Here
from odaf.studies.job import Job, Study
from odaf.studies.ledger import Ledger
from odaf.studies.news import Display, JobReport
from odaf.studies.perform import perform
from studies.test_ledger import TextLog
from studies.toy import job, study


def do(plan: Study, place: Path, jobs: Sequence[Job] | None = None, workers: int = 1, **options: Any) -> str:
    said = io.StringIO()
    ledger = Ledger(plan, place / "out")
    perform(ledger, plan.jobs() if jobs is None else jobs, place, Here(workers), Display("toy", said), **options)
    return said.getvalue()


def order(place: Path) -> list[str]:
    return (place / "order.txt").read_text(encoding="utf-8").split()


def test_jobs_are_done_in_order_and_only_where_no_record_counts(tmp_path: Path) -> None:
    plan = study([job("b"), job("a")], [job("c", "b")])
    said = do(plan, tmp_path)
    assert order(tmp_path) == ["b", "a", "c"]
    assert "toy: 3 of 3 records to go" in said and "[3/3] c: done" in said
    assert (tmp_path / "out" / "table.md").read_text(encoding="utf-8") == "a\nb\nc\n"
    assert "0 of 3 records to go" in do(plan, tmp_path)
    assert order(tmp_path) == ["b", "a", "c"]
    changed = study([job("b"), job("a", version=2)], [job("c", "b")])
    assert "1 of 3" in do(changed, tmp_path)
    assert order(tmp_path) == ["b", "a", "c", "a"]
    (tmp_path / "out" / "c.json").unlink()
    do(plan, tmp_path, plan.jobs()[2:])  # without what it comes after, which was not asked for
    assert order(tmp_path)[-1] == "c"


def test_side_by_side_a_job_waits_for_those_it_comes_after(tmp_path: Path) -> None:
    plan = study([job("slow", seconds=1.0), job("b", "slow"), job("c"), job("d", "c")])
    do(plan, tmp_path, workers=2)
    done = order(tmp_path)
    assert done.index("c") < done.index("d") < done.index("slow") < done.index("b")
    records = [Ledger(plan, tmp_path / "out").record(one) for one in plan.jobs()]
    assert len({record["process"] for record in records if record}) == 2


def test_a_log_is_made_once_before_those_who_need_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr(TextLog, "make", lambda self, path: (made.append(path), path.write_text("x")))

    class File:
        @staticmethod
        def load(path: Path) -> Any:
            prints = {
                "fingerprint": lambda self: f"print of {path.read_text()}",
                "file_fingerprint": lambda self: "file",
            }
            return type("Loaded", (), prints)()

    monkeypatch.setattr("odaf.data.dataset.Dataset", File)
    do(study([job("a"), job("b", source=TextLog()), job("c", source=TextLog())]), tmp_path)
    assert made == [TextLog().file(tmp_path)]
    assert '"print of x"' in (tmp_path / "out" / "data.json").read_text(encoding="utf-8")


def queue(plan: Study, left: float, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is begun, job after job, by a clock on which every job takes what it claims."""
    now = 0.0
    monkeypatch.setattr(performing.time, "monotonic", lambda: now)
    waiting = performing._Queue(plan.jobs(), Costs([]), Path("."), 1, left)
    begun, next_ = [], waiting.ready()
    while next_:
        (one,) = next_
        begun.append(one.name)
        now += waiting.estimates.get(one.name, 0.0)
        next_ = waiting.finished(one, {})
    return begun


def test_what_fits_is_done_first_in_the_order_of_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = study([job("a", claims=10.0), job("long", claims=50.0), job("b", claims=10.0), job("c", claims=10.0)])
    assert queue(plan, 100.0, monkeypatch) == ["a", "long", "b", "c"]
    # 30 seconds: "long" makes room for what fits; then nothing is left.
    assert queue(plan, 30.0, monkeypatch) == ["a", "b", "c"]
    # 35 seconds: when nothing else fits, the rest of the time goes into what is too long.
    assert queue(plan, 35.0, monkeypatch) == ["a", "b", "c", "long"]
    only_long = study([job("first", claims=50.0), job("second", claims=60.0)])
    assert queue(only_long, 5.0, monkeypatch) == ["first"]


def test_a_log_is_not_made_for_what_does_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = study([job("long", claims=50.0, source=TextLog()), job("short", claims=5.0)])
    assert queue(plan, 20.0, monkeypatch) == ["short", "data of words", "long"]


def test_a_slow_machine_is_believed_once_a_job_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(performing.time, "monotonic", lambda: now)
    plan = study([job("a", claims=10.0), job("b", claims=30.0), job("c", claims=20.0)])
    waiting = performing._Queue(plan.jobs(), Costs([]), Path("."), 1, 80.0)
    assert [one.name for one in waiting.ready()] == ["a"]
    now = 20.0  # twice what was estimated, so b takes all of the 60 that are left, or 61 a little later
    assert [one.name for one in waiting.finished(plan.jobs()[0], {})] == ["b"]
    waiting = performing._Queue(plan.jobs(), Costs([]), Path("."), 1, 100.0)
    waiting.ready()
    now = 45.0  # begun at 20: 25 seconds for 10
    assert [one.name for one in waiting.finished(plan.jobs()[0], {})] == ["c"]


def test_the_time_ends_and_the_same_command_goes_on(tmp_path: Path) -> None:
    plan = study([job("quick"), job("slow", seconds=60.0)])
    began = time.monotonic()
    said = do(plan, tmp_path, minutes=4 / 60)
    assert time.monotonic() - began < 30.0
    assert order(tmp_path) == ["quick"]
    assert "the time is over, 1 records are still to go; the same command goes on" in said
    quicker = study([job("quick"), job("slow")])
    assert "1 of 2 records to go" in do(quicker, tmp_path)
    assert order(tmp_path) == ["quick", "slow"]


def test_time_left_is_judged_by_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    now, said = 0.0, io.StringIO()
    monkeypatch.setattr("odaf.studies.news.time.monotonic", lambda: now)
    display = Display("toy", said)
    display.begin(2, 5, {"a": 100.0, "b": 300.0}, 1, None)
    assert said.getvalue() == "toy: 2 of 5 records to go, about 7 min of one core\n"
    now = 40.0
    display.receive(("a", "share", "500 of 1,000 updates", 0.5))
    # A tenth is believed: 50 + 40 by estimate took 40 + 40 seconds, so 350 take 311.
    assert said.getvalue().endswith("toy: a 500 of 1,000 updates; 5 min left\n")
    now = 60.0
    display.finished("a", "12.3 +- 4.5")
    assert said.getvalue().endswith("[1/2] a: 12.3 +- 4.5; 4 min left\n")  # 300 * (60 + 40) / (100 + 40)
    display.finished("b", "1.0")
    assert said.getvalue().endswith("[2/2] b: 1.0\n")


def test_a_slow_model_before_the_updates_says_how_far_it_is_and_does_not_make_hours_into_days(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, said = 0.0, io.StringIO()
    monkeypatch.setattr("odaf.studies.news.time.monotonic", lambda: now)
    display = Display("toy", said)
    display.begin(1, 1, {"a": 4_000.0}, 1, None)
    report = JobReport("a", display.receive)
    report.start("seed 0: behaviour model", 1_000, unit="steps")
    now = 2_000.0
    report.advance(700)
    # Nothing of 4,000 by estimate is done after 2,000 seconds: (2,000 + 400) / 400 times as slow, not without end.
    assert said.getvalue().endswith("toy: a seed 0: behaviour model 700 of 1,000; 6.7 h left\n")
