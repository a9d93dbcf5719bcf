"""Trainings of a study in lanes, and records that come from another machine."""

import io
import json
import os
import time
from pathlib import Path

import pytest

from odaf import Policy
from odaf.cli import main
from odaf.environments import stitch_data
from odaf.studies import lanes, pace
from odaf.studies.cost import seconds_of
from odaf.studies.executor import Here
from odaf.studies.job import Study
from odaf.studies.ledger import Ledger
from odaf.studies.logs import MazeLog
from odaf.studies.news import Display
from odaf.studies.perform import perform
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of
from odaf.training.progress import Silent

MAZE = Task(
    MazeLog("stitch", repeats=2, episodes=2), Evaluation(every=2, episodes=2), field="maze",
    common=(("hidden_sizes", (8,)), ("batch_size", 8)),
)  # fmt: skip
RATES = ((), (("learning_rate", 1e-3),))


def trainings(steps: int = 4) -> list[Training]:
    return [
        Training("behaviour-cloning", MAZE, seed, steps, changes=changes, checkpoint_every=2)
        for changes in RATES
        for seed in (0, 1)
    ]


def study_of(*parts: list[Training]) -> Study:
    plan = phases_of(*((f"part {number}", part) for number, part in enumerate(parts)))
    return Study("small", "small", lambda: plan, {}, {})


def measured(study: Study, out: Path, work: Path) -> Ledger:
    ledger = Ledger(study, out)
    perform(ledger, study.jobs(), work, Here(), Display("small", io.StringIO()))
    return ledger


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Ledger]:
    """A study whose trainings were lanes, as it comes from another machine."""
    folder, study = tmp_path_factory.mktemp("elsewhere"), study_of(trainings())
    assert lanes.train_together(study.jobs(), folder / "work", Silent())
    ledger = measured(study, folder / "ledger", folder / "work")
    lanes.keep_actors(ledger, study.jobs(), folder / "work")
    return study, ledger


def test_records_of_lanes_say_what_records_of_single_trainings_say(carried, tmp_path: Path) -> None:
    study, ledger = carried
    alone = measured(study, tmp_path / "results", tmp_path / "work")
    assert len(ledger.held()) == 4
    for job in study.jobs():
        ours, theirs = ledger.record(job), alone.record(job)
        assert ours is not None and theirs is not None
        assert ours.pop("lanes") == 4 and "lanes" not in theirs and ours.keys() == theirs.keys()
        assert ours["final"]["mean_return"] == pytest.approx(theirs["final"]["mean_return"], rel=1e-3)
        assert [one["step"] for one in ours["evaluations"]] == [2, 4] and ours["algorithm"] == theirs["algorithm"]


def test_time_that_lanes_shared_says_nothing_of_one() -> None:
    assert seconds_of({"seconds": {"total": 5.0}}) == 5.0
    assert seconds_of({"seconds": {"total": 5.0}, "lanes": 4}) is None


def test_what_the_time_did_not_allow_is_gone_on_with(carried, tmp_path: Path) -> None:
    study, ledger = carried
    work = tmp_path / "work"
    assert not lanes.train_together(study.jobs(), work, Silent(), until=time.monotonic())
    MAZE.log.present(work)
    assert not lanes.train_together(study.jobs(), work, Silent(), until=time.monotonic() + 0.5)
    assert not any(lanes.at_its_end(job, work) for job in study.jobs())
    assert lanes.train_together(study.jobs(), work, Silent())
    assert all(lanes.at_its_end(job, work) for job in study.jobs())
    again = measured(study, tmp_path / "results", work)
    for job in study.jobs():
        ours, theirs = again.record(job), ledger.record(job)
        assert ours is not None and theirs is not None
        assert (ours["final"], ours["lanes"]) == (theirs["final"], theirs["lanes"])


