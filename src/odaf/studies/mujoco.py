"""The MuJoCo study: the paper's Table 1, fifteen logs of three robots, its rivals and our form."""

import json
import statistics
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from odaf.studies.final_scores import Finals, finals_of, over_tasks
from odaf.studies.job import Phase, Record, Study
from odaf.studies.paper_scores import COLUMNS, paper_score
from odaf.studies.public_logs import PUBLIC
from odaf.studies.robots import KINDS, ROBOTS, Method, robot_form, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training, phases_of
from odaf.studies.verdict import Claim, Verdict, decide

EVALUATION = Evaluation(every=10_000, episodes=10)
STEPS, SEEDS = 50_000, 4
FAST: tuple[Method, ...] = (("behaviour-cloning", ()), ("svr", ()), ("spot", ()), ("odaf-locomotion", ()))
MIDDLE: tuple[Method, ...] = (
    ("odaf-locomotion-without-outcome", ()),
    ("sac-n", ()),
    ("osr-10", ()),
    ("edac", (("num_critics", 10),)),
    ("sdc", ()),
    ("cql", ()),
)
COSTLY: tuple[Method, ...] = (("odaf-paper", ()), ("pbrl", ()), ("rorl", ()))
RIVALS = ("cql", "pbrl", "spot", "svr", "edac-num_critics-10", "rorl", "sdc", "osr-10")
SETS = tuple(f"{robot}-{kind}" for kind in KINDS for robot in ROBOTS)


def plan(data: Path | None = None) -> list[Phase]:
    """Non-expert logs and fast methods first."""

    def runs(methods: Sequence[Method], kinds: Sequence[str]) -> list[Training]:
        found = []
        for seed in range(SEEDS):
            for kind in kinds:
                for robot in ROBOTS:
                    task = robot_task(robot, kind, EVALUATION, data=data)
                    for preset, changes in methods:
                        # Values of a preset for a log of a robot count where it has some; so do the paper's radii.
                        form = robot_form(preset, task)
                        found.append(Training(preset, task, seed, STEPS, changes, form))
        return found

    six, others = ("medium", "medium-replay"), ("random", "medium-expert", "expert")
    return phases_of(
        ("six medium and medium-replay logs: fast methods", runs(FAST, six)),
        ("the other nine logs: fast methods", runs(FAST, others)),
        ("six logs: learners with ten critics, CQL, SDC (lanes)", runs(MIDDLE, six)),
        ("six logs: the paper's form, PBRL, RORL (lanes)", runs(COSTLY, six)),
        ("the other nine logs: all of these (lanes)", runs((*MIDDLE, *COSTLY), others)),
    )


def verdict(records: Sequence[Record], method: str = "odaf-paper") -> Verdict:
    """Whether a method's mean over the fifteen logs is above that of each rival in the paper's table."""
    finals = finals_of(records)
    return decide([over_tasks(finals, method, rival, SETS) for rival in RIVALS])


def ours(records: Sequence[Record]) -> Verdict:
    """The same of our form."""
    return verdict(records, "odaf-locomotion")


