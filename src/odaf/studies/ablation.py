"""The ablation study: what the outcome term adds, on the paper's plain base, on RORL, and on our base.

The released code has the term inside RORL's smoothing and leaves RORL's losses on, so "without the term" could be
SAC-N or RORL: both are measured, each with the term and without.
"""

import json
import statistics
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from odaf.studies.final_scores import finals_of, mean_over_tasks, pairs
from odaf.studies.job import Phase, Record, Study
from odaf.studies.robots import ROBOTS, robot_form, robot_task
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of
from odaf.studies.verdict import Claim, Part, Verdict, decide

EVALUATION = Evaluation(every=10_000, episodes=20)
STEPS, COSTLY_STEPS = 50_000, 10_000
SEEDS, MORE_SEEDS = 4, 8
WORSE_BY = 5.0  # points that no log may lose
ASKED_CONFIDENCE = 0.9

CELLS: dict[str, tuple[str, str]] = {
    "the paper's base (SAC-N)": ("odaf-paper", "odaf-paper-without-outcome"),
    "RORL": ("odaf-rorl", "odaf-rorl-without-outcome"),
    "our base": ("odaf-locomotion", "odaf-locomotion-without-outcome"),
}
"""By the base, the presets with the term and without."""
PLAIN, RORL, OURS = CELLS


def first_tasks(data: Path | None = None) -> list[Task]:
    """The two logs that are measured first: one of random actions, one with few good rows."""
    return [
        robot_task("halfcheetah", "random", EVALUATION, data=data),
        robot_task("hopper", "mixture", EVALUATION, data=data),
    ]


def nine_tasks(data: Path | None = None) -> list[Task]:
    """Three robots, three kinds of log."""
    kinds = ("medium", "medium-replay", "medium-expert")
    return [robot_task(robot, kind, EVALUATION, data=data) for kind in kinds for robot in ROBOTS]


def plan(data: Path | None = None) -> list[Phase]:
    """Two logs without RORL's losses; the same with them and fewer updates; then nine logs, for lanes."""

    def runs(cells: Sequence[str], tasks: Sequence[Task], seeds: range, steps: int = STEPS) -> list[Training]:
        return [
            Training(preset, task, seed, steps, form=robot_form(preset, task), notes=(("cell", cell),))
            for seed in seeds
            for task in tasks
            for cell in cells
            for preset in CELLS[cell]
        ]

    first, nine = first_tasks(data), nine_tasks(data)
    return phases_of(
        ("two logs, four seeds: our base", runs((OURS,), first, range(SEEDS))),
        ("two logs, four seeds: the paper's base", runs((PLAIN,), first, range(SEEDS))),
        ("two logs, four seeds: RORL, a fifth of the updates", runs((RORL,), first, range(SEEDS), COSTLY_STEPS)),
        ("nine logs, eight seeds (lanes): the paper's base and ours", runs((PLAIN, OURS), nine, range(MORE_SEEDS))),
        ("nine logs, eight seeds (lanes): RORL", runs((RORL,), nine, range(MORE_SEEDS), COSTLY_STEPS)),
    )


def verdict(records: Sequence[Record], cell: str = PLAIN) -> Verdict:
    """Whether the mean over all logs is higher with the term, and no log loses more than five points."""
    finals, (with_term, without) = finals_of(records), CELLS[cell]
    tasks = [task.name for task in (*first_tasks(), *nine_tasks())]
    there = [task for task in tasks if {with_term, without} <= finals.get(task, {}).keys()]
    first, second = pairs(mean_over_tasks(finals, with_term, there), mean_over_tasks(finals, without, there))
    few = "" if len(there) == len(tasks) else f"{len(there)} of {len(tasks)} logs are measured with both"
    parts = [Part(f"mean of {len(there)} logs, on {cell}", first, second, void=few)]
    for task in tasks:
        own = (finals.get(task, {}).get(method, {}) for method in (with_term, without))
        first, second = pairs(*own)
        gains = tuple(a - b for a, b in zip(first, second, strict=True))
        parts.append(Part(f"{task}: loses less than {WORSE_BY:g} points, on {cell}", gains, threshold=-WORSE_BY))
    return decide(parts)


def ours(records: Sequence[Record]) -> Verdict:
    """The same on our base."""
    return verdict(records, OURS)


