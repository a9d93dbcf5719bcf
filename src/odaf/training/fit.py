"""Training a learner on a dataset: one run directory, one or several seeds, resumable at any point."""

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Unpack

from odaf.algorithms.base import Algorithm
from odaf.algorithms.config import checked
from odaf.algorithms.registry import register_parts
from odaf.components.critics import usable_cores
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError
from odaf.training import checkpoints, run_writing
from odaf.training.averaging import require_horizon
from odaf.training.data_search import check_same_data, find_data
from odaf.training.drawn_rows import DRAWN, drawn_rows, in_words
from odaf.training.evaluator import Evaluator
from odaf.training.files import plain, read_json, write_json
from odaf.training.lock import locked
from odaf.training.logging import Logger
from odaf.training.process_record import process_record, why_bits_differ, why_bits_do_not_repeat
from odaf.training.progress import ProgressReport, default_progress
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining, compiling_stage, prepare
from odaf.training.settings import OnDivergence, RunSettings, SettingChanges, precision_here, products_in

# Brings the unfinished seeds of a run to their last step.
TrainSeeds = Callable[[Sequence[SeedTraining], Dataset, Sequence[Logger]], None]
# For `resume`: the evaluation stays what it was.
AsBegun = Literal["as begun"]


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
    directory: str | os.PathLike[str],
    settings: RunSettings | None = None,
    progress: bool | ProgressReport = True,
    preset: str | None = None,
    loggers: Sequence[Logger] = (),
    data_path: str | os.PathLike[str] | None = None,
    advice: Mapping[str, Any] | None = None,
    train_seeds: TrainSeeds = one_after_another,
    apart: bool = False,
    **changes: Unpack[SettingChanges],
) -> RunDirectory:
    """Trains `algorithm` on `dataset` once for every seed and leaves all results in `directory`.

    A directory that already holds a run with the same settings and data is continued, so the same call can be repeated
    after a crash. Same seed, machine and versions give the same bits, however often the run was stopped.

    Args:
        algorithm: the learner's settings.
        dataset: the logged data. If they are mixed per batch, so is each batch of the training.
        directory: where the run is written; must be empty, absent, or hold this very run.
        settings: how the run is to go; its `evaluate` must be an `Evaluator`.
        progress: whether to show a progress bar, or an own report.
        preset: name under which the learner's settings are known, for the record.
        loggers: receivers of metrics beside `metrics.jsonl`.
        data_path: the file that `dataset` was read from, kept for `resume`.
        advice: what chose the preset, as `odaf.advise(...).to_dict()` has it, for the record.
        train_seeds: how several seeds share the machine; by default each is trained to its end before the next begins.
        apart: whether `train_seeds` trains in other processes, on as many cores as the settings say.
        **changes: fields of `RunSettings` by name; they go before those in `settings`.

    Raises:
        ConfigError: a setting is out of its range, or the directory holds something else.
        CheckpointError: the directory holds a run of another version of odaf.
        DivergenceError: training diverged and `on_divergence` is "stop", or parameters are no longer finite numbers;
            the state is saved first.
    """
    settings = (settings or RunSettings()).with_changes(dict(changes)).resolved(recorded_config(Path(directory)))
    report = default_progress(progress)
    opened = open_run(
        algorithm, dataset, directory=directory, settings=settings, report=report, preset=preset, data_path=data_path,
        advice=advice, apart=apart,
    )  # fmt: skip
    with opened as (run, seeds):
        _train(seeds, dataset, settings, report, loggers, train_seeds)
    return run


