"""One seed of a run: from its last checkpoint, or from nothing, to the last update."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import jax

from odaf.data.dataset import Dataset
from odaf.data.sampling import Columns, training_column_shapes, training_columns
from odaf.errors import DivergenceError
from odaf.training import checkpoints, loop, run_directory, run_writing
from odaf.training.checkpoints import Checkpoint
from odaf.training.evaluator import Evaluation, Evaluator, EvaluatorBeside
from odaf.training.files import write_json
from odaf.training.interrupts import Interrupt, held_back
from odaf.training.logging import JsonLines, Logger
from odaf.training.memory import forget_programs_in_time, give_back_freed_memory
from odaf.training.monitors import DivergenceMonitor, TrainingWarning
from odaf.training.progress import ProgressReport
from odaf.training.run_directory import RunDirectory
from odaf.training.settings import KeepCheckpoints

# Checkpoints whose evaluation beside the training may be under way; training waits for the oldest of more.
_MOST_BEHIND = 2
# What progress reports call the stage that counts updates.
TRAINING = "training"


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
    forget_programs_in_time()
    compiling()
    began = time.perf_counter()
    shapes = training_column_shapes(dataset, learner.drawn_view())
    train = loop.compiled_stretch(learner, shapes, run_directory.blank_state(learner, run.spec))
    give_back_freed_memory()
    took = time.perf_counter() - began
    columns = training_columns(dataset, run.normaliser, learner.drawn_view())
    return TrainingData(dataset, columns, train, took)


def compiling_stage(seed: int) -> str:
    """What a progress report calls the stage before the first update is there."""
    return f"seed {seed}: compiling"


def training_stage(seed: int) -> str:
    """What a progress report calls the stage that counts updates."""
    return f"seed {seed}: {TRAINING}"


@dataclass
class _Record:
    """What a checkpoint remembers beside the state."""

    seconds: dict[str, float]
    pretrain: dict[str, Any]
    warnings: list[TrainingWarning]
    evaluation: dict[str, Any] | None = None
    status: str = "running"
    evaluation_due: bool = False


@dataclass(frozen=True)
class _Pending:
    """An evaluation under way beside the training."""

    checkpoint: Checkpoint
    summary: dict[str, Any]
    found: Future[Evaluation]


@dataclass(frozen=True)
class Pretrained:
    """What a learner needs beforehand: models, what was found about them, and the seconds that they took."""

    models: Any
    findings: dict[str, Any]
    seconds: float


class SeedTraining:
    """One seed's way from its last checkpoint to the last step."""

    def __init__(
        self,
        run: RunDirectory,
        seed: int,
        evaluate: Evaluator | None,
        on_divergence: str,
        progress: ProgressReport,
        asked_to_stop: Callable[[], bool] = lambda: False,
    ):
        self.asked_to_stop = asked_to_stop
        self.run, self.seed, self.evaluate, self.progress = run, seed, evaluate, progress
        self.stops_on_divergence = on_divergence == "stop"
        self.directory = run.seed_directory(seed)
        self.steps: int = run.config["steps"]
        self.stretch: int = run.config["stretch"]
        self.checkpoint_every: int = run.config["checkpoint_every"]
        keep = run.config["keep_checkpoints"]
        self.keep: KeepCheckpoints = keep if keep == "all" else tuple(keep)
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
                summary.get("evaluation_due", False),
            )
        if evaluate is None:
            self.record.evaluation_due = False
        # Earlier checkpoints whose evaluation had not ended when the process did.
        self._overdue = [
            each for each in found[:-1] if evaluate is not None and each.header()["summary"].get("evaluation_due")
        ]
        self._pending: list[_Pending] = []
        self._interrupt: Interrupt | None = None  # while this seed is trained alone

    def is_finished(self) -> bool:
        """Whether the last checkpoint is the last one asked for, and all were evaluated that are to be."""
        return self.step >= self.steps and not self.record.evaluation_due and not self._overdue

    def tidy_up(self) -> None:
        """Brings the files of a finished seed up to date, wherever a kill left them."""
        assert self.checkpoint is not None
        if self.checkpoint.header()["summary"].get("evaluation_due"):  # it is not asked for any more
            self.record.status = "finished"
            checkpoints.rewrite_record(self.checkpoint, {"summary": self._summary()})
        self._prune()
        self.write_summary()

    def go(self, data: TrainingData, loggers: Sequence[Logger]) -> None:
        """Trains to the last step, with the files in a state to be continued after every write.

        The record counts the compilation of `data` although seeds may share it: alone, each would need it.

        Raises:
            DivergenceError: as `odaf.training.fit.fit`.
            KeyboardInterrupt: somebody pressed Ctrl-C, or `asked_to_stop` says so; the state is saved first.
        """
        key = loop.training_key(self.seed)
        with self.opened(data.dataset, data.compile_seconds, loggers) as state:
            with held_back(self._say_that_it_saves) as self._interrupt:
                while self.step < self.steps:
                    stop = self.next_stop()
                    first, last = loop.update_number(self.step), loop.update_number(stop)
                    began = time.perf_counter()
                    state, reduced = data.train(data.columns, key, first, last, state)
                    self._interrupt.wait_for(reduced)
                    metrics = {name: float(value) for name, value in jax.device_get(reduced).items()}
                    took = time.perf_counter() - began
                    self.trained_to(stop, metrics, took, lambda state=state: state, self._interrupt.came)
            if self._interrupt.came:  # in the last moment; what is trained after it is not to begin
                raise KeyboardInterrupt(f"seed {self.seed} is finished")
            self.collect()

    def begin(self, dataset: Dataset, pretrained: Pretrained | None = None) -> Pretrained | None:
        """Trains the models that the learner needs beforehand and saves the first state, unless that was done before.

        Args:
            dataset: to train on.
            pretrained: of another training that needs the same models, to take in place of training them.

        Returns:
            The models, for others that need the same; None if that was done before.

        Raises:
            DivergenceError: one of these models diverged.
        """
        if self.checkpoint is not None:
            return None
        self._open_directory()
        if pretrained is None:
            pretrained = self._pretrained(dataset)
        else:
            self.began -= pretrained.seconds  # alone, it would have taken them
        self._first_state(pretrained)
        return pretrained

    @contextlib.contextmanager
    def opened(self, dataset: Dataset, compile_seconds: float, loggers: Sequence[Logger]) -> Iterator[Any]:
        """A block in which the seed is trained: files cleaned, loggers open; gives the state to go on with.

        Args:
            dataset: for pre-training, if nothing is there yet.
            compile_seconds: what its training took to compile.
            loggers: receivers of metrics beside the seed's own file.
        """
        self._open_directory()
        self.began -= compile_seconds
        _add(self.record.seconds, "compile", compile_seconds)
        if self.checkpoint is None:
            state = loop.donatable(self._first_state(self._pretrained(dataset)))
        else:
            state = loop.donatable(self.run.state(self.seed, self.step))
        due = {each.step for each in self._overdue} | ({self.step} if self.record.evaluation_due else set())
        self._lines = JsonLines(due)
        self._loggers = (self._lines, *loggers)
        self._monitor = DivergenceMonitor(
            self.run.spec,
            self.run.algorithm.view().discount,
            self.run.config["algorithm"],
            seen={warning.kind for warning in self.record.warnings},
        )
        try:
            for logger in self._loggers:
                logger.open(self.directory, self.step)
            if self.step < self.steps or self.record.evaluation_due:
                self.record.status = "running"
            self.write_summary()
            self.progress.start(training_stage(self.seed), self.steps, self.step)
            for checkpoint in self._overdue:
                self._measure(self.run.state(self.seed, checkpoint.step), checkpoint)
            self._overdue = []
            if self.record.evaluation_due:
                assert self.checkpoint is not None
                self._measure(state, self.checkpoint)
            yield state
        finally:
            for pending in self._pending:  # what is left is due, and done when the run is gone on with
                pending.found.cancel()
            for logger in self._loggers:
                logger.close()

    def _open_directory(self) -> None:
        self.directory.mkdir(exist_ok=True)
        run_writing.clean(self.directory, self.step)
        self.began = time.perf_counter() - self.record.seconds.get("total", 0.0)

    def _pretrained(self, dataset: Dataset) -> Pretrained:
        run, began = self.run, time.perf_counter()
        key = loop.pretrain_key(self.seed)
        stages: set[str] = set()

        def report(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages.add(stage)
                self.progress.start(f"seed {self.seed}: {stage}", total)
            self.progress.advance(done)

        models, findings = run.algorithm.pretrain(dataset, run.normaliser, key, report)
        return Pretrained(models, findings, time.perf_counter() - began)

    def _first_state(self, found: Pretrained) -> Any:
        run = self.run
        for sentence in found.findings.get("warnings", []):
            self._warn(TrainingWarning("pretrain", 0, sentence))
        self.record.pretrain = {name: value for name, value in found.findings.items() if name != "warnings"}
        self.record.seconds["pretrain"] = found.seconds
        state = loop.first_state(run.algorithm, run.spec, loop.init_key(self.seed), found.models)
        self._save(state)
        return state

    def trained_to(
        self, stop: int, metrics: dict[str, float], took: float, state: Callable[[], Any], interrupted: bool = False
    ) -> None:
        """Takes note of a stretch: logs, watches, saves and evaluates as is due.

        Args:
            stop: updates that the seed has had now.
            metrics: of the stretch.
            took: its seconds.
            state: gives the learner's state; called only if it is needed.
            interrupted: whether to save and stop.

        Raises:
            DivergenceError: as `odaf.training.fit.fit`.
            KeyboardInterrupt: `interrupted`, or `asked_to_stop` says so; the state is saved first.
        """
        record = self.record
        self.collect(wait_for=_MOST_BEHIND)
        _add(record.seconds, "train", took)
        timing = {"time/updates_per_second": (stop - self.step) / took}
        self.step = stop
        timing["time/seconds"] = time.perf_counter() - self.began
        for logger in self._loggers:
            logger.log(stop, {**metrics, **timing})
        diverged = self._monitor.observe(stop, metrics)
        for warning in diverged:
            self._warn(warning)
        lost = not all(map(math.isfinite, metrics.values())) and not loop.is_finite(state())
        stopped = lost or (bool(diverged) and self.stops_on_divergence)
        at_end = self.step >= self.steps
        record.evaluation_due = (
            self.evaluate is not None and not lost and (at_end or self.step % self.evaluate.every == 0)
        )
        # Before it is evaluated, so that no environment can cost an update.
        interrupted = interrupted or self.asked_to_stop()
        if stopped or at_end or interrupted or record.evaluation_due or self.step % self.checkpoint_every == 0:
            evaluated = at_end and not record.evaluation_due
            record.status = "diverged" if stopped else "finished" if evaluated else "running"
            self._lines.sync()
            self._save(state())
        if interrupted:
            raise KeyboardInterrupt(f"seed {self.seed} is saved at update {self.step:,}")
        if record.evaluation_due:
            assert self.checkpoint is not None
            self._measure(state(), self.checkpoint)
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
                f"`odaf resume {self.run.path} --on-divergence warn` goes on regardless."
            )

    def _say_that_it_saves(self) -> None:
        self.progress.message(f"seed {self.seed}: stopping; saves after this stretch (Ctrl-C again: stops at once)")

    def next_stop(self) -> int:
        """Where the next compiled call has to end."""
        intervals = [self.stretch, self.checkpoint_every]
        if self.evaluate is not None:
            intervals.append(self.evaluate.every)
        return min(self.steps, *((self.step // interval + 1) * interval for interval in intervals))

    def _measure(self, state: Any, checkpoint: Checkpoint) -> None:
        """Evaluates a state that was saved, or has it evaluated beside the training."""
        assert self.evaluate is not None
        policy, began = self.run.policy_of(state), time.perf_counter()
        summary = checkpoint.header()["summary"]
        if isinstance(self.evaluate, EvaluatorBeside):
            found = self.evaluate.submit(policy, self.directory, checkpoint.step)
            self._pending.append(_Pending(checkpoint, summary, found))
            if checkpoint.step == self.step:
                self.record.evaluation_due = False  # of checkpoints from here on
            return
        with self._interrupt.passing() if self._interrupt else contextlib.nullcontext():
            evaluation = self.evaluate(policy, self.directory, checkpoint.step)
        _add(self.record.seconds, "evaluate", time.perf_counter() - began)
        self._take(evaluation, checkpoint, summary)

    def collect(self, wait_for: int = 0) -> None:
        """Takes what evaluations beside the training have found; waits until no more than `wait_for` are under way.

        Raises:
            ConfigError: the environment failed.
        """
        while self._pending and (len(self._pending) > wait_for or self._pending[0].found.done()):
            pending = self._pending[0]
            evaluation = pending.found.result()
            self._take(evaluation, pending.checkpoint, pending.summary)
            self._pending.pop(0)

    def _take(self, found: Evaluation, checkpoint: Checkpoint, then: dict[str, Any]) -> None:
        """Adds what an evaluation found to its checkpoint and to the record of the seed.

        Args:
            found: by the evaluation.
            checkpoint: what was evaluated.
            then: the checkpoint's summary, which is the seed's own no more if training went on meanwhile.
        """
        record, step = self.record, checkpoint.step
        for kind, sentence in found.warnings.items():
            if kind not in {warning.kind for warning in record.warnings}:
                self._warn(TrainingWarning(kind, step, f"update {step:,}: {sentence}"))
        evaluation = {"step": step, **found.summary}
        if record.evaluation is None or record.evaluation["step"] <= step:
            record.evaluation = evaluation
        if stands_there := self.step == step:
            record.evaluation_due = False
            if self.step >= self.steps and record.status != "diverged":
                record.status = "finished"
        for logger in self._loggers:
            logger.log(step, found.metrics)
        self._lines.sync()
        record.seconds["total"] = time.perf_counter() - self.began
        summary = self._summary()
        if not stands_there:
            summary = {**then, "evaluation": evaluation, "warnings": summary["warnings"], "evaluation_due": False}
        if checkpoint.path.exists():  # not if it was pruned meanwhile
            checkpoints.rewrite_record(checkpoint, {"summary": summary})
        self.write_summary()
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
            "evaluation_due": self.record.evaluation_due,
            "updates_per_second": self.step / train if train else None,
            "seconds": {name: seconds.get(name, 0.0) for name in ("pretrain", "compile", "train", "evaluate", "total")},
            "pretrain": self.record.pretrain,
            "warnings": [warning.to_dict() for warning in self.record.warnings],
        }

    def _save(self, state: Any) -> None:
        self.record.seconds["total"] = time.perf_counter() - self.began
        record = {"seed": self.seed, "summary": self._summary()}
        self.checkpoint = checkpoints.save(self.directory / "checkpoints", self.step, state, record)
        self._prune()
        self.write_summary()

    def _prune(self) -> None:
        if self.record.status != "diverged":  # then an earlier one is all that is left to use
            checkpoints.prune(self.directory / "checkpoints", self.keep, self.checkpoint_every)

    def write_summary(self) -> None:
        """Writes `summary.json`, which says what the last checkpoint's header says."""
        write_json(self.directory / "summary.json", self._summary())


def _add(seconds: dict[str, float], name: str, more: float) -> None:
    seconds[name] = seconds.get(name, 0.0) + more
