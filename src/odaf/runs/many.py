"""Several runs at once: every combination of data sets and settings, each a run of its own with all its seeds.

Runs whose learners differ in numbers alone become lanes of one compiled program where that is asked for, or where there
is an accelerator; elsewhere one run follows the other, each with its workers.
"""

import contextlib
import itertools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

from odaf.algorithms import config
from odaf.algorithms.base import Algorithm
from odaf.algorithms.numbers import split
from odaf.algorithms.registry import register_parts
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import Rollouts
from odaf.evaluation.runs import Run
from odaf.runs import fit as single
from odaf.training.fit import open_run, recorded_config
from odaf.training.lanes import Lane, program_of, train_in_lanes
from odaf.training.logging import Logger
from odaf.training.progress import ProgressReport, default_progress
from odaf.training.settings import RunSettings, SettingChanges, default_lanes, products_in
from odaf.training.widths import Widths, widths_of


@dataclass(frozen=True)
class Plan:
    """One run among several.

    Attributes:
        algorithm: the learner's settings.
        dataset: logged data. Runs that share one object share its place on the device.
        directory: where the run is written.
        preset: name under which the learner's settings are known.
        data_path: the file that `dataset` was read from.
        seeds: in place of those in the settings.
        evaluated: False tries no policy of this run, as where its data name no environment.
        advice: what chose the preset, for the record.
    """

    algorithm: Algorithm
    dataset: Dataset
    directory: Path
    preset: str | None = None
    data_path: Path | None = None
    seeds: tuple[int, ...] | None = None
    evaluated: bool = True
    advice: Mapping[str, Any] | None = None

    def number(self, settings: RunSettings) -> int:
        """How many trainings it is."""
        return len(self.seeds or settings.seeds)

    def settings_of(self, settings: RunSettings) -> RunSettings:
        """How this run is to go, where `settings` say it for all."""
        evaluate = settings.evaluate if self.evaluated else None
        return replace(settings, seeds=self.seeds or settings.seeds, evaluate=evaluate)


def combinations(
    algorithm: Algorithm,
    data: Sequence[str | os.PathLike[str]],
    values: Mapping[str, Sequence[Any]],
    directory: str | os.PathLike[str],
    preset: str | None = None,
    advice: Mapping[str, Any] | None = None,
) -> list[Plan]:
    """A run for each combination of data sets and values of settings, in a folder named by what sets it apart.

    Args:
        algorithm: the learner that the values change.
        data: files of data sets.
        values: for each setting by its dotted name, such as `outcome.weight`, the values it takes.
        directory: the folder of all runs; where there is one combination alone, its run itself.
        preset: name under which the learner's settings are known.
        advice: what chose the preset, for the record.

    Raises:
        ConfigError: a setting does not exist, a value is of the wrong type, or two combinations are the same.
        DatasetError: a file cannot be read.
    """
    register_parts(algorithm)  # values are written into its record, which is read back by its name
    paths, folder = [Path(file) for file in data], Path(directory)
    if (folder / "config.json").exists() and (len(paths) > 1 or any(len(each) > 1 for each in values.values())):
        raise ConfigError(f"{folder}: holds a run; several runs need a folder of their own: give another with --out")
    if len({path.resolve() for path in paths}) < len(paths):
        raise ConfigError(f"data: a file is named twice: {', '.join(map(str, paths))}")
    names = [path.stem if _stems_differ(paths) else re.sub(r"[\\/]+", "-", str(path.with_suffix(""))) for path in paths]
    sets = [Dataset.load(path) for path in paths]
    found: dict[Path, Plan] = {}
    for place, chosen in itertools.product(range(len(paths)), itertools.product(*values.values())):
        settings = dict(zip(values, chosen, strict=True))
        parts = [names[place]] if len(paths) > 1 else []
        parts += [f"{name}={_word(value)}" for name, value in settings.items() if len(values[name]) > 1]
        where = folder / ",".join(parts) if parts else folder
        if where in found:
            raise ConfigError(f"set: two runs would be written to {where}; give every value once")
        learner = config.replace(algorithm, settings, "set") if settings else algorithm
        found[where] = Plan(learner, sets[place], where, preset, paths[place], advice=advice)
    return list(found.values())