CLAIM = Claim(
    "the outcome term is what matters: without it scores fall by nearly a fifth",
    (
        "Trained with the term and without, all else equal, on the same logs and seeds; 20 episodes, last checkpoint.",
        "Held if the mean over eleven logs is higher with the term (paired over seeds), and none loses five points; "
        "the table adds the share of resamples of the logs in which the term gains.",
    ),
    (
        "The paper says nearly a fifth; the verdict asks for any gain, and the table has its size.",
        "The paper shows a picture for logs that it does not list, and does not say which base it takes the term from. "
        "Its own table has RORL at 85.7 and the method at 87.9, 2.6 % above.",
        "50,000 updates, 10,000 with RORL's losses; the released code trains for millions.",
        "On mixtures the paper names no radius: its robot's value for all other logs is taken.",
    ),
    verdict,
    ours,
)


def gains(records: Sequence[Record], cell: str) -> dict[str, tuple[tuple[float, ...], tuple[float, ...]]]:
    """By log the scores with the term and without, seed by seed."""
    finals, (with_term, without) = finals_of(records), CELLS[cell]
    found = {
        task: pairs(methods.get(with_term, {}), methods.get(without, {})) for task, methods in sorted(finals.items())
    }
    return {task: both for task, both in found.items() if both[0]}


def table(records: Sequence[Record]) -> str:
    """Markdown: for each base a row for every log, and beneath it what the logs say together."""
    from odaf.evaluation.across_tasks import probability_of_gain
    from odaf.evaluation.statistics import paired_difference

    lines = [
        "Normalised scores of last checkpoints with the outcome term and without it, 20 episodes, means over",
        "seeds; the gain seed by seed with its 95 % Student interval. `P(gain > 0)` resamples the logs.",
        "Made by `odaf reproduce ablation` from the records in this folder.",
    ]
    for cell, (with_term, without) in CELLS.items():
        found = gains(records, cell)
        if not found:
            continue
        lines += [
            "",
            f"**On {cell}**: `{with_term}` and `{without}`.",
            "",
            "| log | seeds | with the term | without | gain | 95 % interval |",
            "|---|---|---|---|---|---|",
        ]
        for task, (first, second) in found.items():
            gain = paired_difference(list(first), list(second))
            interval = f"[{gain.low:+.1f}, {gain.high:+.1f}]" if gain.count > 1 else "one seed"
            lines.append(
                f"| {task} | {gain.count} | {statistics.fmean(first):.1f} | {statistics.fmean(second):.1f} "
                f"| {gain.mean:+.1f} | {interval} |"
            )
        share, by_task = probability_of_gain(
            {task: first for task, (first, _) in found.items()}, {task: second for task, (_, second) in found.items()}
        )
        base = statistics.fmean(statistics.fmean(second) for _, second in found.values())
        mean = statistics.fmean(by_task.values())
        relative = f", {100 * mean / base:+.0f} % of the score without" if base > 1.0 else ""
        lines += ["", f"Mean gain {mean:+.1f}{relative}; P(gain > 0) {share:.2f}; asked for: {ASKED_CONFIDENCE}."]
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by base and log the scores of each seed with the term and without."""
    finals = finals_of(records)
    found = {
        cell: {
            task: {side: methods.get(preset, {}) for side, preset in zip(("with", "without"), presets, strict=True)}
            for task, methods in finals.items()
            if set(presets) & set(methods)
        }
        for cell, presets in CELLS.items()
    }
    return json.dumps(found, indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel for each base: bars with the term and without, by log."""
    from odaf.report.study_figures import Bar, bars_figure

    panels: dict[str, list[Any]] = {}
    for cell in CELLS:
        for task, (first, second) in gains(records, cell).items():
            panels[f"{task}, {cell}"] = [
                Bar(name, statistics.fmean(values), values) for name, values in (("with", first), ("without", second))
            ]
    if panels:
        bars_figure(panels, out, "With the outcome term and without", "normalised scores; dots are seeds", columns=4)


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "ablation",
        "what the outcome term adds to the paper's base, to RORL and to ours",
        partial(plan, data),
        {"table.md": table, "summary.json": summary},
        {"figure.png": figure},
        CLAIM,
        on_files=study,
    )


STUDY = study()
