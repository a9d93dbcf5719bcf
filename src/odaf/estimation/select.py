"""Choosing among runs and their checkpoints without a simulator, by what an estimator says of them on a hold-out.

Every checkpoint that a run keeps is a candidate. Candidates of one call are judged on the same resampled episodes, so
that the chance in these does not decide between them. The best is the one that is better than whoever wrote the log by
most *at the least*: by the lower end of the interval of the difference. Estimates are highest of policies that leave
the log, where nothing contradicts them, and so are their intervals widest. Those for which the estimator refuses a
verdict stand behind all others. A run is worth the mean over its seeds of the best candidate of each.
"""

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from odaf.components.fitting import Progress
from odaf.data.dataset import Dataset
from odaf.errors import CheckpointError, ConfigError
from odaf.estimation.estimate import ESTIMATORS, estimate_many
from odaf.estimation.settings import Acting, EstimateSettings
from odaf.estimation.valuation import Interval, Valuation, ValueEstimate
from odaf.report.plain_tables import table
from odaf.training.files import plain
from odaf.training.run_directory import RunDirectory
from odaf.training.settings import products_in

Checkpoints = Literal["all", "last"]
AT_ONCE = 16  # policies that are fitted in one program


@dataclass(frozen=True)
class Candidate:
    """A checkpoint and what an estimator says of its policy.

    Attributes:
        run: directory.
        seed: of the training.
        step: updates made.
        estimate: with the verdict.
    """

    run: str
    seed: int
    step: int
    estimate: ValueEstimate

    @property
    def worth(self) -> float:
        """By which candidates are ordered: `ValueEstimate.least`."""
        return self.estimate.least

    @property
    def refused(self) -> bool:
        """Whether the log cannot tell."""
        return self.estimate.verdict == "refused"


@dataclass(frozen=True)
class RunWorth:
    """A run, and the mean over its seeds of the best candidate of each; `refused` where one of these is."""

    run: str
    worth: float
    refused: bool