@contextlib.contextmanager
def open_run(
    algorithm: Algorithm,
    dataset: Dataset,
    *,
    directory: str | os.PathLike[str],
    settings: RunSettings,
    report: ProgressReport,
    preset: str | None = None,
    data_path: str | os.PathLike[str] | None = None,
    advice: Mapping[str, Any] | None = None,
    apart: bool = False,
) -> Iterator[tuple[RunDirectory, list[SeedTraining]]]:
    """A block in which the run is ours alone; gives it and its seeds that are not at their end. See `fit`.

    Args:
        algorithm: the learner's settings.
        dataset: the logged data.
        directory: where the run is written.
        settings: resolved.
        report: where progress is shown.
        preset: name under which the learner's settings are known.
        data_path: the file that `dataset` was read from.
        advice: what chose the preset.
        apart: whether seeds are trained in other processes.
    """
    register_parts(algorithm)
    algorithm = checked(algorithm)
    require_horizon(algorithm)
    path, evaluate = Path(directory), _evaluator(settings)
    normaliser = algorithm.normaliser(dataset)
    data = run_writing.data_record(dataset, normaliser, data_path, path) | drawn_rows(algorithm, dataset)
    config = run_writing.config_record(algorithm, settings, preset, advice)
    run_writing.refuse_foreign(path)
    path.mkdir(parents=True, exist_ok=True)
    with locked(path):
        new = not (path / "config.json").exists()
        if new and DRAWN in data:
            report.message(f"{path}: {in_words(data[DRAWN])}")
        process = process_record(_cores(settings, apart), precision_here(settings.precision))
        run = run_writing.begin(path, config, plain(data), process, dataset)
        if words := _only_fits_the_log(algorithm, settings.steps):
            report.message(f"{path}: {words}")
        if new and (reason := why_bits_do_not_repeat(process)):
            report.message(f"{path}: {reason}, set before Python starts; the bits of this run will not repeat")
        yield run, _unfinished(run, settings, evaluate, report, None if new else process)


def _only_fits_the_log(algorithm: Algorithm, steps: int) -> str:
    """A sentence for a run that ends before its actor learns from values; else nothing."""
    warm_up = 0 if algorithm.warm_up is None else int(getattr(algorithm, algorithm.warm_up))
    if steps > warm_up:
        return ""
    return (
        f"in all {steps:,} updates the actor only fits the log, because {algorithm.warm_up}={warm_up}; take more steps "
        "than that, or a shorter warm-up"
    )


def resume(
    directory: str | os.PathLike[str],
    steps: int | None = None,
    *,
    dataset: Dataset | None = None,
    evaluate: Evaluator | AsBegun | None = "as begun",
    on_divergence: OnDivergence | None = None,
    progress: bool | ProgressReport = True,
    loggers: Sequence[Logger] = (),
    train_seeds: TrainSeeds = one_after_another,
    apart: bool = False,
) -> RunDirectory:
    """Goes on exactly where the run in `directory` stopped; the result has the bits of a run that never stopped.

    Args:
        directory: a run's directory.
        steps: updates for each seed in all, to make a run longer; None keeps the number it was begun with.
        dataset: the data it was begun with; None looks for them where the run remembers them, and beside it.
        evaluate: what tries the policies from here on; None tries none any more. Other settings than those the run has
            had are written into it.
        on_divergence: None keeps the run's setting. A warning that stopped the run once does not stop it again.
        progress: as in `fit`.
        loggers: as in `fit`.
        train_seeds: as in `fit`.
        apart: as in `fit`.

    Raises:
        CheckpointError: the directory holds no run, a damaged one, or one of another version of odaf.
        ConfigError: `steps` is less than the run has, or its evaluation is not given.
        DatasetError: the data are not found, or are not those the run was begun with.
    """
    run = RunDirectory(Path(directory))
    run.require_current()
    config = run.config
    place = None
    if dataset is None:
        place = find_data(run)
        dataset = Dataset.load(place)
    check_same_data(run, dataset, place)
    if evaluate == "as begun":
        if config["evaluate"] is not None:
            raise ConfigError(
                f"{run.path}: evaluate: the run was begun with {config['evaluate']!r}; give an evaluator with these "
                "settings, another one, or None to go on without"
            )
        evaluate = None
    if steps is not None and steps < config["steps"]:
        raise ConfigError(
            f"{run.path}: steps: {steps} asked, but the run is made for {config['steps']} and cannot be shortened; "
            "use an earlier checkpoint instead"
        )
    changed: dict[str, Any] = {"evaluate": None if evaluate is None else plain(evaluate.to_dict())}
    if steps is not None:
        changed["steps"] = int(steps)
    settings = replace(RunSettings.recorded({**config, **changed}), evaluate=evaluate)
    settings = replace(settings, on_divergence=on_divergence or settings.on_divergence)
    report = default_progress(progress)
    with locked(run.path):
        others = {name: value for name, value in changed.items() if value != config[name]}
        if others:
            write_json(run.path / "config.json", {**config, **others})
            run = RunDirectory(run.path)
        if others.get("evaluate") is not None:
            _evaluate_ends_again(run)
        process = process_record(_cores(settings, apart), precision_here(settings.precision))
        if others:
            process["changed"] = {name: {"from": config[name], "to": value} for name, value in others.items()}
        seeds = _unfinished(run, settings, evaluate, report, process)
        _train(seeds, dataset, settings, report, loggers, train_seeds)
    return run


