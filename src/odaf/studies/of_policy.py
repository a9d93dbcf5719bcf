"""Works on a policy that another job of the study trains: attacked, knocked, its critics asked about actions.

The training is a job of its own, whose record holds the plain scores; what is measured on its policy comes after it. A
work that does not find the policy trains it, so any part of a study can be asked for.
"""

import abc
import time
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from odaf.studies.identity import LEARNER_VERSIONS
from odaf.studies.job import PRINTS, DataEntries, Job, Log, Phase, Record, Work
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run
    from odaf.training.progress import ProgressReport


@dataclass(frozen=True)
class OfPolicy(Work):
    """What is measured on the last policy of a training.

    Attributes:
        training: how the policy comes about.
    """

    training: Training

    measure_name: ClassVar[str]
    """What records call it."""
    version: ClassVar[int] = 1
    """Raised when the same settings would measure something else."""

    @abc.abstractmethod
    def measure(self, run: "Run", place: Path, progress: "ProgressReport") -> Mapping[str, Any]:
        """What a record keeps of it."""

    @abc.abstractmethod
    def settings(self) -> dict[str, Any]:
        """What of it decides the figures, the policy apart."""

    @property
    def name(self) -> str:
        """That of its record."""
        return f"{self.training.name}-{self.measure_name}"

    @property
    def log(self) -> Log:
        return self.training.log

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return self.training.labels | {"measure": (self.measure_name,)}

    def likeness(self) -> tuple[Hashable, ...]:
        return ((self.measure_name, self.training.preset), self.measure_name)

    def said(self, record: Record) -> str:
        return "the policy diverged" if record["found"] is None else "measured"

    def identity(self) -> dict[str, Any]:
        return {
            "measure": self.measure_name,
            "version": self.version,
            "settings": self.settings(),
            "policy": self.training.identity(),
        }

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        return {**record["identity"], "policy": self.training.recorded(record["policy"], data)}

    def unrecorded(self) -> dict[str, Any]:
        return {f"policy.{field}": value for field, value in self.training.unrecorded().items()}

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        training, run = self.training, self.training.trained(place, progress)
        lost, begun = run.summary[training.seed]["status"] == "diverged", time.monotonic()
        found = None if lost else dict(self.measure(run, place, progress))
        own = {name: value for name, value in self.identity().items() if name != "policy"}
        return {
            "measure": self.measure_name,
            training.task.field: training.task.name,
            "method": training.method,
            "preset": training.preset,
            **dict(training.notes),
            "seed": training.seed,
            "steps": training.steps,
            "policy": {
                "data": {
                    **{kind: run.data[kind] for kind in PRINTS if kind in run.data},
                    **training.task.log.figures(run),
                },
                "algorithm": run.config["algorithm"],
                "seed": training.seed,
                "steps": training.steps,
                "final": None,  # the training's own record has it
                "identity": {
                    "learner_version": LEARNER_VERSIONS.get(run.config["algorithm"]["kind"], 1),
                    "evaluation": training.task.settings(),
                },
            },
            "found": found,
            "identity": own,
            "seconds": time.monotonic() - begun,
        }


def phase_of(title: str, works: Sequence[OfPolicy], before: Sequence[Phase] = ()) -> Phase:
    """A phase of works in the order given, each policy's training right before the first that needs it.

    Works on one policy never run at the same time: the first to come trains it.

    Args:
        title: of the phase.
        works: in the order in which they are worth doing.
        before: earlier phases; a policy that is trained there is not trained again.
    """
    earlier: dict[str, list[str]] = {}
    for phase in before:
        for job in phase.jobs:
            training = job.do.training if isinstance(job.do, OfPolicy) else job.do
            if isinstance(training, Training):
                earlier.setdefault(training.name, []).append(job.name)
    jobs = []
    for work in works:
        others = earlier.setdefault(work.training.name, [])
        if not others:
            jobs.append(Job(work.training.name, work.training))
            others.append(work.training.name)
        jobs.append(Job(work.name, work, tuple(others)))
        others.append(work.name)
    return Phase(title, tuple(jobs))


def log_mean(record: Record) -> float | None:
    """What the log of a record's policy earns, as a score; None where nobody knows."""
    data = record["policy"]["data"] if "policy" in record else record["data"]
    score = data.get("normalised_score", data.get("mean_return"))
    return None if score is None else float(score)


def below_log(clean: float, record: Record) -> str:
    """Why a policy under attack, or knocked, decides nothing: without either it earns less than its log. Else empty."""
    mean = log_mean(record)
    if mean is None or clean >= mean:
        return ""
    return f"its clean score {clean:.1f} lies below its log's mean {mean:.1f}, so it has nothing to lose"


def diverged(records: Sequence[Record]) -> str:
    """Why the seeds that are left decide nothing, where others of the same policy diverged. Else empty."""
    lost, seeds = {one["seed"] for one in records if one["found"] is None}, {one["seed"] for one in records}
    return f"{len(lost)} of {len(seeds)} seeds diverged, and those that are left are a choice" if lost else ""
