"""The scoreboard: what each method makes of the logs that people have, after how many updates and in how long.

Every preset as it is shipped, with its values for the set where it has some. A weighted form is a method of its own:
`td3-bc-return` is `td3-bc` on rows drawn by the return of their episode.
"""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from odaf.studies.job import Phase, Record, Study
from odaf.studies.logs import LOCAL, MixedLog, RecordedLog, origin_of
from odaf.studies.published import SOURCE, published_score
from odaf.studies.tables import grouped
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of

ROBOTS = ("hopper", "halfcheetah", "walker2d")
ROWS = 100_000
RANDOM_PERCENT = 80
LOG_SEED = 2  # of all logs; no setting of ours was tried on one of them
BUDGETS = (10_000, 20_000, 50_000, 100_000)  # updates at which scores stand in the table
STEPS, MORE_STEPS = 50_000, 100_000
SEEDS, MORE_SEEDS = 2, 4
EVALUATION = Evaluation(every=10_000, episodes=20)

Method = tuple[str, tuple[tuple[str, Any], ...]]

BY_RETURN: tuple[tuple[str, Any], ...] = (("sampling", "return"),)
# Cheap ones first.
CHEAP: tuple[Method, ...] = (
    ("behaviour-cloning", ()),
    ("behaviour-cloning-best", ()),
    ("td3-bc", ()),
    ("iql", ()),
    ("rebrac", ()),
)
DEFAULT: tuple[Method, ...] = (("odaf-locomotion", ()),)
WEIGHTED: tuple[Method, ...] = (
    ("td3-bc", BY_RETURN),
    ("iql", BY_RETURN),
    ("rebrac-return", ()),
    ("odaf-locomotion", BY_RETURN),
)
# The others that make at least a hundred updates a second on two cores (docs/results/speed.md).
OTHERS: tuple[Method, ...] = (("brac-p", ()), ("scas", ()), ("spot", ()), ("svr", ()), ("atac", ()))


def tasks(kinds: Sequence[str]) -> list[Task]:
    """For each kind of log the three robots.

    Args:
        kinds: `medium`, `medium-replay`, `medium-expert` or `mixture`.
    """
    return [Task(_log(robot, kind), EVALUATION, score="normalised_score") for kind in kinds for robot in ROBOTS]


def _log(robot: str, kind: str) -> MixedLog | RecordedLog:
    if kind == "mixture":
        return MixedLog(robot, RANDOM_PERCENT, ROWS, LOG_SEED)
    return RecordedLog(f"{robot}-{kind}", ROWS, LOG_SEED)


NINE = ("medium", "mixture", "medium-replay")


def plan() -> list[Phase]:
    """Cheap methods first; what takes long, or needs lanes, last."""

    def runs(
        methods: Sequence[Method], kinds: Sequence[str], steps: int = STEPS, seeds: range | None = None
    ) -> list[Training]:
        return [
            Training(preset, task, seed, steps, changes)
            for seed in (range(SEEDS) if seeds is None else seeds)
            for task in tasks(kinds)
            for preset, changes in methods
        ]

    six = (*CHEAP, *DEFAULT)
    return phases_of(
        ("nine sets, two seeds: five cheap methods", runs(CHEAP, NINE)),
        ("nine sets, two seeds: our default for robots", runs(DEFAULT, NINE)),
        ("nine sets, two seeds: rows drawn by return", runs(WEIGHTED, NINE)),
        ("the medium-expert sets: all of these", runs((*six, *WEIGHTED), ("medium-expert",))),
        ("nine sets, two seeds: other learners of a hundred updates a second and more", runs(OTHERS, NINE)),
        (
            "nine sets, four seeds, twice the updates (lanes)",
            runs((*six, *WEIGHTED), NINE, MORE_STEPS, range(MORE_SEEDS)),
        ),
    )


def name_of(method: str) -> str:
    """The method's name on the scoreboard: `td3-bc-sampling-return` is `td3-bc-return`."""
    return method.replace("-sampling-return", "-return")


def longest(records: Sequence[Record]) -> list[Record]:
    """Of each set, method and seed the record of the most updates: it holds the scores on the way, too."""
    kept: dict[tuple[str, str, int], Record] = {}
    for record in records:
        key = record["task"], record["method"], record["seed"]
        if key not in kept or record["steps"] > kept[key]["steps"]:
            kept[key] = record
    return [kept[key] for key in sorted(kept)]


def score_at(record: Record, updates: int) -> float | None:
    """Normalised score of the checkpoint after so many updates; None where there is none."""
    return next((point["normalised_score"] for point in record["evaluations"] if point["step"] == updates), None)


def seconds_at(record: Record, updates: int) -> float:
    """Seconds of training up to so many updates: models and compiling before them included, playing left out."""
    seconds = record["seconds"]
    return seconds["pretrain"] + seconds["compile"] + seconds["train"] * updates / record["updates"]


def steadiness(record: Record) -> float | None:
    """Standard deviation of the scores in the second half of a run; None for fewer than two."""
    second = [point["normalised_score"] for point in record["evaluations"] if 2 * point["step"] > record["steps"]]
    return statistics.stdev(second) if len(second) > 1 else None


