"""The stitching study: records, table, and going on after a stop; small runs of the method that compiles soonest."""

import json
from pathlib import Path

import pytest

from odaf.environments import stitch_data
from odaf.studies import pointmaze as pointmaze_study
from odaf.studies.ledger import StudyRun


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"stitch": stitch_data.CONFIGS["stitch"].with_repeats(2)}
    short = StudyRun("behaviour-cloning", "stitch", 0, 4)
    other = StudyRun("behaviour-cloning", "stitch", 1, 4)
    longer = StudyRun("behaviour-cloning", "stitch", 0, 6)
    monkeypatch.setattr(stitch_data, "CONFIGS", few)
    monkeypatch.setattr(pointmaze_study, "plan", lambda: [[short, other], [longer]])
    monkeypatch.setattr(pointmaze_study, "EPISODES", 2)


@pytest.mark.usefixtures("small")
def test_records_table_and_continuation(tmp_path: Path) -> None:
    out, work = tmp_path / "results", tmp_path / "work"
    pointmaze_study.run(out, work=work)
    names = sorted(path.name for path in out.glob("*.json"))
    assert names == [f"stitch-behaviour-cloning-seed{s}-{n}.json" for s, n in ((0, 4), (0, 6), (1, 4))]
    record = json.loads((out / names[0]).read_text(encoding="utf-8"))
    assert record["final"]["step"] == 4
    assert record["data"]["origin"] == "locally generated data"
    assert str(tmp_path) not in json.dumps(record)  # a ledger names no folder of the machine
    assert json.loads((out / names[1]).read_text(encoding="utf-8"))["final"]["step"] == 6
    assert (out / "figure.png").read_bytes().startswith(b"\x89PNG")

    returns = [json.loads((out / names[i]).read_text(encoding="utf-8"))["final"]["mean_return"] for i in (0, 2)]
    row = next(line for line in (out / "table.md").read_text(encoding="utf-8").splitlines() if "| 4 | 2 |" in line)
    assert f"| {sum(returns) / 2:.1f} |" in row
    assert f"| {min(returns):.1f} |" in row

    stamps = {path: path.stat().st_mtime_ns for path in out.glob("*.json")}
    (out / names[2]).unlink()  # its run directory is complete: the record is written again without training
    pointmaze_study.run(out, work=work)
    assert json.loads((out / names[2]).read_text(encoding="utf-8"))["final"]["mean_return"] == returns[1]
    assert {path: path.stat().st_mtime_ns for path in stamps if path.name != names[2]} == {
        path: stamp for path, stamp in stamps.items() if path.name != names[2]
    }


def test_plan_continues_only_what_an_earlier_phase_made() -> None:
    done: dict[tuple[str, str, int], int] = {}
    for phase in pointmaze_study.plan():
        keys = [(run.method, run.task, run.seed) for run in phase]
        assert len(set(keys)) == len(keys)  # two runs of a phase may be under way at once
        for run, key in zip(phase, keys, strict=True):
            assert run.steps > done.get(key, 0)
            done[key] = run.steps
