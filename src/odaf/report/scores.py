"""The numbers of the report: one row per run, computed from the evaluation at the last checkpoint."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.environments.contact_margins import in_words
from odaf.environments.reference_returns import normalised_score
from odaf.evaluation.statistics import t_interval
from odaf.report.records import Evaluation, RunRecord, SeedRecord, number, optional


@dataclass(frozen=True)
class Score:
    """One run in the table of methods.

    Attributes:
        label: name shown, unique within the report.
        directory: the run directory's name.
        seeds: seeds in the run.
        evaluated: seeds with an evaluation.
        episodes: evaluation episodes over all seeds.
        step: updates at the evaluation, `None` without one; the smallest where seeds differ.
        mean: mean over seeds of each seed's mean return.
        std: standard deviation over all episodes of all seeds.
        interval: Student's 95 % interval of the mean over seeds, `None` below two seeds. With two seeds it is 12.7
            standard errors wide on either side, which is what two seeds can say.
        seed_means: mean return of each evaluated seed, in ascending order of seeds.
        success_rate: mean over seeds, `None` where the environment has no such flag.
        stitched_rate: likewise.
        updates_per_second: mean over seeds.
        train_seconds: mean over seeds, updates only.
        normalised: score where 0 is a random policy's return and 100 an expert's, with the environment version and the
            raw return, as `odaf.environments.reference_returns` gives it; `None` without reference returns.
        simulator: what played the episodes, with its rule for contact margins; empty where the run does not tell, or
            where it differs between seeds.
        status: "finished", or what the seeds that are not finished say of themselves.
    """

    label: str
    directory: str
    seeds: int
    evaluated: int
    episodes: int
    step: int | None
    mean: float | None
    std: float | None
    interval: tuple[float, float] | None
    seed_means: tuple[float, ...]
    success_rate: float | None
    stitched_rate: float | None
    updates_per_second: float | None
    train_seconds: float | None
    normalised: Mapping[str, Any] | None
    simulator: str
    status: str


def headline_index(scores: Sequence[Score]) -> int:
    """Which run the page speaks of first: the one of the highest mean return; the first where none has any."""
    return max(range(len(scores)), key=lambda index: -math.inf if (mean := scores[index].mean) is None else mean)


def decimals(values: Sequence[float | None]) -> int:
    """Digits after the point that show about four digits of the largest value, the same for a whole column."""
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    return 0 if largest >= 10_000 else 1 if largest >= 10 else 2 if largest >= 1 else 3


def score(run: RunRecord, label: str) -> Score:
    """The table row of one run."""
    evaluations = [seed.evaluation for seed in run.evaluated if seed.evaluation is not None]
    means = np.asarray([evaluation.mean for evaluation in evaluations], np.float64)
    over_seeds = t_interval(means) if means.size > 1 else None
    unfinished = sorted({seed.status for seed in run.seeds} - {"finished"})
    return Score(
        label=label,
        directory=run.directory.name,
        seeds=len(run.seeds),
        evaluated=len(evaluations),
        episodes=sum(evaluation.episodes for evaluation in evaluations),
        step=min((evaluation.step for evaluation in evaluations), default=None),
        mean=float(means.mean()) if means.size else None,
        std=episode_std(evaluations) if evaluations else None,
        interval=None if over_seeds is None else (over_seeds.low, over_seeds.high),
        seed_means=tuple(means.tolist()),
        success_rate=_mean([evaluation.success_rate for evaluation in evaluations]),
        stitched_rate=_mean([evaluation.stitched_rate for evaluation in evaluations]),
        updates_per_second=_mean([_updates_per_second(seed) for seed in run.seeds]),
        train_seconds=_mean([_train_seconds(seed) for seed in run.seeds]),
        normalised=normalised(run.evaluation_environment_id, float(means.mean()) if means.size else None),
        simulator=simulator_of(run),
        status=", ".join(unfinished) if unfinished else ("finished" if run.seeds else "not started"),
    )


def simulator_of(run: RunRecord) -> str:
    """What played the episodes, in words; empty where it is not known, or differs between seeds."""
    evaluations = [seed.summary.get("evaluation") or {} for seed in run.evaluated]
    found = {in_words(evaluation.get("simulator")) for evaluation in evaluations}
    return found.pop() if len(found) == 1 else ""


def normalised(environment: str | None, raw_return: float | None) -> Mapping[str, Any] | None:
    """The normalised score of a return in an environment; `None` where it has no reference returns."""
    if environment is None or raw_return is None:
        return None
    return normalised_score(environment, [raw_return])


def episode_std(evaluations: Sequence[Evaluation]) -> float | None:
    """Standard deviation (divisor n) over all episodes of all seeds.

    Pooled from each seed's mean and spread where single returns were not kept, each seed counting the same.
    """
    kept = [evaluation.returns for evaluation in evaluations if evaluation.returns is not None]
    if len(kept) == len(evaluations):
        return float(np.concatenate(kept).std())
    spread = np.asarray([evaluation.std for evaluation in evaluations])
    means = np.asarray([evaluation.mean for evaluation in evaluations])
    return optional(float(np.sqrt(np.mean(spread**2) + means.var())))


def episode_returns(run: RunRecord) -> np.ndarray:
    """[episodes] returns at the last checkpoint, all seeds together; empty where none were kept."""
    kept = [seed.evaluation.returns for seed in run.evaluated if seed.evaluation is not None]
    for position, seed in enumerate(run.evaluated):
        if kept[position] is None and seed.episodes is not None and "returns" in seed.episodes[1]:
            kept[position] = np.asarray(seed.episodes[1]["returns"], np.float64)
    known = [returns for returns in kept if returns is not None]
    return np.concatenate(known) if known else np.empty(0)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _updates_per_second(seed: SeedRecord) -> float | None:
    stated = optional(seed.summary.get("updates_per_second"))
    logged = seed.series.get("time/updates_per_second")
    if stated is None and logged is not None:
        # The first stretch contains compilation, so it speaks of the compiler rather than of the method.
        return optional(float(np.nanmedian(logged.values[1:] if logged.values.size > 1 else logged.values)))
    return stated


def _train_seconds(seed: SeedRecord) -> float | None:
    seconds = seed.summary.get("seconds")
    if isinstance(seconds, dict) and math.isfinite(number(seconds.get("train"))):
        return number(seconds["train"])
    logged = seed.series.get("time/seconds")
    return optional(float(logged.values[-1])) if logged is not None else None
