"""The trainings of a study as lanes of a few programs, and records that were made on another machine.

Lanes train what is missing; then the study is performed as ever, and finds these trainings complete. So a record says
the same whichever way its policy was trained, and how many lanes there were besides.
"""

import contextlib
import functools
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import DivergenceError
from odaf.studies import pace
from odaf.studies.identity import differences
from odaf.studies.job import Job
from odaf.studies.ledger import Ledger
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.data.dataset import Dataset
    from odaf.runs.many import Plan
    from odaf.training.progress import ProgressReport

ACTORS = "actors"


def train_together(
    jobs: Sequence[Job], place: Path, report: "ProgressReport", lanes: int | None = None, until: float | None = None
) -> bool:
    """Trains the jobs that are trainings, those that share a program in lanes of it, in the order of the first of each.

    Logs of other widths share one too where the method can be padded.

    A training whose directory holds a shorter run, or one that was begun in another way, is left to `perform`. Where a
    program's trainings would not all end in the time, the first of them that would are begun anew without the others.

    Args:
        jobs: whose records are missing.
        place: directory of data and run directories.
        report: where progress is shown.
        lanes: of a program; None takes as many as there are trainings, or as the memory holds.
        until: a time of `time.monotonic` when what is under way is saved, to be gone on with; None trains to the ends.

    Returns:
        Whether all was trained in the time.
    """
    from odaf.runs.many import Plan
    from odaf.training.lanes import program_of

    place.mkdir(parents=True, exist_ok=True)
    groups: dict[Any, list[tuple[Plan, Training]]] = {}
    for job in jobs:
        work = job.do
        if not isinstance(work, Training) or not _fresh(work, place):
            continue
        learner, path = work.learner(), work.log.present(place)
        dataset = _loaded(path)
        course = (work.steps, work.checkpoint_every, work.task.evaluation.every, work.task.evaluation.episodes)
        # What is gone on with keeps the lanes that it was begun among, though the records of others are made since.
        course = (*course, begun_among(work, place))
        plan = Plan(learner, dataset, work.directory(place), work.preset, path, (work.seed,))
        groups.setdefault((program_of(learner, dataset), course), []).append((plan, work))
    for number, group in enumerate(groups.values(), 1):
        if until is not None and pace.clock() >= until:
            return False
        steps = group[0][1].steps
        report.message(f"program {number} of {len(groups)}: {len(group)} trainings, {steps:,} updates each")
        if not _train(group, place, report, lanes, until):
            return False
    return True


def _train(
    group: "Sequence[tuple[Plan, Training]]",
    place: Path,
    report: "ProgressReport",
    lanes: int | None,
    until: float | None,
) -> bool:
    """Trains those of one program, or as many of them as end in the time; returns whether all were trained."""
    from odaf.evaluation import Rollouts
    from odaf.runs.many import fit_many
    from odaf.training.settings import RunSettings

    given, first = len(group), group[0][1]
    evaluation, begun = first.task.evaluation, begun_among(first, place)
    stops = pace.stops(first.steps, evaluation.every, first.checkpoint_every, RunSettings.stretch)
    while True:
        among = begun or min(lanes or len(group), len(group))
        keeping = pace.Pace(among, stops, until, begun is None)
        try:
            fit_many(
                [plan for plan, _ in group],
                lanes=among,
                steps=first.steps,
                evaluate=Rollouts(episodes=evaluation.episodes, every=evaluation.every),
                checkpoint_every=first.checkpoint_every,
                progress=report,
                asked_to_stop=keeping,
            )
        except DivergenceError:
            pass  # its record says so
        except KeyboardInterrupt:
            if keeping.fitting is None:
                if until is None or pace.clock() < until:
                    raise
                return False
            report.message(f"{among} trainings would not end in the time; the first {keeping.fitting} begin anew")
            for plan, _ in group:
                shutil.rmtree(plan.directory)
            group = group[: keeping.fitting]
            continue
        return len(group) == given


def begun_among(work: Training, place: Path) -> int | None:
    """Lanes of the program in which a training was begun; None if nothing is there yet."""
    from odaf.training.fit import recorded_config

    config = recorded_config(work.directory(place))
    return None if config is None else config.get("lanes", 1)


