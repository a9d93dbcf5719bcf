"""The work of training: its record, going on after a stop, longer runs; small runs of what compiles soonest."""

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from odaf.environments import locomotion_data, stitch_data
from odaf.errors import DivergenceError
from odaf.evaluation.rollouts import RolloutEvaluator
from odaf.runs import fit as fitting
from odaf.studies.executor import Here
from odaf.studies.job import PRINTS, Study, prints_of
from odaf.studies.ledger import Ledger
from odaf.studies.logs import MazeLog, RecordedLog
from odaf.studies.news import Display
from odaf.studies.perform import perform
from odaf.studies.pointmaze_first import figure, table
from odaf.studies.registry import STUDIES
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of
from odaf.training.progress import Silent

MAZE = Task(MazeLog("stitch", repeats=2, episodes=2), Evaluation(every=2, episodes=2), field="maze")
HOPPER = Task(
    RecordedLog("hopper-medium", transitions=1_500),
    Evaluation(every=2, episodes=1, final_episodes=2),
    score="normalised_score",
    common=(("hidden_sizes", (8,)),),
)


def cloning(task: Task, seed: int, steps: int) -> Training:
    return Training("behaviour-cloning", task, seed, steps, checkpoint_every=2, paths=1 if task is MAZE else 0)


def measure(runs: list[list[Training]], out: Path, work: Path) -> Ledger:
    plan = phases_of(*((f"part {number}", part) for number, part in enumerate(runs)))
    drawn = ({"table.md": table}, {"figure.png": figure}) if runs[0][0].task is MAZE else ({}, {})
    study = Study("pointmaze", "small", lambda: plan, *drawn)
    ledger = Ledger(study, out)
    perform(ledger, study.jobs(), work, Here(), Display("small", io.StringIO()))
    return ledger


def read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def test_records_in_a_maze_and_a_longer_run(tmp_path: Path) -> None:
    out, work = tmp_path / "results", tmp_path / "work"
    short, other, longer = cloning(MAZE, 0, 4), cloning(MAZE, 1, 4), cloning(MAZE, 0, 6)
    measure([[short, other], [longer]], out, work)
    assert sorted(path.stem for path in out.glob("*.json")) == ["data", *sorted(t.name for t in (short, other, longer))]
    record = read(out / f"{short.name}.json")
    assert (record["maze"], record["study"], record["final"]["step"]) == ("stitch", "pointmaze", 4)
    assert record["data"]["origin"] == "locally generated data"
    assert [evaluation["step"] for evaluation in record["evaluations"]] == [2, 4]
    assert str(tmp_path) not in json.dumps(record)  # a ledger names no folder of the machine
    (path,) = record["paths"]["places"]
    assert len(path.split()) == 51 and path.split()[0].count(",") == 1 and len(record["paths"]["stitched"]) == 1
    assert read(out / f"{longer.name}.json")["final"]["step"] == 6
    assert longer.directory(work) == short.directory(work)
    assert (out / "figure.png").read_bytes().startswith(b"\x89PNG")
    log = stitch_data.generate(MAZE.log.config(), seed=0)  # type: ignore[union-attr]
    known = read(out / "data.json")["stitch"]["sha256"]
    assert log.fingerprint() in known and set(prints_of(record["data"])) <= set(known)

    returns = [read(out / f"{one.name}.json")["final"]["mean_return"] for one in (short, other)]
    row = next(line for line in (out / "table.md").read_text(encoding="utf-8").splitlines() if "| 4 | 2 |" in line)
    assert f"| {sum(returns) / 2:.1f} |" in row and f"| {min(returns):.1f} |" in row

    stamps = {path: path.stat().st_mtime_ns for path in out.glob("*-seed*.json")}
    (out / f"{other.name}.json").unlink()  # its run directory is complete: the record is written again without training
    (out / f"{short.name}.json").unlink()  # its run directory has gone on: it is trained again beside it
    measure([[short, other], [longer]], out, work)
    assert [read(out / f"{one.name}.json")["final"]["mean_return"] for one in (short, other)] == returns
    kept = out / f"{longer.name}.json"
    assert kept.stat().st_mtime_ns == stamps[kept]


def test_normalised_records_go_on_after_a_stop_with_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, work, other = tmp_path / "results", tmp_path / "work", tmp_path / "other"
    first, second = cloning(HOPPER, 0, 4), cloning(HOPPER, 1, 6)
    evaluate = RolloutEvaluator.__call__

    def stop_late(self: RolloutEvaluator, policy: Any, directory: Path, step: int) -> Any:
        if step == 4 and second.title in str(directory):
            raise KeyboardInterrupt
        return evaluate(self, policy, directory, step)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(RolloutEvaluator, "__call__", stop_late)
        measure([[first, second]], out, work)
    finished = out / f"{first.name}.json"
    assert [path for path in out.glob("*-seed*.json")] == [finished]
    record, stamp = read(finished), finished.stat().st_mtime_ns
    assert record["algorithm"]["hidden_sizes"] == [8]
    assert record["updates"] == record["steps"] == record["final"]["step"] == 4
    assert len(record["final"]["returns"]) == 2  # more episodes than while it trained
    assert record["final"]["mean_return"] == pytest.approx(sum(record["final"]["returns"]) / 2)
    for score in (record["final"], *record["evaluations"]):  # 0 is a return of -20.272305, 100 one of 3234.3
        assert score["normalised_score"] == pytest.approx((score["mean_return"] + 20.272305) / 32.54572305)
    logged = locomotion_data.generate("hopper-medium", 1_500, 0)
    assert logged.fingerprint() in prints_of(record["data"])
    assert record["data"]["mean_return"] == logged.provenance["statistics"]["mean"]
    assert record["data"]["edition"] == logged.provenance["policies"]["edition"] == 1
    named = "odaf data generate hopper-medium --transitions 1500 --seed 0 --edition 1 --out FILE"
    assert record["data"]["same_set"] == named  # also once there is a newer one

    (half,) = [path for path in (second.directory(work) / "seed-1" / "checkpoints").iterdir() if int(path.name) == 2]
    assert second.amount_done(work) == 4.0  # saved before it was evaluated
    made = half.stat().st_ctime_ns
    measure([[first, second]], out, work)
    assert finished.stat().st_mtime_ns == stamp
    assert half.stat().st_ctime_ns == made  # it went on from there, not from the beginning
    unbroken = second.do(other, Silent())
    assert read(out / f"{second.name}.json")["final"] == json.loads(json.dumps(unbroken["final"]))


