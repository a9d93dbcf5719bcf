"""What the studies share: runs that go on where they stopped, and a record of each that is written once.

A study is a list of `StudyRun`s. The results directory holds one JSON file a run, and everything else there is drawn
from those files. Data and run directories lie in a work directory and may be thrown away once the records are there.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError, DivergenceError
from odaf.runs.workers import run_jobs
from odaf.training.files import write_json

if TYPE_CHECKING:
    from odaf.evaluation.rollouts import Rollouts
    from odaf.evaluation.runs import Run

LOCAL = "locally generated data"
CHECKPOINT_EVERY = 5_000


@dataclass(frozen=True)
class StudyRun:
    """One policy to train and score.

    Attributes:
        preset: its name.
        task: the maze or data set to learn from.
        seed: of the training.
        steps: updates to make.
        changes: settings other than the preset's, by dotted name.
    """

    preset: str
    task: str
    seed: int
    steps: int
    changes: tuple[tuple[str, Any], ...] = ()

    @property
    def method(self) -> str:
        """The preset and what is changed in it, as in `odaf-return_steps-5`."""
        return "-".join([self.preset, *(f"{field}-{value}" for field, value in self.changes)])

    @property
    def title(self) -> str:
        """What lies in one directory, however many updates it has made."""
        return f"{self.task}-{self.method}-seed{self.seed}"

    @property
    def name(self) -> str:
        """File name of its record, without the ending."""
        return f"{self.title}-{self.steps}"


Measure = Callable[[StudyRun, Path], dict[str, Any]]


def measure_missing(
    measure: Measure,
    phases: Sequence[Sequence[StudyRun]],
    out: Path,
    work: Path,
    *,
    workers: int = 1,
    prepare: Callable[[Path, str], object],
    summarise: Callable[[Path], None],
) -> None:
    """Write the record of every run that has none, and redraw the summary after each.

    Args:
        measure: trains a run, or goes on with it, in the work directory and returns its record; importable by name.
        phases: runs of a phase may be under way at once; a phase begins when the one before it is done.
        out: directory of the records.
        work: directory of data and run directories.
        workers: runs at the same time, each on its own core.
        prepare: makes the data of a task in the work directory if they are not there.
        summarise: draws from the records in `out` whatever stands beside them.
    """
    runs = [run for phase in phases for run in phase]
    missing = {run for run in runs if not (out / f"{run.name}.json").exists()}
    print(f"{len(missing)} of {len(runs)} runs to go; records in {out}", file=sys.stderr)
    out.mkdir(parents=True, exist_ok=True)
    for task in sorted({run.task for run in missing}):
        prepare(work, task)
    for phase in phases:
        jobs = [run for run in phase if run in missing]
        for run, record in run_jobs(partial(_write_record, measure, out, work), jobs, workers):
            print(f"{run.name}: {_score(record)}", file=sys.stderr)
            summarise(out)
    summarise(out)


def read_records(out: Path) -> list[dict[str, Any]]:
    """The records in `out`, in the order of their names."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*-seed*.json"))]


def grouped(records: Sequence[dict[str, Any]], key: Callable[[dict[str, Any]], Any]) -> dict[Any, list[dict[str, Any]]]:
    """Records with equal keys, in the order of the keys."""
    groups: dict[Any, list[dict[str, Any]]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return dict(sorted(groups.items()))


def chosen_phases(
    phases: Sequence[Sequence[StudyRun]], phase: Sequence[int] = (), only: Sequence[str] = ()
) -> list[list[StudyRun]]:
    """The part of a plan that was asked for.

    Args:
        phases: the plan.
        phase: numbers of phases, from 1; none takes all.
        only: presets, or methods such as `odaf-return_steps-5`; none takes all.

    Raises:
        ConfigError: a number or a name is not in the plan.
    """
    numbers = range(1, len(phases) + 1)
    for number in phase:
        if number not in numbers:
            raise ConfigError(f"--phase {number}: this study has phases 1 to {len(phases)}")
    known = {name for runs in phases for run in runs for name in (run.preset, run.method)}
    for name in only:
        if name not in known:
            raise ConfigError(f"--only {name}: is not part of this study; known are {', '.join(sorted(known))}")
    return [
        [run for run in runs if not only or run.preset in only or run.method in only]
        for number, runs in zip(numbers, phases, strict=True)
        if not phase or number in phase
    ]


def train(study: StudyRun, work: Path, learner: Any, data: Path, evaluate: "Rollouts") -> "Run":
    """Train a run, or go on with it: after a stop from its last checkpoint, and further when it was made for less.

    Raises:
        DivergenceError: its parameters are no longer finite numbers.
    """
    from odaf.runs.fit import fit, load_run, resume

    directory = work / study.title
    if (directory / "config.json").exists() and load_run(directory).config["steps"] < study.steps:
        return resume(directory, study.steps)
    return fit(
        learner,
        data,
        steps=study.steps,
        seeds=[study.seed],
        directory=directory,
        evaluate=evaluate,
        checkpoint_every=CHECKPOINT_EVERY,
        preset=study.preset,
    )


def train_while_finite(study: StudyRun, work: Path, learner: Any, data: Path, evaluate: "Rollouts") -> "Run":
    """`train`, but a run whose parameters are lost ends there; `run_facts` then says so.

    Raises:
        DivergenceError: it was lost before the first update.
    """
    from odaf.runs.fit import load_run

    try:
        return train(study, work, learner, data, evaluate)
    except DivergenceError:
        directory = work / study.title
        if not (directory / "config.json").exists():
            raise
        run = load_run(directory)
        if run.summary[study.seed]["status"] != "diverged":
            raise
        return run


def run_facts(study: StudyRun, run: "Run") -> dict[str, Any]:
    """What every record keeps of a run: scores, settings, versions, data fingerprint; no path of this machine.

    `final` is the evaluation after the last update; it is None if the parameters were lost by then.
    """
    summary = run.summary[study.seed]
    versions = json.loads((run.directory / "environment.json").read_text(encoding="utf-8"))
    return {
        "preset": study.preset,
        "changes": dict(study.changes),
        "method": study.method,
        "seed": study.seed,
        "steps": study.steps,
        "updates": summary["step"],
        "status": summary["status"],
        "data": {"origin": LOCAL, "sha256": run.data["sha256"]},
        "final": None if summary["status"] == "diverged" else summary["evaluation"],
        "evaluations": [_evaluation(line) for line in run.metrics(study.seed) if "evaluation/return_mean" in line],
        "updates_per_second": summary["updates_per_second"],
        "seconds": summary["seconds"],
        "pretrain": summary["pretrain"],
        "warnings": summary["warnings"],
        "algorithm": run.config["algorithm"],
        "versions": {key: versions[key] for key in ("python", "versions", "device", "platform")},
    }


def _evaluation(line: Mapping[str, Any]) -> dict[str, Any]:
    rates = {name: value for name, value in line.items() if name.startswith("evaluation/") and name.endswith("_rate")}
    return {
        "step": line["step"],
        "mean_return": line["evaluation/return_mean"],
        "std_return": line["evaluation/return_std"],
        **{name.removeprefix("evaluation/"): value for name, value in rates.items()},
    }


def _write_record(measure: Measure, out: Path, work: Path, study: StudyRun) -> dict[str, Any]:
    record = measure(study, work)
    write_json(out / f"{study.name}.json", record)
    return record


def _score(record: Mapping[str, Any]) -> str:
    final = record["final"]
    if final is None:
        return f"diverged after {record['updates']:,} updates"
    return f"{final['mean_return']:.1f} +- {final['std_return']:.1f}"
