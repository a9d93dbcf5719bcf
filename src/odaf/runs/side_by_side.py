"""The seeds of one run trained side by side, each in a process on cores of its own."""

import contextlib
import functools
import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jax

from odaf.data.dataset import Dataset
from odaf.data.derived import Derivation
from odaf.data.spec import Spec
from odaf.errors import ConfigError, OdafError
from odaf.evaluation.examination import examine
from odaf.evaluation.rollouts import RolloutEvaluator, Rollouts
from odaf.runs.fresh_process import Surroundings
from odaf.runs.workers import cores, run_jobs, send, stopping
from odaf.training.combined_progress import CombinedProgress, SeedReport
from odaf.training.data_search import check_same_data
from odaf.training.evaluator import Evaluator
from odaf.training.fit import TrainSeeds, one_after_another
from odaf.training.interrupts import held_back
from odaf.training.lock import joined
from odaf.training.logging import Logger
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining, TrainingData, compiling_stage, prepare
from odaf.training.settings import RunSettings, products_in


def default_workers(seeds: int, cores_each: int = 1) -> int:
    """How many processes train `seeds` seeds when nobody says: as many as find cores, or one beside an accelerator."""
    if seeds == 1 or jax.default_backend() != "cpu":
        return 1
    return min(seeds, max(1, cores() // cores_each))


def evaluator_of(
    rollouts: Rollouts, spec: Spec, observation_names: Sequence[str], derivation: Derivation | None
) -> RolloutEvaluator:
    """What plays the episodes that `rollouts`, whose environment is resolved, describes.

    Raises:
        ConfigError: policies of such data cannot be tried in that environment.
    """
    examined = examine(rollouts.maker(), rollouts.name, spec, observation_names, rollouts.rule, derivation)
    return RolloutEvaluator(rollouts, examined.make_env, examined.warnings, examined.simulator, examined.fitting)


def side_by_side(settings: RunSettings, data_path: str | os.PathLike[str] | None, apart: bool) -> TrainSeeds:
    """Trains seeds in processes of their own; a seed gets the bits that it gets alone on as many cores as one has.

    A seed that fails lets the others go on to their end; then its error is raised.

    Args:
        settings: resolved; its workers train at the same time, each on its cores.
        data_path: the file that each process reads the data from; None sends them the dataset itself.
        apart: False trains one seed after another in this process.

    Raises:
        ConfigError: a logger or evaluator cannot be sent to another process.
    """
    if not apart:
        return one_after_another
    workers = settings.workers or 1

    def train(seeds: Sequence[SeedTraining], dataset: Dataset, loggers: Sequence[Logger]) -> None:
        first = seeds[0]
        evaluator = first.evaluate
        shared = _Shared(
            path=first.run.path,
            data=dataset if data_path is None else Path(data_path),
            evaluate=evaluator.rollouts if isinstance(evaluator, RolloutEvaluator) else evaluator,
            settings=replace(settings, evaluate=None),
            loggers=tuple(loggers),
            surroundings=Surroundings.of(first.run.algorithm),
        )
        _check_sendable("evaluate", shared.evaluate)
        for logger in loggers:
            _check_sendable("loggers", logger)
        combined = CombinedProgress({seed.seed: seed.step for seed in seeds}, first.steps, first.progress)
        failures: list[OdafError] = []
        processes = min(workers, len(first.run.seeds))
        told = functools.partial(
            first.progress.message, "stopping; seeds save after their stretch (Ctrl-C again: stops at once)"
        )
        with held_back(told) as interrupt:
            ended = run_jobs(
                _train,
                [seed.seed for seed in seeds],
                processes,
                prepare=functools.partial(_prepare, shared),
                receive=combined.receive,
                always_apart=True,
                cores=settings.cores,
                asked_to_stop=lambda: interrupt.came,
            )
            for seed, outcome in ended:
                if isinstance(outcome, OdafError):
                    first.progress.message(f"seed {seed}: {outcome}")
                    failures.append(outcome)
                elif outcome == "finished":
                    combined.finish(seed)
        if interrupt.came:
            raise KeyboardInterrupt
        if failures:
            raise failures[0]

    return train


@dataclass(frozen=True)
class _Shared:
    """What every worker has to know beside the seed."""

    path: Path
    data: Dataset | Path
    evaluate: Rollouts | Evaluator | None
    settings: RunSettings
    loggers: tuple[Logger, ...]
    surroundings: Surroundings


_shared: _Shared


def _prepare(shared: _Shared) -> None:
    global _shared
    _shared = shared
    shared.surroundings.settle()
    _data.cache_clear()


@functools.cache
def _data() -> TrainingData:
    """The data and the compiled training, which all seeds of one worker share."""
    run, dataset = RunDirectory(_shared.path), _shared.data
    if isinstance(dataset, Path):
        place, dataset = dataset, Dataset.load(dataset)
        check_same_data(run, dataset, place)
    return prepare(run, dataset, lambda: None)


def _train(seed: int) -> OdafError | Literal["finished", "stopped"]:
    """In a worker: train one seed to its end; returns how that ended."""
    if stopping():
        return "stopped"
    run, given, report = RunDirectory(_shared.path), _shared.evaluate, SeedReport(seed, send)
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(joined(run.path))
            stack.enter_context(products_in(_shared.settings.precision))
            names = run.data["summary"]["observation_names"]
            evaluator = evaluator_of(given, run.spec, names, run.derivation) if isinstance(given, Rollouts) else given
            if isinstance(evaluator, RolloutEvaluator):
                stack.callback(evaluator.close)
            report.start(compiling_stage(seed), 0)
            on_divergence = _shared.settings.on_divergence
            SeedTraining(run, seed, evaluator, on_divergence, report, stopping).go(_data(), _shared.loggers)
    except OdafError as error:
        return error
    except KeyboardInterrupt:
        return "stopped"
    return "finished"


def _check_sendable(argument: str, value: Any) -> None:
    try:
        pickle.dumps(value)
    except Exception as error:  # pickling fails in as many ways as there are objects
        raise ConfigError(
            f"{argument}: {type(value).__name__} cannot be sent to another process ({error}); train with workers=1"
        ) from None
