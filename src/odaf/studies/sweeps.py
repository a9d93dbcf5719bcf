"""The sweeps study: what each number of the outcome term does, one at a time, on two logs."""

import json
import statistics
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from odaf.studies.final_scores import finals_of, pairs
from odaf.studies.job import Phase, Record, Study
from odaf.studies.robots import Changes, robot_task
from odaf.studies.tables import grouped, interval
from odaf.studies.task import Evaluation
from odaf.studies.training import Training, phases_of

EVALUATION = Evaluation(every=5_000, episodes=20)
STEPS, SEEDS = 20_000, 4
PRESET = "odaf-locomotion"

SWEEPS: dict[str, tuple[Changes, ...]] = {
    "weight": tuple((("outcome.weight", value),) for value in (0.0, 0.1, 0.3, 3.0)),
    "radius": tuple((("outcome.radius", value),) for value in (0.0, 0.005, 0.02, 0.05)),
    "critics": tuple((("num_critics", value),) for value in (2, 5)),
    # The model learns from the episodes that are not held out: a tenth of them, and a hundredth.
    "model error": tuple((("outcome.dynamics.holdout", value),) for value in (0.9, 0.99)),
    "solver": (
        (("outcome.ascent_steps", 10),),
        (("outcome.solver", "sample"), ("outcome.common_noise", True)),
        (("outcome.solver", "sample"),),
        (("outcome.solver", "sample"), ("outcome.num_draws", 1)),
    ),
}
"""By what is swept, the changes to the preset; itself it has weight 1, radius 0.01, ten critics, one gradient step."""


def plan(data: Path | None = None) -> list[Phase]:
    """The preset as it is, then a phase for each sweep; the mixture's log before Hopper's medium."""
    tasks = [robot_task("hopper", kind, EVALUATION, data=data) for kind in ("mixture", "medium")]

    def runs(name: str, settings: Sequence[Changes]) -> list[Training]:
        return [
            Training(PRESET, task, seed, STEPS, changes, notes=(("sweep", name),))
            for seed in range(SEEDS)
            for task in tasks
            for changes in settings
        ]

    return phases_of(
        ("as it is", runs("none", ((),))),
        *((f"the {name}", runs(name, settings)) for name, settings in SWEEPS.items()),
    )


def table(records: Sequence[Record]) -> str:
    """Markdown: for each log and sweep a row for every setting, with its gain over the preset, seed by seed."""
    from odaf.evaluation.statistics import paired_difference, t_interval

    finals = finals_of(records)
    lines = [
        f"`{PRESET}` with one number changed: normalised scores after {STEPS:,} updates, 20 episodes. Intervals are",
        "95 % Student intervals over seeds, gains over the preset as it is seed by seed. Made by `odaf reproduce",
        "sweeps` from the records in this folder.",
    ]
    for task, group in grouped(records, lambda one: one["task"]).items():
        lines += ["", f"**{task}**", "", "| sweep | setting | seeds | score | 95 % interval | gain | 95 % interval |"]
        lines.append("|---|---|---|---|---|---|---|")
        base = finals[task].get(PRESET, {})
        for (sweep, method), runs in grouped(group, lambda one: (_order(one["sweep"]), one["method"])).items():
            scores = finals[task][method]
            found = t_interval(list(scores.values()))
            cells = [f"{found.mean:.1f}", interval(found)]
            first, second = pairs(scores, base)
            gain = paired_difference(list(first), list(second)) if first and method != PRESET else None
            cells += ["", ""] if gain is None else [f"{gain.mean:+.1f}", interval(gain, "+")]
            changed = ", ".join(f"{name} {value}" for name, value in runs[0]["changes"].items()) or "as it is"
            name = "" if sweep < 0 else list(SWEEPS)[sweep]
            lines.append(f"| {name} | {changed} | {len(scores)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _order(sweep: str) -> int:
    return list(SWEEPS).index(sweep) if sweep in SWEEPS else -1


def summary(records: Sequence[Record]) -> str:
    """JSON: by log and method the score of each seed."""
    return json.dumps(finals_of(records), indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel for each log and sweep: bars by setting."""
    from odaf.report.study_figures import Bar, bars_figure

    finals, panels = finals_of(records), dict[str, list[Bar]]()
    for (task, sweep), group in grouped(records, lambda one: (one["task"], _order(one["sweep"]))).items():
        if sweep < 0:
            continue
        changed = {one["method"]: ", ".join(str(value) for value in one["changes"].values()) for one in group}
        shown = {PRESET: "as it is"} if PRESET in finals[task] else {}
        panels[f"{task}: {list(SWEEPS)[sweep]}"] = [
            Bar(name, statistics.fmean(finals[task][method].values()), list(finals[task][method].values()))
            for method, name in {**shown, **changed}.items()
        ]
    if panels:
        bars_figure(panels, out, "One number changed", "normalised scores; dots are seeds")


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "sweeps",
        "what weight, radius, critics, model error and solver of the outcome term do, on two logs of Hopper",
        partial(plan, data),
        {"table.md": table, "summary.json": summary},
        {"figure.png": figure},
        on_files=study,
    )


STUDY = study()