def test_as_many_as_end_in_the_time_are_trained_to_their_ends(tmp_path: Path, monkeypatch) -> None:
    """On a clock that a stretch of n lanes puts forward by n: the ten stretches of four lanes would take 40 of 34."""
    now = 0.0

    class Slow(pace.Pace):
        def __call__(self) -> bool:
            nonlocal now
            now += self._lanes
            return super().__call__()

    monkeypatch.setattr(pace, "clock", lambda: now)
    monkeypatch.setattr(pace, "Pace", Slow)
    study, work = study_of(trainings(20)), tmp_path / "work"
    assert not lanes.train_together(study.jobs(), work, Silent(), until=34.0)
    assert [lanes.at_its_end(job, work) for job in study.jobs()] == [True, True, False, False]
    assert now == 12.0 + 20.0 and len(list(work.glob("*/config.json"))) == 2


def test_processes_that_make_records_leave_the_accelerator_alone(monkeypatch) -> None:
    for before in (None, "cuda"):
        monkeypatch.delenv("JAX_PLATFORMS", raising=False)
        if before is not None:
            monkeypatch.setenv("JAX_PLATFORMS", before)
        with lanes.on_processors():
            assert os.environ["JAX_PLATFORMS"] == "cpu"
        assert os.environ.get("JAX_PLATFORMS") == before


def test_longer_runs_and_runs_begun_alone_are_left_to_the_schedule(tmp_path: Path) -> None:
    short, longer = trainings(4)[:1], trainings(6)[:1]
    study, work = study_of(short, longer), tmp_path / "work"
    measured(study_of(short), tmp_path / "results", work)
    assert lanes.train_together(study.jobs(), work, Silent())
    ledger = measured(study, tmp_path / "results", work)
    assert len(ledger.held()) == 2 and all("lanes" not in record for record in ledger.held())


def test_records_are_taken_over_once_with_their_actors(carried, tmp_path: Path) -> None:
    study, other = carried
    ledger = Ledger(study, tmp_path / "results")
    names = tuple(job.name for job in study.jobs())
    assert lanes.merge(ledger, other) == lanes.Merged(names, (), {})
    assert len(ledger.held()) == 4
    assert lanes.merge(ledger, other) == lanes.Merged((), names, {})
    policy = Policy.load(tmp_path / "results" / lanes.ACTORS / f"{names[0]}.safetensors")
    log = stitch_data.generate(MAZE.log.config(), seed=0)  # type: ignore[union-attr]
    assert policy(log.observations[:2]).shape == (2, 2)


def _copied(ledger: Ledger, study: Study, target: Path) -> Ledger:
    target.mkdir()
    for file in ledger.out.glob("*.json"):
        (target / file.name).write_bytes(file.read_bytes())
    return Ledger(study, target)


def test_records_on_another_log_or_of_another_measurement_are_refused(carried, tmp_path: Path) -> None:
    study, other = carried
    ledger = _copied(other, study, tmp_path / "results")
    first = study.jobs()[0]
    ledger.path(first).unlink()
    stranger = _copied(other, study, tmp_path / "stranger")
    data = json.loads((stranger.out / "data.json").read_text())
    data["stitch"]["sha256"] = ["f" * 64]
    (stranger.out / "data.json").write_text(json.dumps(data))
    found = lanes.merge(ledger, Ledger(study, stranger.out))
    assert found.taken == () and list(found.refused) == [first.name]
    assert "ffffffff" in found.refused[first.name]

    changed = _copied(other, study, tmp_path / "changed")
    record = json.loads(changed.path(first).read_text())
    record["algorithm"]["learning_rate"] = 0.5
    changed.path(first).write_text(json.dumps(record))
    found = lanes.merge(ledger, changed)
    assert found.taken == () and "learning_rate" in found.refused[first.name]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path, capsys) -> None:
    assert main(["reproduce", "pointmaze", "--out", str(tmp_path), "--merge", str(tmp_path / "none")]) == 2
    assert "there is no such folder" in capsys.readouterr().err
