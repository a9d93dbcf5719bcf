"""The first part of the stitching study: our default, its base and cloning on the log that settings were chosen on.

The presets are in the form that they had then (`first_form`).
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from odaf.studies.first_form import COMMON, first_form
from odaf.studies.job import Phase, Record
from odaf.studies.logs import LOCAL, MazeLog
from odaf.studies.tables import grouped, interval
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of

EPISODES = 50


def maze_task(maze: str) -> Task:
    """Finding the good path of a maze from the log of drivers who never took it."""
    return Task(
        MazeLog(maze, episodes=EPISODES), Evaluation(every=5_000, episodes=EPISODES), field="maze", common=COMMON
    )


def plan() -> list[Phase]:
    """Our default beside its base and cloning first, what is costly last."""

    def runs(preset: str, maze: str, seeds: int, steps: int, **changes: Any) -> list[Training]:
        task, form = maze_task(maze), first_form(preset)
        return [Training(preset, task, seed, steps, tuple(changes.items()), form) for seed in range(seeds)]

    return phases_of(
        (
            "the stitching maze: our default, its base without the outcome term, cloning",
            [
                *runs("odaf", "stitch", 4, 20_000),
                *runs("odaf-without-outcome", "stitch", 4, 20_000),
                *runs("behaviour-cloning", "stitch", 4, 20_000),
            ],
        ),
        (
            "two other mazes: our default, cloning",
            [
                *runs("odaf", "shaft", 2, 20_000),
                *runs("behaviour-cloning", "shaft", 2, 20_000),
                *runs("odaf", "crossroads", 2, 20_000),
                *runs("behaviour-cloning", "crossroads", 2, 20_000),
            ],
        ),
        (
            "targets over three and five steps",
            [
                *runs("odaf", "stitch", 4, 20_000, return_steps=3),
                *runs("odaf", "stitch", 4, 20_000, return_steps=5),
                *runs("odaf", "shaft", 2, 20_000, return_steps=3),
                *runs("odaf", "shaft", 2, 20_000, return_steps=5),
            ],
        ),
        ("rounded products", runs("odaf", "stitch", 4, 20_000, products="bfloat16")),
        (
            "does it last? longer runs of the first phase",
            [*runs("odaf", "stitch", 2, 50_000), *runs("odaf-without-outcome", "stitch", 2, 50_000)],
        ),
        ("as printed", [*runs("odaf-paper", "stitch", 2, 10_000), *runs("odaf-paper", "stitch", 2, 20_000)]),
    )


def table(records: Sequence[Record]) -> str:
    """Markdown table: a row for every maze, method and length, over its seeds."""
    from odaf.evaluation.statistics import t_interval

    lines = [
        f"Scores on {LOCAL}; last checkpoint, deterministic policy, {EPISODES} episodes a seed. Intervals are 95 %",
        "Student intervals over seeds. Made by `odaf reproduce pointmaze` from the records in this folder.",
        "",
        "| maze | method | updates | seeds | return | 95 % interval | worst seed | stitched | success | updates/s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (maze, method, steps), group in grouped(records, itemgetter("maze", "method", "steps")).items():
        returns = [record["final"]["mean_return"] for record in group]
        estimate = t_interval(returns)
        stitched, success, speed = (
            sum(values) / len(group)
            for values in (
                [record["final"]["stitched_rate"] for record in group],
                [record["final"]["success_rate"] for record in group],
                [record["updates_per_second"] for record in group],
            )
        )
        lines.append(
            f"| {maze} | {method} | {steps:,} | {len(group)} | {estimate.mean:.1f} | {interval(estimate)} "
            f"| {min(returns):.1f} | {stitched:.2f} | {success:.2f} | {speed:.1f} |"
        )
    lines.append("")
    for maze, data in sorted({record["maze"]: record["data"] for record in records}.items()):
        lines.append(
            f"- `{maze}` data: {data['transitions']:,} transitions, mean logged return {data['mean_return']:.1f}, "
            f"best {data['best_return']:.1f}; the scripted driver sent straight to the goal's cell earns "
            f"{data['direct_return']:.1f}, to the hidden target {data['ceiling']:.1f} ({LOCAL})"
        )
    return "\n".join(lines) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """Learning curves of every method in the stitching maze, the longest run of each seed, drawn to `out`."""
    from odaf.report.figures import learning_curves_figure
    from odaf.report.quantities import Curve

    longest: dict[tuple[str, int], Record] = {}
    for record in records:
        if record["maze"] != "stitch":
            continue
        key = record["method"], record["seed"]
        if key not in longest or record["steps"] > longest[key]["steps"]:
            longest[key] = record
    if not longest:
        return
    curves = []
    for index, method in enumerate(sorted({method for method, _ in longest})):
        runs = [
            {evaluation["step"]: evaluation["mean_return"] for evaluation in record["evaluations"]}
            for (name, _), record in sorted(longest.items())
            if name == method
        ]
        steps = sorted(set().union(*runs))
        values = np.array([[run.get(step, np.nan) for step in steps] for run in runs])
        curves.append(Curve(method, np.array(steps), values, None, index))
    data = next(iter(longest.values()))["data"]
    references = [("best logged", data["best_return"]), ("mean logged", data["mean_return"])]
    learning_curves_figure(curves, out, references, title="Stitching maze", note=LOCAL)
