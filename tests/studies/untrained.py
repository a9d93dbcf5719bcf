"""Trainings whose policies are there without any training, for the tests of what is measured on policies."""

from pathlib import Path

import pytest

from golden.runs import untrained_run
from odaf.data.dataset import Dataset
from odaf.evaluation.runs import Run
from odaf.runs.fit import load_run
from odaf.studies.robots import robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training
from odaf.training.progress import ProgressReport


def hopper(preset: str = "sac-n", rows: int = 600) -> Training:
    """A learner of three small critics on a short log of Hopper."""
    task = robot_task("hopper", "medium", Evaluation(every=4, episodes=1), rows)
    changes = (("hidden_sizes", (4,)), *((("num_critics", 3),) if preset == "sac-n" else ()))
    return Training(preset, task, 0, 4, changes)


def without_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets `Training.trained` find a run of no updates."""

    def trained(self: Training, place: Path, progress: ProgressReport) -> Run:
        del progress
        path, directory = self.log.present(place), self.directory(place)
        if not directory.exists():
            untrained_run(directory, self.learner(), Dataset.load(path), (self.seed,), path)
        return load_run(directory)

    monkeypatch.setattr(Training, "trained", trained)
