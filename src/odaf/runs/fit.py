"""Training as its user calls it: the loop joined with environments to try policies in."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from odaf import training
from odaf.algorithms.base import Algorithm
from odaf.data.dataset import Dataset
from odaf.environments.contact_margins import recorded, warn_if_other
from odaf.environments.registry import simulator_in
from odaf.evaluation.rollouts import Rollouts
from odaf.evaluation.runs import Run
from odaf.runs.side_by_side import evaluator_of, side_by_side
from odaf.training.fit import OnDivergence
from odaf.training.logging import Logger
from odaf.training.progress import ProgressReport
from odaf.training.run_directory import RunDirectory


def fit(
    algorithm: Algorithm,
    dataset: Dataset | str | os.PathLike[str],
    *,
    steps: int,
    directory: str | os.PathLike[str],
    seeds: Sequence[int] = (0,),
    workers: int = 1,
    evaluate: Rollouts | None = None,
    checkpoint_every: int = 5000,
    stretch: int = 1000,
    on_divergence: OnDivergence = "warn",
    progress: bool | ProgressReport = True,
    preset: str | None = None,
    loggers: Sequence[Logger] = (),
    data_path: str | os.PathLike[str] | None = None,
) -> Run:
    """Trains `algorithm` on `dataset` once for every seed; see `odaf.training.fit.fit` for what all arguments mean.

    Args:
        algorithm: the learner's settings.
        dataset: logged data, or the file that holds them; from a file, `resume` needs no more than the directory.
        steps: updates for each seed.
        directory: where the run is written; a run that is there already with the same settings is continued.
        seeds: one policy is trained for each.
        workers: processes that train seeds side by side, each on its share of the cores; 1 trains them one after
            another in this process. Fresh processes import the calling script again, so it must call `fit` below
            `if __name__ == "__main__":`. A seed gets the same bits alone and beside others on equally many cores.
        evaluate: episodes to try policies in while they train; None tries none, for data without a simulator.
        checkpoint_every: updates between two checkpoints.
        stretch: updates in one compiled call.
        on_divergence: "warn" or "stop".
        progress: whether to show a progress bar.
        preset: name under which the settings are known.
        loggers: receivers of metrics beside `metrics.jsonl`; each worker has a copy.
        data_path: the file that `dataset` was read from, if it was given as an object.
    """
    if not isinstance(dataset, Dataset):
        data_path, dataset = dataset, Dataset.load(dataset)
    evaluator = None
    if evaluate is not None:
        rollouts = evaluate.resolved(dataset.environment)
        assert isinstance(rollouts.environment, Mapping)
        evaluator = evaluator_of(rollouts)
        warn_if_other(recorded(dataset.provenance), simulator_in(rollouts.environment))
    try:
        files = training.fit(
            algorithm,
            dataset,
            steps=steps,
            directory=directory,
            seeds=seeds,
            evaluate=evaluator,
            checkpoint_every=checkpoint_every,
            stretch=stretch,
            on_divergence=on_divergence,
            progress=progress,
            preset=preset,
            loggers=loggers,
            data_path=data_path,
            train_seeds=side_by_side(workers, data_path),
        )
    finally:
        if evaluator is not None:
            evaluator.close()
    return Run(files)


def resume(
    directory: str | os.PathLike[str],
    steps: int | None = None,
    *,
    workers: int = 1,
    dataset: Dataset | str | os.PathLike[str] | None = None,
    on_divergence: OnDivergence | None = None,
    progress: bool | ProgressReport = True,
    loggers: Sequence[Logger] = (),
) -> Run:
    """Goes on exactly where the run in `directory` stopped, with the data and evaluation it was begun with.

    Args:
        directory: a run's directory.
        steps: updates for each seed in all, to make a run longer.
        workers: as in `fit`; the bits of an unbroken run need the same number.
        dataset: needed only if the run was begun with data from memory, or their file has moved.
        on_divergence: None keeps the run's setting.
        progress: whether to show a progress bar.
        loggers: receivers of metrics beside `metrics.jsonl`.
    """
    run = RunDirectory(Path(directory))
    data_path = run.data["path"] if dataset is None else None if isinstance(dataset, Dataset) else dataset
    if dataset is not None and not isinstance(dataset, Dataset):
        dataset = Dataset.load(dataset)
    settings: Mapping[str, Any] | None = run.config.get("evaluate")
    evaluator = None if settings is None else evaluator_of(Rollouts.from_dict(settings))
    try:
        files = training.resume(
            directory,
            steps,
            dataset=dataset,
            evaluate=evaluator,
            on_divergence=on_divergence,
            progress=progress,
            loggers=loggers,
            train_seeds=side_by_side(workers, data_path),
        )
    finally:
        if evaluator is not None:
            evaluator.close()
    return Run(files)


def load_run(directory: str | os.PathLike[str]) -> Run:
    """The run in `directory`, finished or not."""
    return Run(training.load_run(directory))
