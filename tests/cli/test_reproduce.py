"""`odaf reproduce`: the list, a part of a study, the budget, and what is refused."""

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from odaf.cli.dispatch import main
from odaf.studies.executor import Here
from odaf.studies.registry import STUDIES

RESULTS = Path(__file__).parents[2] / "results"
JOBS = str(len(STUDIES["pointmaze"].jobs()))


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory with two records of one study."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results" / "pointmaze").mkdir(parents=True)
    for name in ("stitch-odaf-seed0-20000", "stitch-odaf-seed1-20000"):
        shutil.copy(RESULTS / "pointmaze" / f"{name}.json", tmp_path / "results" / "pointmaze")


def test_without_a_study_they_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce"]) == 0
    out = capsys.readouterr().out
    assert all(f"{name}: {study.summary}" in out for name, study in STUDIES.items())


def test_help_is_read_from_the_study(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "outcome", "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "2: the maze, four critics" in out and "task: stitch, hopper-medium" in out
    assert "all" not in STUDIES and "before any second seed" in out


def rows(text: str) -> dict[str, list[str]]:
    return {line.split("  ")[0]: line.split() for line in text.splitlines()}


def test_the_list_says_what_is_held_and_what_it_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    held = tmp_path / "results" / "pointmaze" / "stitch-odaf-seed1-20000.json"
    record = json.loads(held.read_text())
    record["algorithm"]["discount"] = 0.5
    held.write_text(json.dumps(record))
    assert main(["reproduce", "--list"]) == 0
    out = capsys.readouterr().out
    assert rows(out)["pointmaze"][1:5] == ["1", "of", JOBS, "1"]
    assert rows(out)["outcome"][1:5] == ["0", "of", "55", "0"]
    assert "results/pointmaze/stitch-odaf-seed1-20000: learner.discount was 0.5, is 0.99" in out

    assert main(["reproduce", "pointmaze", "--list"]) == 0
    out = capsys.readouterr().out
    assert "1  the stitching maze, two seeds" in out and rows(out)["in all"][2:6] == ["1", "of", JOBS, "1"]
    assert main(["reproduce", "pointmaze", "--list", "--only", "odaf-return_steps-5", "--phase", "14"]) == 0
    out = capsys.readouterr().out
    assert rows(out)["the part asked for"][4:7] == ["0", "of", "6"]
    assert "shaft-odaf-return_steps-5-seed0-20000, stitch-odaf-return_steps-5-seed1-20000" in out
    seconds = json.loads((RESULTS / "pointmaze" / "stitch-odaf-seed0-20000.json").read_text())["seconds"]["total"]
    assert main(["reproduce", "pointmaze", "--list", "--only", "odaf", "--phase", "12"]) == 0
    assert f"{round(4 * seconds / 60)} min" in capsys.readouterr().out or seconds > 1350  # about the one that counts


def test_a_part_and_a_budget_reach_the_schedule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[Any, ...]] = []

    def perform(ledger: Any, jobs: Any, place: Any, executor: Any, display: Any, **options: Any) -> None:
        calls.append((ledger, jobs, place, executor, options))

    monkeypatch.setattr("odaf.studies.perform.perform", perform)
    words = ["--only", "edac", "sac-n", "--phase", "2", "--workers", "2", "--minutes", "7.5", "--work", "here"]
    assert main(["reproduce", "locomotion", *words]) == 0
    ((ledger, jobs, place, executor, options),) = calls
    assert (ledger.out, place, executor) == (Path("results/locomotion"), Path("here"), Here(2))
    assert {job.do.preset for job in jobs} == {"edac", "sac-n"} and options["minutes"] == 7.5
    assert main(["reproduce", "locomotion", "--out", "there"]) == 0
    assert calls[-1][0].out == Path("there") and calls[-1][2] == Path("runs/locomotion")
    assert len(calls[-1][1]) == len(STUDIES["locomotion"].jobs())

    monkeypatch.setattr("odaf.studies.on_ray.joined", lambda address: contextlib.nullcontext(f"cluster at {address}"))
    assert main(["reproduce", "locomotion", "--ray", "host:1", "--work", "here"]) == 0
    assert calls[-1][2:4] == (tmp_path / "here", "cluster at host:1")  # a place that means the same elsewhere


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["pointmase"], "there is no study 'pointmase'; did you mean pointmaze?"),
        (["pointmaze", "--phase", "18"], "--phase 18: pointmaze has phases 1 to 17"),
        (["pointmaze", "--only", "edac"], "--only edac: is not part of pointmaze; known are bear, behaviour-cloning"),
        (["pointmaze", "--minutes", "0"], "--minutes 0: must be more than 0"),
        (["pointmaze", "--workers", "0"], "--workers 0: must be at least 1"),
        (["pointmaze", "--ray", "local", "--workers", "2"], "--workers: with --ray there are as many jobs"),
        (["pointmaze", "--ray", "auto", "--lanes"], "--lanes: trains in this process, and --ray on a cluster"),
        (["--list", "--phase", "1"], "--list: name a study first"),
        (["--minutes", "3"], "name a study first"),
    ],
)
def test_what_is_refused(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", *words]) == 2
    assert says in capsys.readouterr().err


def test_the_list_and_the_help_load_no_simulator(capsys: pytest.CaptureFixture[str]) -> None:
    import subprocess
    import sys

    code = (
        "import sys; from odaf.cli.dispatch import main\n"
        "main(['reproduce']); main(['reproduce', 'locomotion', '--help'])\n"
        "assert not {'jax', 'mujoco', 'gymnasium'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize("in_time", [True, False])
def test_lanes_come_first_and_what_they_did_not_end_is_left_to_them(tmp_path, monkeypatch, in_time: bool) -> None:
    measured: list[tuple[list[str], str | None]] = []
    kept: list[int] = []
    words = ["reproduce", "pointmaze", "--only", "behaviour-cloning", "stitch", "--lanes", "--minutes", "4"]
    jobs = [f"stitch-behaviour-cloning-seed{seed}-20000" for seed in range(4)]

    def perform(ledger: Any, some: Any, *others: Any, minutes: float, **more: Any) -> None:
        assert 0.0 < minutes <= 4.0
        measured.append(([job.name for job in some], os.environ.get("JAX_PLATFORMS")))

    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setattr("odaf.studies.perform.perform", perform)
    monkeypatch.setattr("odaf.studies.lanes.train_together", lambda *given, **more: in_time)
    monkeypatch.setattr("odaf.studies.lanes.at_its_end", lambda job, place: job.name != jobs[1])
    monkeypatch.setattr("odaf.studies.lanes.keep_actors", lambda ledger, some, place: kept.append(len(some)))
    out = ["--out", str(tmp_path / "out"), "--ledger", str(tmp_path / "carried"), "--work", str(tmp_path / "work")]
    assert main([*words, *out]) == 0
    ended = [name for name in jobs if name != jobs[1]]
    assert measured == [(ended, "cpu"), ([jobs[1]], None)][: 2 if in_time else 1] and kept == [4]