def summary(records: Sequence[Record]) -> str:
    """JSON: {set: {method: {updates: {"mean", "seeds", "seconds"}}}}; a seed that diverged leaves its method out."""
    sets: dict[str, Any] = {}
    for task, group in grouped(longest(records), lambda record: record["task"]).items():
        for method, runs in grouped(group, lambda record: name_of(record["method"])).items():
            if any(run["final"] is None for run in runs):
                continue
            for updates in BUDGETS:
                scores = [(score_at(run, updates), seconds_at(run, updates)) for run in runs]
                there = [(score, seconds) for score, seconds in scores if score is not None]
                if there:
                    sets.setdefault(task, {}).setdefault(method, {})[str(updates)] = {
                        "mean": statistics.fmean(score for score, _ in there),
                        "seeds": len(there),
                        "seconds": statistics.fmean(seconds for _, seconds in there),
                    }
    return json.dumps(sets, indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: for each set a row for every method, best last checkpoint first, beneath what the log itself earns."""
    lines = [
        f"Normalised scores on {LOCAL}: 0 for a random policy, 100 for an expert; {EVALUATION.episodes} episodes an",
        "evaluation, deterministic policy, the checkpoint after so many updates, never the best. Intervals are 95 %",
        "Student intervals over seeds of the longest runs' last checkpoints. `steadiness` is the mean over seeds of",
        "the standard deviation of a run's scores in its second half: small is steady. `minutes` are those of",
        "training, one run on one core of a machine that had other work; `a minute` is the last score by them.",
        "`published` is the score of the public set of that name: other data and another budget, so no yardstick",
        f"({SOURCE}).",
        "Made by `odaf reproduce scoreboard` from the records in this folder.",
    ]
    budgets = " | ".join(f"{updates // 1000}k" for updates in BUDGETS)
    for task, group in grouped(longest(records), lambda record: record["task"]).items():
        data = group[0]["data"]
        lines += [
            "",
            f"**{task}** ({group[0]['environment']}; {origin_of(data)}, {data['transitions']:,} rows): the log's mean "
            f"is {data['normalised_score']:.1f}.",
            "",
            f"| method | {budgets} | seeds | 95 % interval | worst seed | steadiness | minutes | a minute "
            "| published |",
            f"|{'---|' * (len(BUDGETS) + 8)}",
        ]
        methods = grouped(group, lambda record: name_of(record["method"]))
        lines += [_row(method, runs) for method, runs in sorted(methods.items(), key=lambda item: -_last(item[1]))]
    return "\n".join(lines) + "\n"


def _last(runs: Sequence[Record]) -> float:
    """Mean score of the last checkpoints of the longest runs; without one the least."""
    if any(run["final"] is None for run in runs):
        return -float("inf")
    most = max(run["steps"] for run in runs)
    return statistics.fmean(run["final"]["normalised_score"] for run in runs if run["steps"] == most)


def _row(method: str, runs: Sequence[Record]) -> str:
    from odaf.evaluation.statistics import t_interval

    lost = sum(run["final"] is None for run in runs)
    if lost:
        return f"| {method} | {lost} of {len(runs)} diverged |{' |' * (len(BUDGETS) + 6)}"
    cells = []
    for updates in BUDGETS:
        scores = [score for run in runs if (score := score_at(run, updates)) is not None]
        cells.append(f"{statistics.fmean(scores):.1f}" if scores else "")
    most = max(run["steps"] for run in runs)
    full = [run for run in runs if run["steps"] == most]
    finals = [run["final"]["normalised_score"] for run in full]
    estimate = t_interval(finals)
    interval = f"[{estimate.low:.1f}, {estimate.high:.1f}]" if len(finals) > 1 else "one seed"
    spreads = [spread for run in full if (spread := steadiness(run)) is not None]
    minutes = statistics.fmean(seconds_at(run, most) for run in full) / 60
    found = published_score(full[0]["preset"], full[0]["task"]) if method == full[0]["preset"] else None
    return (
        f"| {method} | {' | '.join(cells)} | {len(full)} | {interval} | {min(finals):.1f} "
        f"| {f'{statistics.fmean(spreads):.1f}' if spreads else ''} | {minutes:.1f} | {estimate.mean / minutes:.1f} "
        f"| {'' if found is None else f'{found:.1f}'} |"
    )


def figure(records: Sequence[Record], out: Path) -> None:
    """Mean score of the last checkpoints by method and set, drawn to `out`; what is not complete stays empty."""
    from odaf.report.figures import grid_figure

    kept = longest(records)
    if not kept:
        return
    sets = list(dict.fromkeys(record["task"] for record in kept))
    by_method = grouped(kept, lambda record: name_of(record["method"]))
    values = np.full((len(by_method), len(sets)), np.nan)
    for row, runs in enumerate(by_method.values()):
        for column, task in enumerate(sets):
            there = [run for run in runs if run["task"] == task]
            if there and all(run["final"] is not None for run in there):
                values[row, column] = _last(there)
    means = [float(np.nanmean(row)) if np.isfinite(row).any() else -np.inf for row in values]
    order = sorted(range(len(means)), key=lambda row: -means[row])
    names = list(by_method)
    note = f"{LOCAL}; normalised scores of last checkpoints, means over seeds; {STEPS:,} updates and more"
    grid_figure([names[row] for row in order], sets, values[order], out, title="Scoreboard", note=note)


STUDY = Study(
    "scoreboard",
    "what each method makes of medium, replay and mostly random logs of three robots, by updates and minutes",
    plan,
    {"table.md": table, "summary.json": summary},
    {"figure.png": figure},
)
