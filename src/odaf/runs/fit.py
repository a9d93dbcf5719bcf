"""Training as its user calls it: the loop joined with environments to try policies in."""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import jax

from odaf import training
from odaf.algorithms.base import Algorithm
from odaf.components.critics import usable_cores
from odaf.data.dataset import Dataset
from odaf.data.derived import Derivation
from odaf.environments.contact_margins import recorded, warn_if_other
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import Rollouts
from odaf.evaluation.runs import Run
from odaf.runs.beside import PlayedBeside, Players
from odaf.runs.side_by_side import evaluator_of, side_by_side
from odaf.training.data_search import find_data
from odaf.training.evaluator import Evaluator
from odaf.training.fit import AsBegun, TrainSeeds, recorded_config
from odaf.training.lanes import Lane, train_in_lanes
from odaf.training.logging import Logger
from odaf.training.progress import ProgressReport
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining
from odaf.training.settings import OnDivergence, RunSettings, SettingChanges


def fit(
    algorithm: Algorithm,
    dataset: Dataset | str | os.PathLike[str],
    *,
    directory: str | os.PathLike[str],
    settings: RunSettings | None = None,
    progress: bool | ProgressReport = True,
    preset: str | None = None,
    loggers: Sequence[Logger] = (),
    data_path: str | os.PathLike[str] | None = None,
    advice: Mapping[str, Any] | None = None,
    **changes: Unpack[SettingChanges],
) -> Run:
    """Trains `algorithm` on `dataset` once for every seed and leaves all results in `directory`.

    How the run is to go is said by the fields of `odaf.RunSettings`, either by name or in one object:
    `fit(learner, log, directory="runs/a", steps=20_000, seeds=range(4))`.

    With several `workers`, seeds are trained side by side, each in a process on its share of the cores. Fresh processes
    import the calling script again, so it must call `fit` below `if __name__ == "__main__":`. The same goes for `cores`
    other than this process has. A seed gets the same bits alone and beside others on equally many cores.

    Args:
        algorithm: the learner's settings.
        dataset: logged data, or the file that holds them; from a file, `resume` needs no more than the directory.
        directory: where the run is written; a run that is there already with the same settings is continued.
        settings: how the run is to go.
        progress: whether to show a progress bar.
        preset: name under which the learner's settings are known.
        loggers: receivers of metrics beside `metrics.jsonl`; each worker has a copy.
        data_path: the file that `dataset` was read from, if it was given as an object.
        advice: what chose the preset, as `odaf.advise(...).to_dict()` has it, for the record.
        **changes: fields of `RunSettings` by name; they go before those in `settings`.

    Raises:
        ConfigError: a setting is out of its range, the directory holds something else, or policies cannot be tried in
            the environment.
        DivergenceError: training diverged and `on_divergence` is "stop", or parameters are no longer finite numbers;
            the state is saved first.
    """
    if not isinstance(dataset, Dataset):
        data_path, dataset = dataset, Dataset.load(dataset)
    settings = (settings or RunSettings()).with_changes(dict(changes))
    apart = settings.cores is not None and settings.cores != usable_cores()
    settings = resolved(settings, Path(directory))
    apart = (apart or (settings.workers or 1) > 1) and settings.lanes == 1
    with _evaluation(settings, dataset) as evaluator:
        files = training.fit(
            algorithm,
            dataset,
            directory=directory,
            settings=replace(settings, evaluate=evaluator),
            progress=progress,
            preset=preset,
            loggers=loggers,
            data_path=data_path,
            advice=advice,
            train_seeds=_trainer(settings, data_path, apart),
            apart=apart,
        )
    return Run(files)