@dataclass(frozen=True)
class Selection:
    """What was chosen, and among what.

    Attributes:
        candidates: best first; those that were refused behind all others.
        runs: in the same order.
        behaviour: what an episode of the log itself earned.
        method: the estimator that chose.
        horizon: steps of an episode that are counted.
        discount: weight of a reward one step later.
        acting: which actions of the policies are judged.
        notes: what a reader has to know besides.
    """

    candidates: tuple[Candidate, ...]
    runs: tuple[RunWorth, ...]
    behaviour: Interval
    method: str
    horizon: int
    discount: float
    acting: str
    notes: tuple[str, ...]

    @property
    def best(self) -> Candidate:
        """The checkpoint that is better than the log by most at the least."""
        return self.candidates[0]

    @property
    def best_run(self) -> str:
        """Directory of the run that is worth most."""
        return self.runs[0].run

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; NaN and infinities as None."""
        return plain({"best": dataclasses.asdict(self.best), "best_run": self.best_run, **dataclasses.asdict(self)})

    def __str__(self) -> str:
        rows = [["behaviour", "", "", str(self.behaviour), "-", "-", "the log itself"]]
        for each in self.candidates:
            found, estimate = each.estimate.best_value, each.estimate
            better = "-" if estimate.probability_better is None else f"{estimate.probability_better:.0%}"
            cells = ["-" if part is None else str(part) for part in (found, estimate.difference)]
            rows.append([each.run, str(each.seed), f"{each.step:,}", *cells, better, estimate.verdict])
        header = ["run", "seed", "step", "value of an episode", "beside the behaviour", "better", "verdict"]
        best, lines = self.best, [table(header, rows), ""]
        sums = "plain sums of rewards" if self.discount == 1.0 else f"discount {self.discount:g}"
        lines.append(f"{ESTIMATORS[self.method]}, to step {self.horizon:,}, {sums}")
        lines.append("ordered by the lower end of `beside the behaviour`, those without a verdict behind all others")
        lines.append(f"best run: {self.best_run}")
        lines.append(f"best checkpoint: {best.run}, seed {best.seed}, step {best.step:,}")
        if best.refused:
            lines.append(f"\nno verdict on the best: {best.estimate.reason}")
        return "\n".join([*lines, *(f"\nnote: {note}" for note in self.notes)])


def select(
    runs: Sequence[str | os.PathLike[str]] | str | os.PathLike[str],
    data: Dataset | str | os.PathLike[str],
    *,
    method: str = "fqe",
    checkpoints: Checkpoints = "all",
    acting: Acting = "mode",
    discount: float = 1.0,
    horizon: int | None = None,
    log_probs: str | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Selection:
    """The best checkpoint and the best run, told from a log that no run learned from.

    Args:
        runs: directories of runs, or of several runs, such as `odaf train --set` leaves.
        data: the hold-out.
        method: an estimator of `ESTIMATORS`.
        checkpoints: "all" that are kept, or the "last" of each seed.
        acting: as for `estimate`, as are the others.
        discount: weight of a reward one step later.
        horizon: steps of an episode that are counted; None takes what the log shows.
        log_probs: column of `infos` with log-densities of the logged actions.
        seed: of everything random.
        settings: sizes of what is fitted.
        progress: called with (steps done, steps in all).
        **changes: fields of `EstimateSettings` by name.

    Raises:
        ConfigError: an argument is out of range.
        DatasetError: a run and the log do not fit.
        CheckpointError: there is no run, or none with a checkpoint.
    """
    if method not in ESTIMATORS:
        raise ConfigError(f"method={method!r} is none of {', '.join(ESTIMATORS)}; one estimator chooses")
    if checkpoints not in ("all", "last"):
        raise ConfigError(f"checkpoints={checkpoints!r} must be all or last")
    found = [
        (run, number, checkpoint.step)
        for run in runs_in([runs] if isinstance(runs, str | os.PathLike) else runs)
        for number in run.seeds
        for checkpoint in run.checkpoints(number)[-1 if checkpoints == "last" else 0 :]
    ]
    if not found:
        raise CheckpointError("none of these runs has a checkpoint yet; train first with `odaf train`")
    dataset = data if isinstance(data, Dataset) else Dataset.load(data)
    valuations: list[Valuation] = []
    groups = [found[first : first + AT_ONCE] for first in range(0, len(found), AT_ONCE)]
    with products_in(found[0][0].config.get("precision")):
        for number, group in enumerate(groups):

            def advanced(done: int, total: int, before: int = number) -> None:
                if progress is not None:
                    progress(before * total + done, len(groups) * total)

            judged = estimate_many(
                [run.policy(number, step) for run, number, step in group],
                dataset,
                method=method,  # type: ignore[arg-type]
                acting=acting,
                discounts=(discount,),
                horizon=horizon,
                log_probs=log_probs,
                seed=seed,
                settings=settings,
                progress=advanced,
                **changes,
            )
            valuations += [each[0] for each in judged]
    candidates = [
        Candidate(str(run.path), number, step, valuation[method])
        for (run, number, step), valuation in zip(found, valuations, strict=True)
    ]
    return Selection(
        tuple(sorted(candidates, key=lambda each: (each.refused, -each.worth))),
        tuple(_worths(candidates)),
        valuations[0].behaviour,
        method,
        valuations[0].horizon,
        discount,
        acting,
        tuple(dict.fromkeys(note for each in valuations for note in each.notes)),
    )


def runs_in(places: Sequence[str | os.PathLike[str]]) -> list[RunDirectory]:
    """The runs in these directories, each once; a folder that holds several gives them all.

    Raises:
        CheckpointError: there is no run in one of them.
    """
    found: dict[Path, RunDirectory] = {}
    for place in map(Path, places):
        own = (place / "config.json").exists()
        inside = [] if own else sorted(each.parent for each in place.glob("*/config.json"))
        for directory in inside or [place]:
            run = RunDirectory(directory)
            run.require_current()
            found.setdefault(directory.resolve(), run)
    return list(found.values())


def _worths(candidates: Sequence[Candidate]) -> list[RunWorth]:
    best: dict[str, dict[int, Candidate]] = {}
    for each in sorted(candidates, key=lambda each: (each.refused, -each.worth)):
        best.setdefault(each.run, {}).setdefault(each.seed, each)
    worths = [
        RunWorth(run, float(np.mean([each.worth for each in own.values()])), any(each.refused for each in own.values()))
        for run, own in best.items()
    ]
    return sorted(worths, key=lambda each: (each.refused, -each.worth))