def at_its_end(job: Job, place: Path) -> bool:
    """Whether a job is a training that has made all its updates, or diverged: only its record is still to be made."""
    from odaf.runs.fit import load_run

    work = job.do
    if not isinstance(work, Training) or not (work.directory(place) / "config.json").exists():
        return False
    run = load_run(work.directory(place))
    return run.config["steps"] == work.steps and run.summary[work.seed]["status"] in ("finished", "diverged")


@contextlib.contextmanager
def on_processors() -> Iterator[None]:
    """A block whose new processes leave an accelerator alone: one process may have filled its memory."""
    before = os.environ.get("JAX_PLATFORMS")
    os.environ["JAX_PLATFORMS"] = "cpu"
    try:
        yield
    finally:
        if before is None:
            del os.environ["JAX_PLATFORMS"]
        else:
            os.environ["JAX_PLATFORMS"] = before


@dataclass(frozen=True)
class Merged:
    """What came of taking records over.

    Attributes:
        taken: names of the records that are in the ledger now.
        known: names of those that it held already.
        refused: for each of the others, why.
    """

    taken: tuple[str, ...]
    known: tuple[str, ...]
    refused: dict[str, str]


def merge(ledger: Ledger, other: Ledger) -> Merged:
    """Takes over the records of another ledger of the same study, made on another machine.

    A record is taken if it says what today's code would measure, and if its log is one that this ledger knows, or one
    of a recipe that it has no records of yet. The actors beside the records come along.

    Args:
        ledger: takes them; its tables are drawn anew.
        other: is left as it is.
    """
    foreign = _foreign_logs(ledger, other)
    for name, entry in other.data.items():
        if name not in foreign:
            ledger.learn_log(name, entry)
    taken, known, refused = [], [], {}
    for job in ledger.study.jobs():
        standing = other.standing(job)
        if standing.record is None:
            continue
        if ledger.standing(job).state == "held":
            known.append(job.name)
        elif job.do.log is not None and job.do.log.name in foreign:
            refused[job.name] = foreign[job.do.log.name]
        elif standing.state == "stale":
            refused[job.name] = "; ".join(standing.differences[:2])
        else:
            ledger.write(job, standing.record)
            taken.append(job.name)
            actor = other.out / ACTORS / f"{job.name}.safetensors"
            if actor.exists():
                _copied(actor, ledger.out / ACTORS / actor.name)
    ledger.draw()
    return Merged(tuple(taken), tuple(known), refused)


def keep_actors(ledger: Ledger, jobs: Sequence[Job], place: Path) -> None:
    """Saves the last policy of each training whose record is held, in `actors/` beside the records."""
    from odaf.runs.fit import load_run

    for job in jobs:
        file = ledger.out / ACTORS / f"{job.name}.safetensors"
        if isinstance(job.do, Training) and not file.exists() and ledger.standing(job).state == "held":
            directory = job.do.directory(place)
            if (directory / "config.json").exists():
                file.parent.mkdir(parents=True, exist_ok=True)
                load_run(directory).policy(job.do.seed).save(file)


def _foreign_logs(ledger: Ledger, other: Ledger) -> dict[str, str]:
    """Logs of the other ledger that go by the same recipe here and have other rows, and why that is refused."""
    foreign = {}
    for name, entry in other.data.items():
        known = ledger.data.get(name)
        if known is None or differences(known["recipe"], entry["recipe"]):
            continue
        if not set(known["sha256"]) & set(entry["sha256"]):
            prints = [each["sha256"][0][:8] for each in (known, entry)]
            foreign[name] = f"its log has the fingerprint {prints[1]}, the records here stand on {prints[0]}"
    return foreign


def _fresh(work: Training, place: Path) -> bool:
    """Whether nothing is there yet, or the same training begun in lanes."""
    from odaf.runs.fit import load_run

    directory = work.directory(place)
    if not (directory / "config.json").exists():
        return True
    config = load_run(directory).files.config
    return config["steps"] == work.steps and config.get("lanes", 1) > 1


@functools.cache
def _loaded(path: Path) -> "Dataset":
    """One object a file, so that all lanes on it share its rows."""
    from odaf.data.dataset import Dataset

    return Dataset.load(path)


def _copied(source: Path, target: Path) -> None:
    from odaf.data.writing import write_atomically

    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, lambda file: file.write(source.read_bytes()))