def resume(
    directory: str | os.PathLike[str],
    steps: int | None = None,
    *,
    workers: int | None = None,
    dataset: Dataset | str | os.PathLike[str] | None = None,
    evaluate: Rollouts | Evaluator | AsBegun | None = "as begun",
    on_divergence: OnDivergence | None = None,
    progress: bool | ProgressReport = True,
    loggers: Sequence[Logger] = (),
) -> Run:
    """Goes on exactly where the run in `directory` stopped.

    Args:
        directory: a run's directory.
        steps: updates for each seed in all, to make a run longer.
        workers: processes that train seeds side by side, each on as many cores as the run was begun with, so that the
            bits stay those of an unbroken run; None and 1 go on in this process.
        dataset: needed only if the run was begun with data from memory, or their file has moved.
        evaluate: how policies are tried from here on; None tries none any more.
        on_divergence: None keeps the run's setting.
        progress: whether to show a progress bar.
        loggers: receivers of metrics beside `metrics.jsonl`.
    """
    run = RunDirectory(Path(directory))
    run.require_current()
    data_path = None if isinstance(dataset, Dataset) else find_data(run) if dataset is None else dataset
    if not isinstance(dataset, Dataset):
        assert data_path is not None
        dataset = Dataset.load(data_path)
    settings = replace(RunSettings.recorded(run.config), workers=workers or 1).resolved(run.config)
    if evaluate == "as begun":
        recorded = run.config["evaluate"]
        evaluate = None if recorded is None else Rollouts.from_dict(recorded)
    settings = replace(settings, evaluate=evaluate)
    apart = (workers or 1) > 1 and settings.lanes == 1
    with _evaluation(settings, dataset) as evaluator:
        files = training.resume(
            directory,
            steps,
            dataset=dataset,
            evaluate=evaluator,
            on_divergence=on_divergence,
            progress=progress,
            loggers=loggers,
            train_seeds=_trainer(replace(settings, evaluate=evaluator), data_path, apart),
            apart=apart,
        )
    return Run(files)


def load_run(directory: str | os.PathLike[str]) -> Run:
    """The run in `directory`, finished or not."""
    return Run(training.load_run(directory))


def resolved(settings: RunSettings, directory: Path) -> RunSettings:
    """The settings with nothing left open, for a run that may be there already.

    Raises:
        ConfigError: JAX does not compute on the device that is asked for.
    """
    if settings.device not in (None, jax.default_backend()):
        raise ConfigError(
            f"device: {settings.device} is asked for, but JAX computes on {jax.default_backend()} here; set the "
            "environment variable JAX_PLATFORMS before Python starts, or install the JAX that knows the device"
        )
    return settings.resolved(recorded_config(directory))


def evaluator_for(settings: RunSettings, dataset: Dataset, players: Players | None = None) -> Evaluator | None:
    """What tries the policies, or None; examined, so that what cannot work fails before anything is trained.

    Args:
        settings: of the run.
        dataset: that it learns from.
        players: processes that play episodes while training goes on.
    """
    if isinstance(settings.evaluate, Rollouts):
        rollouts = settings.evaluate.resolved(dataset.environment)
        derivation = Derivation.from_provenance(dataset.provenance)
        evaluator = evaluator_of(rollouts, dataset.spec(), dataset.observation_names, derivation)
        warn_if_other(recorded(dataset.provenance), evaluator.simulator)
        if players is None:
            return evaluator
        return PlayedBeside(evaluator, (rollouts, dataset.spec(), dataset.observation_names, derivation), players)
    assert settings.evaluate is None or isinstance(settings.evaluate, Evaluator)
    return settings.evaluate


@contextlib.contextmanager
def _evaluation(settings: RunSettings, dataset: Dataset) -> Iterator[Evaluator | None]:
    players = players_for(settings)
    try:
        evaluator = evaluator_for(settings, dataset, players)
        try:
            yield evaluator
        finally:
            close(evaluator)
    finally:
        close(players)


def players_for(settings: RunSettings) -> Players | None:
    """Processes for episodes that are played while lanes are trained; None where training waits for them."""
    beside = (settings.lanes or 1) > 1 and (settings.workers or 1) > 1 and isinstance(settings.evaluate, Rollouts)
    return Players(settings.workers or 1) if beside else None


def close(held: object) -> None:
    """Gives back what an evaluator or its players hold, such as environments and processes."""
    method = getattr(held, "close", None)
    if method is not None:
        method()


def _trainer(settings: RunSettings, data_path: str | os.PathLike[str] | None, apart: bool) -> TrainSeeds:
    """How the seeds of one run share the machine."""
    lanes = settings.lanes or 1
    if lanes == 1:
        return side_by_side(settings, data_path, apart)

    def train(seeds: Sequence[SeedTraining], dataset: Dataset, loggers: Sequence[Logger]) -> None:
        train_in_lanes([Lane(seed, dataset) for seed in seeds], lanes, loggers, seeds[0].progress)

    return train
