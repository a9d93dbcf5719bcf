"""Training a learner on a dataset: one run directory, one or several seeds, resumable at any point."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from odaf.algorithms.base import Algorithm
from odaf.algorithms.config import to_dict
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError
from odaf.training import run_directory
from odaf.training.evaluator import Evaluator
from odaf.training.files import plain, read_json, write_json
from odaf.training.lock import locked
from odaf.training.logging import Logger
from odaf.training.progress import ProgressReport, default_progress
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining, compiling_stage, prepare

OnDivergence = Literal["warn", "stop"]
# Brings the unfinished seeds of a run to their last step.
TrainSeeds = Callable[[Sequence[SeedTraining], Dataset, Sequence[Logger]], None]


def one_after_another(seeds: Sequence[SeedTraining], dataset: Dataset, loggers: Sequence[Logger]) -> None:
    """Trains each seed to its end, in this process, before the next begins."""
    first = seeds[0]
    data = prepare(first.run, dataset, lambda: first.progress.start(compiling_stage(first.seed), 0))
    for seed in seeds:
        seed.go(data, loggers)


def fit(
    algorithm: Algorithm,
    dataset: Dataset,
    *,
    steps: int,
    directory: str | os.PathLike[str],
    seeds: Sequence[int] = (0,),
    evaluate: Evaluator | None = None,
    checkpoint_every: int = 5000,
    stretch: int = 1000,
    on_divergence: OnDivergence = "warn",
    progress: bool | ProgressReport = True,
    preset: str | None = None,
    loggers: Sequence[Logger] = (),
    data_path: str | os.PathLike[str] | None = None,
    train_seeds: TrainSeeds = one_after_another,
) -> RunDirectory:
    """Trains `algorithm` on `dataset` once for every seed and leaves all results in `directory`.

    A directory that already holds a run with the same settings and data is continued, so the same call can be repeated
    after a crash. Same seed, machine and versions give the same bits, however often the run was stopped.

    Args:
        algorithm: the learner's settings.
        dataset: the logged data. If they are mixed per batch, so is each batch of the training.
        steps: updates for each seed.
        directory: where the run is written; must be empty, absent, or hold this very run.
        seeds: distinct non-negative integers.
        evaluate: measures the policy every `evaluate.every` updates and after the last; None measures nothing.
        checkpoint_every: updates between two checkpoints; there is always one before the first update and one after the
            last.
        stretch: updates in one compiled call, and between two lines of metrics.
        on_divergence: "warn" notes that values leave the range that rewards allow; "stop" also ends training there.
            Training always ends when parameters are no longer finite numbers.
        progress: whether to show a progress bar, or an own report.
        preset: name under which the settings are known, for the record.
        loggers: receivers of metrics beside `metrics.jsonl`.
        data_path: the file that `dataset` was read from, kept for `resume`.
        train_seeds: how several seeds share the machine; by default each is trained to its end before the next begins.

    Raises:
        ConfigError: a setting is out of its range, or the directory holds something else.
        DivergenceError: training diverged and `on_divergence` is "stop", or parameters are no longer finite numbers;
            the state is saved first.
    """
    _check_settings(steps, seeds, checkpoint_every, stretch, on_divergence, evaluate)
    config = {
        "format": run_directory.FORMAT,
        "version": run_directory.VERSION,
        "preset": preset,
        "algorithm": to_dict(algorithm),
        "steps": int(steps),
        "seeds": [int(seed) for seed in seeds],
        "evaluate": None if evaluate is None else evaluate.to_dict(),
        "checkpoint_every": int(checkpoint_every),
        "stretch": int(stretch),
        "on_divergence": on_divergence,
    }
    normaliser = Normaliser.fit(dataset.observations, algorithm.view().normaliser_epsilon)
    data = run_directory.data_record(dataset, normaliser, data_path)
    path = Path(directory)
    run_directory.refuse_foreign(path)
    path.mkdir(parents=True, exist_ok=True)
    with locked(path):
        run = run_directory.begin(path, plain(config), plain(data), dataset)
        _train(run, dataset, evaluate, on_divergence, default_progress(progress), loggers, train_seeds)
    return run


def resume(
    directory: str | os.PathLike[str],
    steps: int | None = None,
    *,
    dataset: Dataset | None = None,
    evaluate: Evaluator | None = None,
    on_divergence: OnDivergence | None = None,
    progress: bool | ProgressReport = True,
    loggers: Sequence[Logger] = (),
    train_seeds: TrainSeeds = one_after_another,
) -> RunDirectory:
    """Goes on exactly where the run in `directory` stopped; the result has the bits of a run that never stopped.

    Args:
        directory: a run's directory.
        steps: updates for each seed in all, to make a run longer; None keeps the number it was begun with.
        dataset: the data it was begun with; None reads them from the path that the run remembers.
        evaluate: as in `fit`; must have the settings that the run was begun with.
        on_divergence: None keeps the run's setting. A warning that stopped the run once does not stop it again.
        progress: as in `fit`.
        loggers: as in `fit`.
        train_seeds: as in `fit`.

    Raises:
        CheckpointError: the directory holds no run, or a damaged one.
        ConfigError: `steps` is less than the run has, or the evaluator differs.
        DatasetError: the data are not those the run was begun with.
    """
    run = RunDirectory(Path(directory))
    config = run.config
    if dataset is None:
        if run.data["path"] is None:
            raise ConfigError(
                f"{run.path}: its data came from memory, not from a file; give them again as `dataset`, "
                "or save them with Dataset.save and train from the file"
            )
        dataset = Dataset.load(run.data["path"])
    check_same_data(run, dataset)
    if plain(None if evaluate is None else evaluate.to_dict()) != config["evaluate"]:
        raise ConfigError(
            f"{run.path}: evaluate: the run was begun with {config['evaluate']!r}; "
            "give an evaluator with these settings"
        )
    if steps is not None and steps < config["steps"]:
        raise ConfigError(
            f"{run.path}: steps: {steps} asked, but the run is made for {config['steps']} and cannot be shortened; "
            "use an earlier checkpoint instead"
        )
    with locked(run.path):
        if steps is not None and steps > config["steps"]:
            write_json(run.path / "config.json", {**config, "steps": int(steps)})
            run = RunDirectory(run.path)
        chosen = on_divergence or config["on_divergence"]
        _check_settings(run.config["steps"], run.seeds, config["checkpoint_every"], config["stretch"], chosen, evaluate)
        record = run.path / "environment.json"
        environment = read_json(record, "It is needed only for the record: put {} into it to go on.")
        now, report = run_directory.process_record(), default_progress(progress)
        resumed = environment.get("resumed", [])
        changes = run_directory.changes([environment, *resumed][-1], now)
        if changes:
            report.message(f"{run.path}: {changes}; the run goes on, but not with the bits of an unbroken one")
        write_json(record, {**environment, "resumed": [*resumed, now]})
        _train(run, dataset, evaluate, chosen, report, loggers, train_seeds)
    return run


def load_run(directory: str | os.PathLike[str]) -> RunDirectory:
    """The run in `directory`, finished or not.

    Raises:
        CheckpointError: there is no run.
    """
    run = RunDirectory(Path(directory))
    _ = run.config
    return run


def _train(
    run: RunDirectory,
    dataset: Dataset,
    evaluate: Evaluator | None,
    on_divergence: str,
    progress: ProgressReport,
    loggers: Sequence[Logger],
    train_seeds: TrainSeeds,
) -> None:
    run_directory.remove_unfinished(run.path, recursive=False)
    seeds = [SeedTraining(run, seed, evaluate, on_divergence, progress) for seed in run.seeds]
    for seed in seeds:
        if seed.is_finished():
            seed.write_summary()
    unfinished = [seed for seed in seeds if not seed.is_finished()]
    try:
        if unfinished:
            train_seeds(unfinished, dataset, loggers)
    finally:
        progress.close()


def _check_settings(
    steps: int,
    seeds: Sequence[int],
    checkpoint_every: int,
    stretch: int,
    on_divergence: str,
    evaluate: Evaluator | None,
) -> None:
    counts = {"steps": steps, "checkpoint_every": checkpoint_every, "stretch": stretch}
    if evaluate is not None:
        counts["evaluate.every"] = evaluate.every
    for name, value in counts.items():
        if value < 1:
            raise ConfigError(f"{name}: must be at least 1, got {value}")
    if steps >= 2**31:
        raise ConfigError(f"steps: must be below 2^31, got {steps}")
    if not seeds or len(set(seeds)) < len(seeds) or any(not 0 <= seed < 2**32 for seed in seeds):
        raise ConfigError(f"seeds: must be distinct integers from 0 to 2^32 - 1, at least one, got {list(seeds)}")
    if on_divergence not in ("warn", "stop"):
        raise ConfigError(f"on_divergence: must be 'warn' or 'stop', got {on_divergence!r}")


def check_same_data(run: RunDirectory, dataset: Dataset) -> None:
    """Makes sure that `dataset` is what the run was begun with.

    Raises:
        DatasetError: it is not.
    """
    found, expected = dataset.fingerprint(), run.data["sha256"]
    if found != expected:
        raise DatasetError(
            f"{run.data['path'] or 'dataset'}: its fingerprint is {found[:12]}..., but {run.path} was begun with data "
            f"of fingerprint {expected[:12]}...; give the same data, or train into another directory"
        )
