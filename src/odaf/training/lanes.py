"""Many trainings in one compiled program, each a run's seed in its own files, as if it were alone.

Lanes of one program have one structure: the same learner but for its traced numbers, the same sizes, the same course of
updates, checkpoints and evaluations. They differ in seed, in numbers, and in the data set they draw from; of learners
that can be padded, in its widths too.

The program has a fixed number of lanes. Where fewer are left to train, the rest repeat the first one, so that a
training that is gone on with meets the program it was begun in, and keeps its bits, whoever is trained beside it.
"""

import contextlib
import copy
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from odaf.algorithms.base import Algorithm
from odaf.algorithms.numbers import split
from odaf.components.together import run_together
from odaf.data.dataset import Dataset
from odaf.data.padding import Padding
from odaf.data.sampling import Columns, WeightedColumns, padded_columns, training_column_shapes, training_columns
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError, OdafError
from odaf.training import loop, run_directory
from odaf.training.combined_progress import CombinedProgress, SeedReport
from odaf.training.files import write_json
from odaf.training.interrupts import held_back
from odaf.training.logging import Logger
from odaf.training.memory import forget_programs_in_time, give_back_freed_memory
from odaf.training.progress import ProgressReport
from odaf.training.seeds import SeedTraining
from odaf.training.settings import products_in
from odaf.training.widths import PaddedState, Widths, widths_of, with_widths

# Share of an accelerator's memory that a program may take.
_SHARE_OF_MEMORY = 0.9
# Field of `config.json` of a run whose program has fewer lanes than `lanes` says.
_FITTED = "lanes_that_fit"
# Side models that are trained together: each has the rows that it learns from, and those may be many.
_BEGUN_AT_ONCE = 32


@dataclass(frozen=True)
class Lane:
    """One training: a seed of a run, and the data it learns from."""

    seed: SeedTraining
    dataset: Dataset

    @property
    def name(self) -> str:
        """What the user knows it by."""
        return f"{self.seed.run.path}, seed {self.seed.seed}"


def program_of(algorithm: Algorithm, dataset: Dataset) -> tuple[Any, ...]:
    """What decides the compiled program of a training; trainings that agree in it can be lanes of one."""
    structure = split(algorithm)[0]
    # Where batches are mixed from two parts, the border between them is part of the program.
    mixed = None if dataset.mixture is None else (id(dataset), algorithm.drawn_view())
    spec = dataset.spec()
    return structure, None if algorithm.can_be_padded() else widths_of(spec), algorithm.sizes(spec), mixed