def test_a_lost_run_is_recorded_without_the_score_of_an_earlier_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    training = cloning(MAZE, 0, 10)
    summary: dict[str, Any] = {"step": 7, "status": "diverged", "evaluation": {"mean_return": 5.0}}
    summary |= dict.fromkeys(("updates_per_second", "seconds", "pretrain", "warnings"))
    files = SimpleNamespace(
        summary={0: summary},
        directory=tmp_path,
        data={"sha256": "ab", "summary": dict.fromkeys(("transitions", "episodes", "mean_return", "best_return"), 1)},
        config={"algorithm": {}, "steps": 10},
        files=SimpleNamespace(metrics=lambda seed: []),
    )

    def diverge(*arguments: Any, **settings: Any) -> None:
        raise DivergenceError("lost")

    monkeypatch.setattr(fitting, "fit", diverge)
    monkeypatch.setattr(fitting, "load_run", lambda directory: files)
    (tmp_path / "environment.json").write_text('{"python": "", "versions": {}, "device": "", "platform": ""}')
    with pytest.raises(DivergenceError):  # lost in pretraining: there is no run to record
        training.do(tmp_path, Silent())
    training.directory(tmp_path).mkdir()
    (training.directory(tmp_path) / "config.json").write_text("{}")
    record = training.do(tmp_path, Silent())
    assert (record["status"], record["updates"], record["final"]) == ("diverged", 7, None)
    assert training.said(record) == "diverged after 7 updates"


@pytest.fixture
def held() -> tuple[Training, Ledger]:
    """A training of the pointmaze study that is in the ledger that comes with the code."""
    ledger = Ledger(STUDIES["pointmaze"], Path(__file__).parents[2] / "results" / "pointmaze")
    job = next(job for job in ledger.study.jobs() if job.name == "stitch-odaf-seed0-20000")
    assert isinstance(job.do, Training)
    return job.do, ledger


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"changes": (("critic_learning_rate", 1e-3),)}, "learner.critic_learning_rate was 0.0003, is 0.001"),
        ({"changes": (("outcome.weight", 9.0),)}, "learner.terms.outcome.weight was "),
        ({"preset": "odaf-without-outcome"}, "learner.terms.outcome was a table, is no longer there"),
        ({"seed": 1}, "seed was 0, is 1"),
        ({"steps": 30_000}, "steps was 20000, is 30000"),
        ({"log": MazeLog("stitch", seed=1)}, "data.print was 'b0d2d298, not in data.json', is 'known'"),
        ({"evaluation": Evaluation(episodes=100)}, "evaluation.final_episodes was 50, is 100"),
        ({"evaluation": Evaluation(every=1_000)}, "evaluation.every was 5000, is 1000"),
        ({"version": 2}, "evaluation.version was 1, is 2"),
    ],
)
def test_a_record_is_stale_when_anything_that_decides_it_changes(
    held: tuple[Training, Ledger], change: dict[str, Any], says: str
) -> None:
    training, ledger = held
    job = next(job for job in ledger.study.jobs() if job.do == training)
    assert ledger.standing(job).state == "held"
    of_task = {name: value for name, value in change.items() if name in ("log", "evaluation", "version")}
    changed = replace(training, task=replace(training.task, **of_task), **(change if not of_task else {}))
    standing = ledger.standing(replace(job, do=changed))
    assert standing.state == "stale"
    assert any(line.startswith(says) for line in standing.differences), standing.differences


def test_another_code_version_of_a_learner_makes_its_records_stale(
    held: tuple[Training, Ledger], monkeypatch: pytest.MonkeyPatch
) -> None:
    from odaf.studies import identity

    training, ledger = held
    job = next(job for job in ledger.study.jobs() if job.do == training)
    monkeypatch.setitem(identity.LEARNER_VERSIONS, "ensemble-sac", 2)
    assert ledger.standing(job).differences == ("learner_version was 1, is 2",)


def test_a_record_of_other_rows_is_stale(held: tuple[Training, Ledger]) -> None:
    training, ledger = held
    record = read(ledger.out / f"{training.name}.json")
    assert training.recorded(record, ledger.data)["data"] == training.identity()["data"]
    record["data"] = {kind: "0" * 64 for kind in PRINTS}
    assert training.recorded(record, ledger.data)["data"]["print"] == "00000000, not in data.json"
