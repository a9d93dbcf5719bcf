"""The ant-maze study: the six sets of D4RL's names, and what each method makes of them.

Settings are those of the presets with their values for the task, so rewards and observations are mapped as each source
does. Policies are scored by the share of 100 episodes that reach the goal.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from odaf.studies.ant_maze_logs import AntMazeLog
from odaf.studies.job import Phase, Record, Study
from odaf.studies.logs import LOCAL
from odaf.studies.tables import grouped
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, kept_paths, phases_of

STEPS = 300_000
EVALUATION = Evaluation(every=50_000, episodes=20, final_episodes=100)
SMALL, OTHERS = (
    ("antmaze-umaze", "antmaze-medium-play"),
    ("antmaze-umaze-diverse", "antmaze-medium-diverse", "antmaze-large-play", "antmaze-large-diverse"),
)
PRINTED, OURS = "odaf-paper", "odaf-antmaze"
FIRST = ("iql", "rebrac", OURS)
# Cheap ones first.
LATER = ("td3-bc", "spot", "scas", "atac", "cql", "sdc", "osr-10", PRINTED)
METHODS = FIRST + LATER
RIVALS = tuple(method for method in METHODS if method not in (PRINTED, OURS))
# What carries our recipe: each time one part is taken away, or put back to what the base has.
WITHOUT: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = (
    (f"{OURS}-without-outcome", ()),
    (OURS, (("behaviour.weight", 0.0),)),
    (OURS, (("return_steps", 1),)),
    (OURS, (("warm_start", "none"), ("target_entropy", -8.0))),
    (OURS, (("num_critics", 10),)),
    (OURS, (("observation_scaling", "none"),)),
)
SEEDS = 2
LATER_SEEDS = 4
PATHS = 10  # episodes whose paths a record keeps


def task_of(name: str) -> Task:
    """A million rows of the set, evaluated on the maze of its size."""
    return Task(AntMazeLog(name), EVALUATION, score="normalised_score")


def plan() -> list[Phase]:
    """Two tasks with the two methods that are best there by what is published and our recipe; what carries the recipe;
    the other methods; then the rest."""

    def trainings(names: Sequence[str], methods: Sequence[str | tuple[str, Any]], seeds: range) -> list[Training]:
        forms = [(method, ()) if isinstance(method, str) else method for method in methods]
        return [
            Training(method, task_of(name), seed, STEPS, changes, checkpoint_every=25_000, paths=PATHS)
            for seed in seeds
            for name in names
            for method, changes in forms
        ]

    first, rest = range(SEEDS), range(SEEDS, LATER_SEEDS)
    return phases_of(
        ("the small maze and medium-play, two seeds: IQL, ReBRAC and our recipe", trainings(SMALL, FIRST, first)),
        ("the same two, two seeds: what carries our recipe", trainings(SMALL, WITHOUT, first)),
        ("the same two, two seeds: every other method", trainings(SMALL, LATER, first)),
        ("the other four, two seeds: every method", trainings(OTHERS, METHODS, first)),
        ("all six, two further seeds: every method", trainings(SMALL + OTHERS, METHODS, rest)),
    )


def _successes(runs: Sequence[Record]) -> list[float]:
    """Success in percent at the last checkpoint, for each seed that has one."""
    return [run["final"]["normalised_score"] for run in runs if run["final"] is not None]


def _figures(runs: Sequence[Record]) -> dict[str, Any]:
    """One entry of the summary."""
    from odaf.evaluation.statistics import t_interval

    successes = _successes(runs)
    estimate = t_interval(successes) if successes else None
    return {
        "updates": runs[0]["steps"],
        "success": None if estimate is None else estimate.mean,
        "interval": None if estimate is None or len(successes) < 2 else [estimate.low, estimate.high],
        "seeds": sorted(run["seed"] for run in runs),
        "diverged": len(runs) - len(successes),
        "seconds": sum(run["seconds"]["total"] for run in runs) / len(runs),
    }


def table(records: Sequence[Record]) -> str:
    """Markdown: for each set a row for every method over its seeds."""
    lines = [
        f"Success in percent on {LOCAL}: of {EVALUATION.final_episodes} episodes of the last checkpoint, each with a",
        "goal of its own in the goal's cell, deterministic policy. Intervals are 95 % Student intervals over seeds.",
        "Seconds hold everything, a seed on one core of a machine that had other work.",
        "Made by `odaf reproduce antmaze` from the records in this folder.",
    ]
    for task, group in grouped(records, lambda record: record["task"]).items():
        data = group[0]["data"]
        lines += [
            "",
            f"**{task}** ({group[0]['environment']}; {data['transitions']:,} rows): {data['reached_share']:.0%} of its "
            f"walks reach their own goal, {data['flipped_share']:.0%} end on their back; {data['goal_walks']:,} walks "
            "end at the goal of evaluation.",
            "",
            "| method | updates | seeds | success | 95 % interval | seconds |",
            "|---|---|---|---|---|---|",
            *(_row(runs) for runs in grouped(group, lambda record: record["method"]).values()),
        ]
    return "\n".join(lines) + "\n"


def _row(runs: Sequence[Record]) -> str:
    figures = _figures(runs)
    head = f"| {runs[0]['method']} | {figures['updates']:,} | {len(runs)} "
    if figures["diverged"]:
        return f"{head}| {figures['diverged']} of {len(runs)} diverged | | {figures['seconds']:,.0f} |"
    low_high = figures["interval"]
    interval = "one seed" if low_high is None else f"[{low_high[0]:.1f}, {low_high[1]:.1f}]"
    return f"{head}| {figures['success']:.1f} | {interval} | {figures['seconds']:,.0f} |"


def summary(records: Sequence[Record]) -> str:
    """JSON: for each set and method its success, interval, seeds and seconds."""
    tasks = {
        task: {method: _figures(runs) for method, runs in grouped(group, lambda record: record["method"]).items()}
        for task, group in grouped(records, lambda record: record["task"]).items()
    }
    return json.dumps(tasks, indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """The paths of every method's first seed, a row for each method and a column for each set, drawn to `out`."""
    from odaf.report.layout import maze_layout
    from odaf.report.study_figures import Paths, paths_figure

    drawn = [one for one in records if one.get("paths", {}).get("places")]
    if not drawn:
        return
    sets = [name for name in SMALL + OTHERS if any(one["task"] == name for one in drawn)]
    rows: dict[str, list[Paths | None]] = {}
    for method, runs in grouped(drawn, lambda record: record["method"]).items():
        first = {one["task"]: one for one in sorted(runs, key=lambda one: -one["seed"])}
        rows[method] = [None] * len(sets)
        for place, name in enumerate(sets):
            layout = maze_layout({"name": "gymnasium", "id": first[name]["environment"]}) if name in first else None
            if layout is not None:
                said = f"{first[name]['final']['normalised_score']:.0f} %"
                rows[method][place] = Paths(layout, kept_paths(first[name]), None, said)
    note = f"{LOCAL}; the last checkpoint of one seed, dashed where an episode does not reach its goal within the ring"
    paths_figure(rows, sets, out, "Paths of every method", note)


STUDY = Study(
    "antmaze",
    "every method on the six sets of ants in mazes",
    plan,
    {"table.md": table, "summary.json": summary},
    {"paths.png": figure},
)
