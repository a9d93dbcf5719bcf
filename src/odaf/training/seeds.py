"""One seed of a run: from its last checkpoint, or from nothing, to the last update."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from odaf.data.dataset import Dataset
from odaf.data.sampling import Columns, training_column_shapes, training_columns
from odaf.errors import DivergenceError
from odaf.training import checkpoints, loop, run_directory
from odaf.training.evaluator import Evaluator
from odaf.training.files import write_json
from odaf.training.logging import JsonLines, Logger
from odaf.training.memory import give_back_freed_memory
from odaf.training.monitors import DivergenceMonitor, TrainingWarning
from odaf.training.progress import ProgressReport
from odaf.training.run_directory import RunDirectory


@dataclass(frozen=True)
class TrainingData:
    """What all seeds of a run that train in one process share."""

    dataset: Dataset
    columns: Columns
    train: loop.CompiledStretch
    compile_seconds: float


def prepare(run: RunDirectory, dataset: Dataset, compiling: Callable[[], None]) -> TrainingData:
    """Compiles a run's training, then puts its data on the device.

    In this order because the compiler needs more memory than all else: it has freed its own before the data need any.

    Args:
        run: its learner and normaliser are used.
        dataset: the data it trains on.
        compiling: called before compilation starts, which takes seconds.
    """
    learner = run.algorithm
    compiling()
    began = time.perf_counter()
    shapes = training_column_shapes(dataset, learner.view())
    train = loop.compiled_stretch(learner, shapes, run_directory.blank_state(learner, run.spec))
    give_back_freed_memory()
    took = time.perf_counter() - began
    columns = training_columns(dataset, run.normaliser, learner.view())
    return TrainingData(dataset, columns, train, took)


def compiling_stage(seed: int) -> str:
    """What a progress report calls the stage before the first update is there."""
    return f"seed {seed}: compiling"


def training_stage(seed: int) -> str:
    """What a progress report calls the stage that counts updates."""
    return f"seed {seed}: training"


@dataclass
class _Record:
    """What a checkpoint remembers beside the state."""

    seconds: dict[str, float]
    pretrain: dict[str, Any]
    warnings: list[TrainingWarning]
    evaluation: dict[str, Any] | None = None
    status: str = "running"


class SeedTraining:
    """One seed's way from its last checkpoint to the last step."""

    def __init__(
        self,
        run: RunDirectory,
        seed: int,
        evaluate: Evaluator | None,
        on_divergence: str,
        progress: ProgressReport,
    ):
        self.run, self.seed, self.evaluate, self.progress = run, seed, evaluate, progress
        self.stops_on_divergence = on_divergence == "stop"
        self.directory = run.seed_directory(seed)
        self.steps: int = run.config["steps"]
        self.stretch: int = run.config["stretch"]
        self.checkpoint_every: int = run.config["checkpoint_every"]
        found = run.checkpoints(seed)
        self.checkpoint = found[-1] if found else None
        self.step = self.checkpoint.step if self.checkpoint else 0
        self.record = _Record({}, {}, [])
        if self.checkpoint:
            summary = self.checkpoint.header()["summary"]
            self.record = _Record(
                summary["seconds"],
                summary["pretrain"],
                [TrainingWarning(**warning) for warning in summary["warnings"]],
                summary["evaluation"],
                summary["status"],
            )

    def is_finished(self) -> bool:
        """Whether the last checkpoint is the last one asked for; it was evaluated before it was written."""
        return self.step >= self.steps

    def go(self, data: TrainingData, loggers: Sequence[Logger]) -> None:
        """Trains to the last step, with the files in a state to be continued after every write.

        The record counts the compilation of `data` although seeds may share it: alone, each would need it.

        Raises:
            DivergenceError: as `odaf.training.fit.fit`.
        """
        self.directory.mkdir(exist_ok=True)
        run_directory.clean(self.directory, self.step)
        self.began = time.perf_counter() - self.record.seconds.get("total", 0.0)
        self.began -= data.compile_seconds
        _add(self.record.seconds, "compile", data.compile_seconds)
        state = self.run.state(self.seed, self.step) if self.checkpoint else self._first_state(data.dataset)
        lines = JsonLines()
        everyone = (lines, *loggers)
        try:
            for logger in everyone:
                logger.open(self.directory, self.step)
            self._go_on(loop.donatable(state), data, everyone, lines)
        finally:
            for logger in everyone:
                logger.close()

    def _first_state(self, dataset: Dataset) -> Any:
        run, began = self.run, time.perf_counter()
        key = loop.pretrain_key(self.seed)
        stages: set[str] = set()

        def report(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages.add(stage)
                self.progress.start(f"seed {self.seed}: {stage}", total)
            self.progress.advance(done)

        models, findings = run.algorithm.pretrain(dataset, run.normaliser, key, report)
        for sentence in findings.get("warnings", []):
            self._warn(TrainingWarning("pretrain", 0, sentence))
        self.record.pretrain = {name: value for name, value in findings.items() if name != "warnings"}
        self.record.seconds["pretrain"] = time.perf_counter() - began
        state = loop.first_state(run.algorithm, run.spec, loop.init_key(self.seed), models)
        self._save(state)
        return state

    def _go_on(self, state: Any, data: TrainingData, loggers: Sequence[Logger], lines: JsonLines) -> None:
        run, record, seconds = self.run, self.record, self.record.seconds
        monitor = DivergenceMonitor(
            run.spec, run.algorithm.view().discount, run.config["algorithm"], seen={w.kind for w in record.warnings}
        )
        key = loop.training_key(self.seed)
        record.status = "running"
        self.write_summary()
        self.progress.start(training_stage(self.seed), self.steps, self.step)
        while self.step < self.steps:
            stop = self._next_stop()
            first, last = loop.update_number(self.step), loop.update_number(stop)
            began = time.perf_counter()
            state, reduced = data.train(data.columns, key, first, last, state)
            metrics = {name: float(value) for name, value in jax.device_get(reduced).items()}
            took = time.perf_counter() - began
            _add(seconds, "train", took)
            timing = {"time/updates_per_second": (stop - self.step) / took}
            self.step = stop
            timing["time/seconds"] = time.perf_counter() - self.began
            for logger in loggers:
                logger.log(stop, {**metrics, **timing})
            diverged = monitor.observe(stop, metrics)
            for warning in diverged:
                self._warn(warning)
            lost = not all(map(math.isfinite, metrics.values())) and not loop.is_finite(state)
            stopped = lost or (bool(diverged) and self.stops_on_divergence)
            at_end = self.step >= self.steps
            if self.evaluate is not None and not lost and (at_end or self.step % self.evaluate.every == 0):
                self._measure(state, self.evaluate, loggers)
            if stopped or at_end or self.step % self.checkpoint_every == 0:
                record.status = "diverged" if stopped else "finished" if at_end else "running"
                lines.sync()
                self._save(state)
            self.progress.advance(self.step)
            if lost:
                first = next(warning for warning in record.warnings if warning.kind == "not-finite")
                raise DivergenceError(
                    f"{self.directory}: after update {self.step:,} the parameters are not finite numbers, and nothing "
                    "can be learned from there. Earlier checkpoints are sound; train again into another directory. "
                    f"{first.message}"
                )
            if stopped:
                raise DivergenceError(
                    f"{self.directory}: {diverged[0].message} The state was saved at step {self.step}; "
                    f"`odaf resume {run.path} --on-divergence warn` goes on regardless."
                )

    def _next_stop(self) -> int:
        intervals = [self.stretch, self.checkpoint_every]
        if self.evaluate is not None:
            intervals.append(self.evaluate.every)
        return min(self.steps, *((self.step // interval + 1) * interval for interval in intervals))

    def _measure(self, state: Any, evaluate: Evaluator, loggers: Sequence[Logger]) -> None:
        began = time.perf_counter()
        run = self.run
        found = evaluate(run.policy_of(state), self.directory, self.step)
        _add(self.record.seconds, "evaluate", time.perf_counter() - began)
        self.record.evaluation = {"step": self.step, **found.summary}
        for logger in loggers:
            logger.log(self.step, found.metrics)
        self.progress.advance(self.step, f"return {found.headline:,.1f}")

    def _warn(self, warning: TrainingWarning) -> None:
        self.record.warnings.append(warning)
        self.progress.message(f"seed {self.seed}: {warning.message}")

    def _summary(self) -> dict[str, Any]:
        seconds = self.record.seconds
        train = seconds.get("train", 0.0)
        return {
            "seed": self.seed,
            "step": self.step,
            "status": self.record.status,
            "evaluation": self.record.evaluation,
            "updates_per_second": self.step / train if train else None,
            "seconds": {name: seconds.get(name, 0.0) for name in ("pretrain", "compile", "train", "evaluate", "total")},
            "pretrain": self.record.pretrain,
            "warnings": [warning.to_dict() for warning in self.record.warnings],
        }

    def _save(self, state: Any) -> None:
        self.record.seconds["total"] = time.perf_counter() - self.began
        record = {"seed": self.seed, "summary": self._summary()}
        self.checkpoint = checkpoints.save(self.directory / "checkpoints", self.step, state, record)
        self.write_summary()

    def write_summary(self) -> None:
        """Writes `summary.json`, which says what the last checkpoint's header says."""
        write_json(self.directory / "summary.json", self._summary())


def _add(seconds: dict[str, float], name: str, more: float) -> None:
    seconds[name] = seconds.get(name, 0.0) + more