def train_in_lanes(
    lanes: Sequence[Lane],
    width: int,
    loggers: Sequence[Logger],
    report: ProgressReport,
    asked_to_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Trains all of them to their ends, `width` at a time.

    A lane that diverges or fails lets the others go on; then its error is raised.

    Args:
        lanes: of one program, see `program_of`, and of runs with the same settings.
        width: lanes of the program.
        loggers: receivers of metrics; each lane has a copy.
        report: where progress is shown.
        asked_to_stop: asked after every stretch; once it says so, all lanes are saved.

    Raises:
        DivergenceError: as `odaf.training.fit.fit`, of the first lane that diverged.
        KeyboardInterrupt: somebody pressed Ctrl-C, or `asked_to_stop` says so; all lanes are saved first.
    """
    report.start(f"{len(lanes)} lanes: compiling", 0)
    program = _Program(
        lanes, min((fitted for lane in lanes if (fitted := lane.seed.run.config.get(_FITTED))), default=width)
    )
    if program.width < width:
        _keep_width(lanes, program.width, report)
    parts = [lanes[start : start + program.width] for start in range(0, len(lanes), program.width)]
    if len(parts) > 1:
        report.message(f"{len(lanes)} trainings take turns in a program of {program.width} lanes")
        for number, part in enumerate(parts, 1):
            report.message(f"turn {number} of {len(parts)}: {_in_words(part)}")
    failures: list[OdafError] = []
    for part in parts:
        failures += _train(part, program, loggers, report, asked_to_stop)
    if failures:
        raise failures[0]


class _Program:
    """The compiled training, and the rows of all data sets that its lanes draw from."""

    def __init__(self, lanes: Sequence[Lane], width: int):
        forget_programs_in_time()
        learner, spec = lanes[0].seed.run.algorithm, lanes[0].seed.run.spec
        sources: dict[Any, Lane] = {}
        for lane in lanes:
            sources.setdefault(_source(lane), lane)
        self._places = {source: index for index, source in enumerate(sources)}
        began = time.perf_counter()
        padded = _widths(lanes)
        shapes = [
            training_column_shapes(lane.dataset, lane.seed.run.algorithm.drawn_view()) for lane in sources.values()
        ]
        together = jax.eval_shape(functools.partial(_joined, padded), shapes)
        state = run_directory.blank_state(learner, spec if padded is None else with_widths(spec, padded))
        specs = {widths_of(lane.seed.run.spec): lane.seed.run.spec for lane in lanes}
        self._padded = {} if padded is None else {own: PaddedState(learner, specs[own], padded) for own in specs}
        self._own_widths = tuple(sorted(self._padded))
        self.width, self.train = _that_fits(
            lambda lanes: loop.compiled_lanes(learner, together, len(shapes) > 1, state, lanes, self._own_widths), width
        )
        give_back_freed_memory()
        self.compile_seconds = time.perf_counter() - began
        columns = [
            training_columns(lane.dataset, lane.seed.run.normaliser, lane.seed.run.algorithm.drawn_view())
            for lane in sources.values()
        ]
        self._rows = [_rows(each) for each in columns]
        if len(columns) > 1 or padded is not None:
            join = jax.jit(functools.partial(_joined, padded))
            self.columns = jax.block_until_ready(join(columns))
        else:
            self.columns = columns[0]

    def filled(self, lanes: Sequence[Any]) -> list[Any]:
        """As many as the program has lanes: the first one again for those that are missing."""
        return [*lanes, *[lanes[0]] * (self.width - len(lanes))]

    def stacked(self, lanes: Sequence[Lane], states: Sequence[Any]) -> Any:
        """The lanes' states, of as many lanes as the program has."""
        if self._padded:
            states = [
                self._padded[widths_of(lane.seed.run.spec)].pad(each) for lane, each in zip(lanes, states, strict=True)
            ]
        return loop.stacked(self.filled(states))

    def lane(self, states: Any, place: int, lane: Lane) -> Any:
        """The state of one lane, at its own widths."""
        if self._padded:
            return self._padded[widths_of(lane.seed.run.spec)].lane(states, place)
        return loop.lane(states, place)

    def padding(self, lanes: Sequence[Lane]) -> Padding | None:
        """What each lane's batches have of their own."""
        own = [widths_of(lane.seed.run.spec) for lane in lanes]
        return loop.padding_of(own, self._own_widths) if self._padded else None

    def slabs(self, lanes: Sequence[Lane]) -> loop.Slabs | None:
        """Where each lane's rows lie."""
        if len(self._rows) == 1:
            return None
        places = [self._places[_source(lane)] for lane in lanes]
        firsts = [sum(self._rows[:place]) for place in places]
        return jnp.asarray(firsts, jnp.int32), jnp.asarray([self._rows[place] for place in places], jnp.int32)


def _train(
    lanes: Sequence[Lane],
    program: _Program,
    loggers: Sequence[Logger],
    report: ProgressReport,
    asked_to_stop: Callable[[], bool],
) -> list[OdafError]:
    """Trains one lane or several, at most as many as the program has; returns what went wrong with some of them."""
    combined = CombinedProgress(
        {place: lane.seed.step for place, lane in enumerate(lanes)}, lanes[0].seed.steps, report, f"{len(lanes)} lanes"
    )
    for place, lane in enumerate(lanes):
        lane.seed.progress = SeedReport(place, combined.receive, str(lane.seed.run.path))
    lanes, failures = _begin(lanes, program.width, report)
    if not lanes:
        return failures
    seeds = [lane.seed for lane in lanes]
    places = range(len(seeds))
    all_lanes = program.filled(lanes)
    _, numbers = loop.split_lanes([lane.seed.run.algorithm for lane in all_lanes])
    slabs, padding = program.slabs(all_lanes), program.padding(all_lanes)
    keys = jnp.stack([loop.training_key(lane.seed.seed) for lane in all_lanes])
    told = functools.partial(report.message, "stopping; lanes save after this stretch (Ctrl-C again: stops at once)")
    with contextlib.ExitStack() as stack:
        begun = []
        for lane in lanes:
            own = [copy.deepcopy(logger) for logger in loggers]
            begun.append(stack.enter_context(lane.seed.opened(lane.dataset, program.compile_seconds, own)))
        states = program.stacked(lanes, begun)
        begun.clear()
        going = [place for place in places if seeds[place].step < seeds[place].steps]
        stopping = False
        with held_back(told) as interrupt:
            while going and not stopping:
                step = min(seeds[place].step for place in going)  # who was stopped earlier catches up first
                moving = [place for place in going if seeds[place].step == step]
                stop = min(seeds[place].next_stop() for place in moving)
                kept = None if len(moving) == len(going) else jax.tree.map(jnp.copy, states)
                first, last = loop.update_number(step), loop.update_number(stop)
                began = time.perf_counter()
                states, reduced = program.train(numbers, program.columns, slabs, keys, first, last, states, padding)
                interrupt.wait_for(reduced)
                metrics = jax.device_get(reduced)
                took = time.perf_counter() - began
                if kept is not None:
                    states = _merged(states, kept, [place in moving for place in range(program.width)])
                stopping = interrupt.came or asked_to_stop()  # once, so that all lanes are saved at one update
                for place in moving:
                    own = {name: float(values[place]) for name, values in metrics.items()}
                    state = functools.partial(program.lane, states, place, lanes[place])
                    try:
                        seeds[place].trained_to(stop, own, took, state, stopping)
                    except KeyboardInterrupt:
                        continue
                    except OdafError as error:
                        report.message(f"{lanes[place].name}: {error}")
                        failures.append(error)
                        going.remove(place)
                going = [place for place in going if seeds[place].step < seeds[place].steps]
        stopping = stopping or interrupt.came
        for lane in lanes if not stopping else ():
            try:
                lane.seed.collect()
            except OdafError as error:
                report.message(f"{lane.name}: {error}")
                failures.append(error)
        if stopping:
            raise KeyboardInterrupt(f"{len(going)} lanes are saved at update {min(seed.step for seed in seeds):,}")
    return failures


def _begin(lanes: Sequence[Lane], width: int, report: ProgressReport) -> tuple[list[Lane], list[OdafError]]:
    """Trains the models that are needed beforehand, in lanes too, and once for lanes that need the same ones.

    Returns:
        The lanes that have them, and what went wrong with the others.
    """
    alike: dict[Any, list[int]] = {}
    for place, lane in enumerate(lanes):
        if lane.seed.checkpoint is None:
            key = (_source(lane), lane.seed.seed, lane.seed.run.algorithm.pretraining())
            alike.setdefault(key, []).append(place)
    groups, failures = list(alike.values()), dict[int, OdafError]()
    width = min(width, _BEGUN_AT_ONCE)
    for start in range(0, len(groups), width):
        part = groups[start : start + width]
        begun = run_together(
            [functools.partial(_begin_alike, [lanes[place] for place in group]) for group in part], width
        )
        for group, outcome in zip(part, begun, strict=True):
            if isinstance(outcome, OdafError):
                for place in group:
                    report.message(f"{lanes[place].name}: {outcome}")
                    failures[place] = outcome
            elif isinstance(outcome, Exception):
                raise outcome
    able = [lane for place, lane in enumerate(lanes) if place not in failures]
    return able, [failures[place] for place in sorted(failures)]


def _begin_alike(lanes: Sequence[Lane]) -> None:
    first, *others = lanes
    with products_in(first.seed.run.config["precision"]):  # JAX keeps what is set for a block by thread
        models = first.seed.begin(first.dataset)
        for lane in others:
            lane.seed.begin(lane.dataset, models)


def _that_fits(compile_for: Callable[[int], Any], width: int) -> tuple[int, Any]:
    """(lanes, program) with `width` lanes, or with those of even turns, as few as an accelerator's memory allows."""
    limit, asked = (jax.devices()[0].memory_stats() or {}).get("bytes_limit"), width
    while True:
        program = compile_for(width)
        needs = program.memory_analysis()
        if limit is None or needs is None:
            return width, program
        needed = needs.argument_size_in_bytes + needs.output_size_in_bytes + needs.temp_size_in_bytes
        needed -= needs.alias_size_in_bytes
        allowed = _SHARE_OF_MEMORY * limit
        if needed <= allowed:
            return width, program
        if width == 1:
            raise ConfigError(
                f"a training needs {needed / 1e9:.1f} GB, and the device has {limit / 1e9:.1f}; take a smaller batch "
                "or fewer critics"
            )
        most = max(1, min(width - 1, int(width * allowed / needed)))  # memory grows with the lanes
        turns = -(-asked // most)
        width = -(-asked // turns)


def _keep_width(lanes: Sequence[Lane], width: int, report: ProgressReport) -> None:
    """Notes how many lanes the memory held, so that a run that is gone on with alone meets a program of as many."""
    for run in {lane.seed.run.path: lane.seed.run for lane in lanes}.values():
        known = run.config.get(_FITTED)
        if known is not None and known != width:
            report.message(
                f"{run.path}: was begun in a program of {known} lanes, and this memory holds {width}; the run goes on, "
                "but not with the bits of an unbroken one"
            )
        if known != width:
            write_json(run.path / "config.json", {**run.config, _FITTED: width})


def _in_words(lanes: Sequence[Lane]) -> str:
    """Runs and seeds that are trained together."""
    seeds: dict[str, list[int]] = {}
    for lane in lanes:
        seeds.setdefault(str(lane.seed.run.path), []).append(lane.seed.seed)
    return "; ".join(f"{path}: seeds {' '.join(map(str, own))}" for path, own in seeds.items())


def _source(lane: Lane) -> tuple[Any, ...]:
    """What decides which rows a lane sees."""
    return id(lane.dataset), lane.seed.run.algorithm.drawn_view()


def _rows(columns: Columns) -> int:
    return columns.rewards.shape[0] if isinstance(columns, Transitions | WeightedColumns) else 0


def _joined(padded: Widths | None, columns: Sequence[Any]) -> Any:
    if padded is not None:
        columns = [padded_columns(each, padded) for each in columns]
    return columns[0] if len(columns) == 1 else jax.tree.map(lambda *parts: jnp.concatenate(parts), *columns)


def _widths(lanes: Sequence[Lane]) -> Widths | None:
    """What the lanes are padded to, as their runs say.

    Raises:
        ConfigError: the learner cannot be padded, or a data set is wider.
    """
    asked = lanes[0].seed.run.config.get("widths")
    if asked is None:
        return None
    for lane in lanes:
        own = widths_of(lane.seed.run.spec)
        if not lane.seed.run.algorithm.can_be_padded():
            raise ConfigError(
                f"widths: {lane.seed.run.algorithm.kind} has no padded form with these settings; leave them out, and "
                "data sets of other widths get a program of their own"
            )
        if own[0] > asked[0] or own[1] > asked[1]:
            raise ConfigError(
                f"widths: {tuple(asked)} asked, but the data of {lane.seed.run.path} have {own[0]} observations and "
                f"{own[1]} actions; ask for as many at least"
            )
    return asked[0], asked[1]


def _merged(after: Any, before: Any, moved: Sequence[bool]) -> Any:
    """`after` for the lanes that moved, `before` for the others."""
    which = jnp.asarray(moved)

    def chosen(new: jax.Array, old: jax.Array) -> jax.Array:
        mask = which.reshape(-1, *[1] * (new.ndim - 1))
        return jnp.where(mask, new, old)

    return jax.tree.map(chosen, after, before)