def fit_many(
    runs: Sequence[Plan],
    *,
    settings: RunSettings | None = None,
    progress: bool | ProgressReport = True,
    loggers: Sequence[Logger] = (),
    asked_to_stop: Callable[[], bool] = lambda: False,
    **changes: Unpack[SettingChanges],
) -> list[Run]:
    """Trains every run with all its seeds; the same call again goes on where it was stopped.

    Each run is as if it had been trained alone: its own directory, checkpoints, metrics, warnings and evaluations, and
    `odaf resume` goes on with one of them. With lanes, one that diverges stops alone.

    Args:
        runs: of `combinations`, or made by hand.
        settings: how every run is to go.
        progress: whether to show a progress bar.
        loggers: receivers of metrics; each training has a copy.
        asked_to_stop: asked after every stretch of lanes; once it says so they are saved as by Ctrl-C.
        **changes: fields of `RunSettings` by name; they go before those in `settings`.

    Raises:
        ConfigError: as `odaf.fit`.
        DivergenceError: as `odaf.fit`, of the first training that diverged; the others are brought to their ends first.
    """
    settings = (settings or RunSettings()).with_changes(dict(changes))
    report = default_progress(progress)
    wanted = settings.lanes or default_lanes(sum(plan.number(settings) for plan in runs))
    programs = _programs(runs, settings)
    if wanted > 1:
        for line in _in_words(programs):
            report.message(line)
    if isinstance(settings.evaluate, Rollouts) and len({id(plan.dataset) for plan in runs}) > 1:
        # All before the first: the turn of a later one may come hours after.
        for plan in {id(plan.dataset): plan for plan in runs if plan.evaluated}.values():
            single.close(single.evaluator_for(settings, plan.dataset))
    done: dict[Path, Run] = {}
    for widths, together in programs:
        lanes = min(wanted, sum(plan.number(settings) for plan in together))
        begun = max((config.get("lanes", 1) for config in _begun(together)), default=1)
        if begun > 1 and begun <= (settings.lanes or begun):
            lanes = begun  # though some of them may be done and not named again
        if lanes > 1:
            own = replace(settings, lanes=lanes, widths=widths)
            done |= _in_lanes(together, own, report, loggers, asked_to_stop)
            continue
        for plan in together:
            done[plan.directory] = single.fit(
                plan.algorithm,
                plan.dataset,
                directory=plan.directory,
                settings=replace(plan.settings_of(settings), lanes=1, widths=None),
                progress=report,
                preset=plan.preset,
                data_path=plan.data_path,
                advice=plan.advice,
                loggers=loggers,
            )
    return [done[plan.directory] for plan in runs]


def _in_lanes(
    runs: Sequence[Plan],
    settings: RunSettings,
    report: ProgressReport,
    loggers: Sequence[Logger],
    asked_to_stop: Callable[[], bool],
) -> dict[Path, Run]:
    lanes: list[Lane] = []
    found: dict[Path, Run] = {}
    with contextlib.ExitStack() as stack:
        players = single.players_for(single.resolved(settings, runs[0].directory))
        stack.callback(single.close, players)
        for plan in runs:
            own = single.resolved(plan.settings_of(settings), plan.directory)
            evaluator = single.evaluator_for(own, plan.dataset, players)
            stack.callback(single.close, evaluator)
            opened = open_run(
                plan.algorithm,
                plan.dataset,
                directory=plan.directory,
                settings=replace(own, evaluate=evaluator),
                report=report,
                preset=plan.preset,
                data_path=plan.data_path,
                advice=plan.advice,
            )
            run, seeds = stack.enter_context(opened)
            found[plan.directory] = Run(run)
            lanes += [Lane(seed, plan.dataset) for seed in seeds]
        stack.callback(report.close)
        if lanes:
            with products_in(lanes[0].seed.run.config["precision"]):
                train_in_lanes(lanes, settings.lanes or 1, loggers, report, asked_to_stop)
    return found


def _programs(runs: Sequence[Plan], settings: RunSettings) -> list[tuple[Widths | None, list[Plan]]]:
    """Runs that share a program if they are lanes, and the widths that they are padded to."""
    structures: dict[Any, list[Plan]] = {}
    for plan in runs:
        structures.setdefault(program_of(plan.algorithm, plan.dataset), []).append(plan)
    programs: list[tuple[Widths | None, list[Plan]]] = []
    for together in structures.values():
        own: dict[Widths, list[Plan]] = {}
        for plan in together:
            own.setdefault(widths_of(plan.dataset.spec()), []).append(plan)
        begun = _begun(together)
        padded = [config["widths"] for config in begun if config.get("widths")]
        if padded:  # what is gone on with keeps its program
            programs.append(((padded[0][0], padded[0][1]), together))
        elif begun:
            programs += [(None, plans) for plans in own.values()]
        elif settings.widths is None and len(own) > 1:
            programs.append(((max(states for states, _ in own), max(actions for _, actions in own)), together))
        else:
            programs.append((settings.widths, together))
    return programs


def _begun(runs: Sequence[Plan]) -> list[dict[str, Any]]:
    """The records of those that are gone on with."""
    return [config for plan in runs if (config := recorded_config(plan.directory)) is not None]


def _in_words(programs: Sequence[tuple[Widths | None, list[Plan]]]) -> Iterator[str]:
    """What is trained together, and where not, why."""
    for number, (widths, together) in enumerate(programs, 1):
        padded = f"; observations and actions padded to {widths[0]} and {widths[1]}" if widths else ""
        if padded or len(programs) > 1:
            where = ", ".join(str(plan.directory) for plan in together)
            yield f"program {number} of {len(programs)}: {where}{padded}"
    apart: dict[Any, set[Widths]] = {}
    for _, (first, *_) in programs:
        if not first.algorithm.can_be_padded():
            apart.setdefault(split(first.algorithm)[0], set()).add(widths_of(first.dataset.spec()))
    for structure, widths in apart.items():
        if len(widths) > 1:
            yield f"{structure.kind} has no padded form with these settings: data sets of other widths train apart"


def _stems_differ(paths: Sequence[Path]) -> bool:
    return len({path.stem for path in paths}) == len(paths)


def _word(value: Any) -> str:
    """A value as part of a folder's name."""
    text = "x".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return re.sub(r"[^\w.+-]+", "_", text)
