"""The rivals study: what every learner makes of Hopper's medium log, and of a log that is mostly random.

The settings are those of the presets, with their values for the log where they have some.
"""

import json
from collections.abc import Sequence
from typing import Any

from odaf.runs import presets
from odaf.studies.job import Phase, Record, Study
from odaf.studies.logs import LOCAL, MixedLog, RecordedLog, origin_of
from odaf.studies.tables import grouped
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of

MEDIUM_STEPS = 50_000
MIXTURE_STEPS = 40_000
MIXTURE_SEEDS = 3
LAST = 3  # evaluations whose mean a table gives beside the last checkpoint
LOG_SEED = 2  # of both logs; nothing was tuned on them
EVALUATION = Evaluation(every=10_000, episodes=20)

Method = tuple[str, tuple[tuple[str, Any], ...]]

BY_RETURN: tuple[tuple[str, Any], ...] = (("sampling", "return"),)
UNIFORM: tuple[tuple[str, Any], ...] = (("sampling", "uniform"),)
# The policy is an average of the actor; tried on a mixture of another seed.
AVERAGED: tuple[tuple[str, Any], ...] = (("averaged_updates", 5_000),)
# Cheap ones first.
LEARNERS: tuple[str, ...] = (
    "behaviour-cloning",
    "behaviour-cloning-best",
    "td3-bc",
    "iql",
    "spot",
    "svr",
    "scas",
    "bcq",
    "brac-p",
    "brac-v",
    "atac",
    "rebrac",
    "bear",
    "cql",
    "sdc",
)
MIXTURE: tuple[Method, ...] = (
    ("behaviour-cloning-best", ()),
    ("rebrac-return", ()),
    ("rebrac-return", AVERAGED),
    ("behaviour-cloning", ()),
    ("rebrac-return", UNIFORM),
    ("td3-bc", BY_RETURN),
    ("iql", BY_RETURN),
    ("td3-bc", ()),
    ("iql", ()),
)


def medium_task() -> Task:
    """Hopping from 100,000 rows of a policy that hops for a while and falls."""
    return Task(RecordedLog("hopper-medium", 100_000, LOG_SEED), EVALUATION, score="normalised_score")


def mixture_task() -> Task:
    """Hopping from 80,000 random rows and 20,000 of an expert."""
    return Task(MixedLog("hopper", 80, 100_000, LOG_SEED), EVALUATION, score="normalised_score")


def plan() -> list[Phase]:
    """The mixture first, a seed of every method before the next seed; then the medium log, cheap learners first."""
    mixture = [
        Training(preset, mixture_task(), seed, MIXTURE_STEPS, changes)
        for seed in range(MIXTURE_SEEDS)
        for preset, changes in MIXTURE
    ]
    medium = [Training(preset, medium_task(), 0, MEDIUM_STEPS + _warm_up_steps(preset)) for preset in LEARNERS]
    return phases_of(("Hopper, 80 % random rows", mixture), ("Hopper, medium: every learner", medium))


def _warm_up_steps(preset: str) -> int:
    """Updates in which a learner's actor sees no value yet; they come on top of the others."""
    settings = presets.settings(preset)
    return int(settings.get("warm_up_steps", 0) or settings.get("warm_start_updates", 0))


def last_evaluations(record: Record) -> list[float]:
    """Normalised scores of the last few evaluations, the last checkpoint's among them."""
    return [point["normalised_score"] for point in record["evaluations"]][-LAST:]


def table(records: Sequence[Record]) -> str:
    """Markdown: for each log a row for every method over its seeds, beneath the log's own mean."""
    lines = [
        f"Normalised scores on {LOCAL}: 0 for a random policy, 100 for an expert; {EVALUATION.episodes} episodes an",
        "evaluation, deterministic policy. `last` is the last checkpoint, `last three` the mean of the last three",
        f"evaluations, {EVALUATION.every:,} updates apart, `worst seed` the lowest of these. Intervals are 95 %",
        "Student intervals over seeds. Seconds hold everything, on one core of a machine that had other work.",
        "Made by `odaf reproduce rivals` from the records in this folder.",
    ]
    for task, group in grouped(records, lambda record: record["task"]).items():
        data = group[0]["data"]
        lines += [
            "",
            f"**{task}** ({group[0]['environment']}; {origin_of(data)}, {data['transitions']:,} rows): the log's mean "
            f"is {data['normalised_score']:.1f}.",
            "",
            "| method | updates | seeds | last | last three | 95 % interval | worst seed | updates/s | seconds |",
            "|---|---|---|---|---|---|---|---|---|",
            *(_row(runs) for runs in grouped(group, lambda record: record["method"]).values()),
        ]
    return "\n".join(lines) + "\n"


def _row(runs: Sequence[Record]) -> str:
    from odaf.evaluation.statistics import t_interval

    head = f"| {runs[0]['method']} | {runs[0]['steps']:,} | {len(runs)} "
    lost = sum(record["final"] is None for record in runs)
    if lost:
        return f"{head}| {lost} of {len(runs)} diverged | | | | | |"
    last = _mean([record["final"]["normalised_score"] for record in runs])
    means = [_mean(last_evaluations(record)) for record in runs]
    estimate = t_interval(means)
    interval = f"[{estimate.low:.1f}, {estimate.high:.1f}]" if len(runs) > 1 else "one seed"
    speed = _mean([record["updates_per_second"] for record in runs])
    seconds = _mean([record["seconds"]["total"] for record in runs])
    return f"{head}| {last:.1f} | {estimate.mean:.1f} | {interval} | {min(means):.1f} | {speed:,.0f} | {seconds:,.0f} |"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def summary(records: Sequence[Record]) -> str:
    """JSON: for each log and method the mean of the last evaluations by seed, and what the log itself earns."""
    logs: dict[str, Any] = {}
    for task, group in grouped(records, lambda record: record["task"]).items():
        methods = grouped(group, lambda record: record["method"])
        logs[task] = {
            "data": origin_of(group[0]["data"]),
            "log_mean": group[0]["data"]["normalised_score"],
            "methods": {
                name: {
                    "updates": runs[0]["steps"],
                    "by_seed": {
                        str(record["seed"]): None if record["final"] is None else _mean(last_evaluations(record))
                        for record in sorted(runs, key=lambda record: record["seed"])
                    },
                }
                for name, runs in methods.items()
            },
        }
    return json.dumps(logs, indent=1) + "\n"


STUDY = Study(
    "rivals",
    "every learner on Hopper's medium log, and weighted rows on a log that is 80 % random",
    plan,
    {"table.md": table, "summary.json": summary},
)