def load_run(directory: str | os.PathLike[str]) -> RunDirectory:
    """The run in `directory`, finished or not.

    Raises:
        CheckpointError: there is no run.
    """
    run = RunDirectory(Path(directory))
    _ = run.config
    return run


def recorded_config(path: Path) -> dict[str, Any] | None:
    """`config.json` of the run in `path`; None where there is none yet."""
    return RunDirectory(path).config if (path / "config.json").exists() else None


def _evaluator(settings: RunSettings) -> Evaluator | None:
    if settings.evaluate is None or isinstance(settings.evaluate, Evaluator):
        return settings.evaluate
    raise ConfigError(
        f"evaluate: {type(settings.evaluate).__name__} only describes an evaluation; odaf.fit plays it, and "
        "odaf.training.fit needs something to call with (policy, directory, step)"
    )


def _cores(settings: RunSettings, apart: bool) -> int:
    """Cores that the training will really be laid out for."""
    return settings.cores if apart and settings.cores is not None else usable_cores()


def _note_process(run: RunDirectory, process: dict[str, Any], report: ProgressReport) -> None:
    """Adds this process to the run's record, and says beforehand if it cannot give the same bits."""
    path = run.path / "environment.json"
    environment = read_json(path, "It is needed only for the record: put {} into it to go on.")
    resumed = environment.get("resumed", [])
    reasons = why_bits_differ([environment, *resumed][-1], process)
    if reasons:
        report.message(f"{run.path}: {reasons}; the run goes on, but not with the bits of an unbroken one")
    write_json(path, {**environment, "resumed": [*resumed, process]})


def _evaluate_ends_again(run: RunDirectory) -> None:
    """Marks seeds that are at their end as not evaluated, because their score would be one of other settings."""
    for seed in run.seeds:
        for checkpoint in run.checkpoints(seed)[-1:]:
            summary = checkpoint.header()["summary"]
            if checkpoint.step >= run.config["steps"] and summary["status"] == "finished":
                summary |= {"evaluation_due": True, "status": "running"}
                checkpoints.rewrite_record(checkpoint, {"summary": summary})


def _unfinished(
    run: RunDirectory,
    settings: RunSettings,
    evaluate: Evaluator | None,
    report: ProgressReport,
    resuming: dict[str, Any] | None,
) -> list[SeedTraining]:
    """The seeds that are not at their end; `resuming` is the record of this process if an earlier one began the run."""
    run_writing.remove_unfinished(run.path, recursive=False)
    seeds = [SeedTraining(run, seed, evaluate, settings.on_divergence, report) for seed in run.seeds]
    for seed in seeds:
        if seed.is_finished():
            seed.tidy_up()
        elif seed.checkpoint is None and (reached := run.summary(seed.seed)["step"]):
            report.message(
                f"{seed.directory}: had made {reached:,} updates, and its checkpoints are gone; it is trained from the "
                "beginning"
            )
    unfinished = [seed for seed in seeds if not seed.is_finished()]
    if unfinished and resuming is not None:
        _note_process(run, resuming, report)
    return unfinished


def _train(
    seeds: Sequence[SeedTraining],
    dataset: Dataset,
    settings: RunSettings,
    report: ProgressReport,
    loggers: Sequence[Logger],
    train_seeds: TrainSeeds,
) -> None:
    try:
        if seeds:
            with products_in(settings.precision):
                train_seeds(seeds, dataset, loggers)
    finally:
        report.close()