CLAIM = Claim(
    "the method is best on average over fifteen logs of three robots",
    (
        "Fifteen logs: three robots, random, medium, medium-replay, medium-expert and expert; 50,000 updates, ten "
        "episodes at the last checkpoint, four seeds.",
        "Held if the mean over the logs is above that of each of the paper's eight rivals, seed by seed.",
    ),
    (
        "Logs of 100,000 rows recorded here, unless --data names the public files; scores of other data are no "
        "yardstick, and the paper's stand beside them for information.",
        "50,000 updates; the released code trains for millions. EDAC has ten critics on Hopper too, not fifty.",
        "The paper's bold type names the method where SVR is higher (walker2d-medium-replay).",
    ),
    verdict,
    ours,
)


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each log, a column for every method, the paper's own score beside it."""
    from odaf.evaluation.across_tasks import improvement_over_tasks, interquartile_mean_over_tasks

    finals = finals_of(records)
    methods = list(dict.fromkeys(method for by_method in finals.values() for method in by_method))
    public = any(record["data"].get("origin") == PUBLIC for record in records)
    origin = "public data" if public else "data recorded here, NOT the public sets: the paper's scores are no yardstick"
    lines = [
        f"Normalised scores, last checkpoint, ten episodes, means over seeds; {origin}. In brackets what the paper's",
        "Table 1 has for the method on the public set of that name. Made by `odaf reproduce mujoco` from the records",
        "in this folder.",
        "",
        f"| log | {' | '.join(methods)} | paper's method |",
        f"|{'---|' * (len(methods) + 2)}",
    ]
    for task in [name for name in SETS if name in finals]:
        cells = []
        for method in methods:
            seeds, known = finals[task].get(method, {}), paper_score(task, COLUMNS.get(method, ""))
            beside = f" ({known:.1f})" if known is not None else ""
            cells.append(f"{statistics.fmean(seeds.values()):.1f}{beside}" if seeds else "")
        lines.append(f"| {task} | {' | '.join(cells)} | {paper_score(task, 'ODAF'):.1f} |")
    lines += [
        "",
        "Interquartile means of all runs over the logs that a method has, by stratified bootstrap:",
        "",
    ]
    for method in methods:
        own = {task: list(each[method].values()) for task, each in finals.items() if method in each}
        found = interquartile_mean_over_tasks(own)
        interval = f"[{found.low:.1f}, {found.high:.1f}]" if found.low == found.low else "one seed each"
        lines.append(f"- {method}: {found.mean:.1f} {interval}, {len(own)} logs, {found.count} runs")
    better = [
        "",
        "Probability that a run of the first is above one of the second on the same log, over the logs of both:",
        "",
    ]
    for first in ("odaf-paper", "odaf-locomotion"):
        for second in [name for name in methods if name in RIVALS and first in methods]:
            both = [task for task, each in finals.items() if {first, second} <= each.keys()]
            if both:
                ours, theirs = ({task: list(finals[task][name].values()) for task in both} for name in (first, second))
                found = improvement_over_tasks(ours, theirs)
                interval = f"[{found.low:.2f}, {found.high:.2f}]" if found.low == found.low else "one seed each"
                better.append(f"- {first} over {second}: {found.probability:.2f} {interval}, {len(both)} logs")
    lines += better if len(better) > 3 else []
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by log and method the score of each seed."""
    return json.dumps(finals_of(records), indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """Mean scores by method and log; what was not measured stays empty."""
    from odaf.report.figures import grid_figure

    finals = finals_of(records)
    sets = [name for name in SETS if name in finals]
    methods = list(dict.fromkeys(method for task in sets for method in finals[task]))
    if not methods:
        return
    values = np.full((len(methods), len(sets)), np.nan)
    for column, task in enumerate(sets):
        for row, method in enumerate(methods):
            if method in finals[task]:
                values[row, column] = statistics.fmean(finals[task][method].values())
    grid_figure(methods, sets, values, out, "Scores by method and log", "normalised scores of last checkpoints")


HEIGHTS = tuple(range(0, 121, 5))


def profiles(records: Sequence[Record], out: Path) -> None:
    """Share of runs above each score, for methods that have all logs that any method has."""
    from odaf.evaluation.across_tasks import performance_profile
    from odaf.report.study_figures import Line, lines_figure

    finals = finals_of(records)
    methods = [name for name in dict.fromkeys(m for each in finals.values() for m in each) if _has_all(finals, name)]
    lines = []
    for method in methods:
        scores = {task: list(each[method].values()) for task, each in finals.items()}
        shares, _, _ = performance_profile(scores, HEIGHTS, resamples=1)
        lines.append(Line(method, HEIGHTS, [[float(share)] for share in shares]))
    if lines:
        note = "every log counts alike; methods that were measured on all of the logs"
        lines_figure({f"{len(finals)} logs": lines}, out, "Performance profiles", note, "score", "share of runs above")


def _has_all(finals: Finals, method: str) -> bool:
    return all(method in each for each in finals.values())


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "mujoco",
        "the paper's table of fifteen logs of three robots, its rivals and our form",
        partial(plan, data),
        {"table.md": table, "summary.json": summary},
        {"figure.png": figure, "profiles.png": profiles},
        CLAIM,
        on_files=study,
    )


STUDY = study()
