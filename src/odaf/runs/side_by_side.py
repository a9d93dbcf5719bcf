"""The seeds of one run trained side by side, each in a process on cores of its own."""

import functools
import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from odaf.data.dataset import Dataset
from odaf.environments.registry import make
from odaf.errors import ConfigError, OdafError
from odaf.evaluation.rollouts import RolloutEvaluator, Rollouts
from odaf.runs.workers import cores, run_jobs, tell
from odaf.training.combined_progress import CombinedProgress, SeedReport
from odaf.training.fit import TrainSeeds, check_same_data, one_after_another
from odaf.training.lock import joined
from odaf.training.logging import Logger
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining, TrainingData, compiling_stage, prepare

# Settings of JAX that change results or where compiled programs are kept; a fresh process would not know them.
_JAX_SETTINGS = (
    "jax_platforms", "jax_enable_x64", "jax_default_matmul_precision", "jax_default_prng_impl",
    "jax_threefry_partitionable", "jax_enable_compilation_cache",
    "jax_compilation_cache_dir", "jax_compilation_cache_max_size", "jax_persistent_cache_min_compile_time_secs",
)  # fmt: skip


def default_workers(seeds: int) -> int:
    """How many processes train `seeds` seeds when nobody says: one a core, or one in all beside an accelerator."""
    return 1 if seeds == 1 or jax.default_backend() != "cpu" else min(seeds, cores())


def evaluator_of(rollouts: Rollouts) -> RolloutEvaluator:
    """What plays the episodes that `rollouts`, whose environment is resolved, describes."""
    assert isinstance(rollouts.environment, Mapping)
    return RolloutEvaluator(rollouts, make(rollouts.environment))


def side_by_side(workers: int, data_path: str | os.PathLike[str] | None) -> TrainSeeds:
    """Trains seeds in `workers` processes; a seed gets the bits that it gets alone on as many cores as a worker has.

    A seed that fails lets the others go on to their end; then its error is raised.

    Args:
        workers: processes at the same time; 1 trains one seed after another in this process.
        data_path: the file that each process reads the data from; None sends them the dataset itself.

    Raises:
        ConfigError: `workers` is less than 1, or a logger cannot be sent to another process.
    """

    if workers < 1:
        raise ConfigError(f"workers: must be at least 1, got {workers}")
    if workers == 1:
        return one_after_another

    def train(seeds: Sequence[SeedTraining], dataset: Dataset, loggers: Sequence[Logger]) -> None:
        first = seeds[0]
        shared = _Shared(
            path=first.run.path,
            data=dataset if data_path is None else Path(data_path),
            on_divergence="stop" if first.stops_on_divergence else "warn",
            loggers=tuple(loggers),
            jax_settings={name: jax.config.values[name] for name in _JAX_SETTINGS},
        )
        _check_loggers(loggers)
        combined, failures = CombinedProgress({seed.seed: seed.step for seed in seeds}, first.steps, first.progress), []
        prepare = functools.partial(_prepare, shared)
        jobs = [seed.seed for seed in seeds]
        # The share of the cores follows from all seeds of the run, so that it is the same when only some are left.
        processes = min(workers, len(first.run.seeds))
        for seed, failure in run_jobs(_train, jobs, processes, prepare=prepare, hear=combined.hear, always_apart=True):
            if failure is None:
                combined.finish(seed)
            else:
                first.progress.message(f"seed {seed}: {failure}")
                failures.append(failure)
        if failures:
            raise failures[0]

    return train


@dataclass(frozen=True)
class _Shared:
    """What every worker has to know beside the seed."""

    path: Path
    data: Dataset | Path
    on_divergence: str
    loggers: tuple[Logger, ...]
    jax_settings: dict[str, Any]


_shared: _Shared


def _prepare(shared: _Shared) -> None:
    global _shared
    _shared = shared
    for name, value in shared.jax_settings.items():
        jax.config.update(name, value)
    _data.cache_clear()


@functools.cache
def _data() -> TrainingData:
    """The data and the compiled training, which all seeds of one worker share."""
    run = RunDirectory(_shared.path)
    dataset = _shared.data
    if isinstance(dataset, Path):
        dataset = Dataset.load(dataset)
        check_same_data(run, dataset)
    return prepare(run, dataset, lambda: None)


def _train(seed: int) -> OdafError | None:
    """In a worker: train one seed to its end; returns what stopped it."""
    run = RunDirectory(_shared.path)
    settings = run.config["evaluate"]
    try:
        with joined(run.path):
            evaluator = None if settings is None else evaluator_of(Rollouts.from_dict(settings))
            try:
                report = SeedReport(seed, tell)
                report.start(compiling_stage(seed), 0)
                SeedTraining(run, seed, evaluator, _shared.on_divergence, report).go(_data(), _shared.loggers)
            finally:
                if evaluator is not None:
                    evaluator.close()
    except OdafError as error:
        return error
    return None


def _check_loggers(loggers: Sequence[Logger]) -> None:
    for logger in loggers:
        try:
            pickle.dumps(logger)
        except Exception as error:  # pickling fails in as many ways as there are objects
            raise ConfigError(
                f"loggers: {type(logger).__name__} cannot be sent to another process ({error}); train with workers=1"
            ) from None
