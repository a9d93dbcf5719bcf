"""The stitching study: who finds the path that no demonstration took, and does it last?

One JSON file a run under the results directory, a table and a figure drawn from those files. Runs whose file is there
are not repeated; a run that was stopped goes on from its last checkpoint.
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from odaf.studies.ledger import LOCAL, StudyRun, grouped, measure_missing, read_records, run_facts, train

DATA_SEED = 0
EPISODES = 50
EVALUATE_EVERY = 5_000


def plan() -> list[list[StudyRun]]:
    """Every run of the study, in phases: a longer run goes on where the same one of an earlier phase stopped."""

    def runs(preset: str, maze: str, seeds: int, steps: int, **changes: Any) -> list[StudyRun]:
        return [StudyRun(preset, maze, seed, steps, tuple(changes.items())) for seed in range(seeds)]

    return [
        [
            *runs("odaf", "stitch", 4, 20_000),
            *runs("behaviour-cloning", "stitch", 4, 20_000),
            *runs("odaf", "shaft", 2, 20_000, return_steps=5),
            *runs("odaf", "stitch", 4, 20_000, return_steps=5),
            *runs("odaf", "stitch", 4, 20_000, return_steps=3),
            *runs("odaf", "shaft", 2, 20_000, return_steps=3),
            *runs("odaf", "shaft", 2, 20_000),
            *runs("odaf", "crossroads", 2, 20_000),
            *runs("odaf-without-outcome", "stitch", 4, 20_000),
            *runs("behaviour-cloning", "shaft", 2, 20_000),
            *runs("behaviour-cloning", "crossroads", 2, 20_000),
            *runs("odaf-paper", "stitch", 2, 10_000),
            *runs("odaf", "stitch", 4, 20_000, products="bfloat16"),
        ],
        [
            *runs("odaf", "stitch", 2, 50_000),
            *runs("odaf-without-outcome", "stitch", 2, 50_000),
            *runs("odaf-paper", "stitch", 2, 20_000),
        ],
    ]


def run(out: Path, workers: int = 1, work: Path | None = None) -> None:
    """Measure what is missing, then draw the table and the figure.

    Args:
        out: directory of the records, `table.md` and `figure.png`.
        workers: runs at the same time, each on its own core.
        work: directory of data and run directories; None takes `runs/pointmaze`.
    """
    work = Path("runs/pointmaze") if work is None else work
    measure_missing(_measure, plan(), out, work, workers=workers, prepare=data_file, summarise=summarise)


def summarise(out: Path) -> None:
    """Draw `table.md` and `figure.png` from the records in `out`."""
    records = read_records(out)
    (out / "table.md").write_text(table(records), encoding="utf-8")
    _figure(records, out / "figure.png")


def table(records: Sequence[dict[str, Any]]) -> str:
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
        interval = f"[{estimate.low:.1f}, {estimate.high:.1f}]" if len(group) > 1 else "one seed"
        stitched, success, speed = (
            sum(values) / len(group)
            for values in (
                [record["final"]["stitched_rate"] for record in group],
                [record["final"]["success_rate"] for record in group],
                [record["updates_per_second"] for record in group],
            )
        )
        lines.append(
            f"| {maze} | {method} | {steps:,} | {len(group)} | {estimate.mean:.1f} | {interval} | {min(returns):.1f} "
            f"| {stitched:.2f} | {success:.2f} | {speed:.1f} |"
        )
    lines.append("")
    for maze, data in sorted({record["maze"]: record["data"] for record in records}.items()):
        lines.append(
            f"- `{maze}` data: {data['transitions']:,} transitions, mean logged return {data['mean_return']:.1f}, "
            f"best {data['best_return']:.1f}; the scripted driver sent straight to the goal's cell earns "
            f"{data['direct_return']:.1f}, to the hidden target {data['ceiling']:.1f} ({LOCAL})"
        )
    return "\n".join(lines) + "\n"


def _figure(records: Sequence[dict[str, Any]], out: Path) -> None:
    from odaf.report.figures import learning_curves_figure
    from odaf.report.quantities import Curve

    longest: dict[tuple[str, int], dict[str, Any]] = {}
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


def data_file(work: Path, maze: str) -> Path:
    """The maze's logged episodes, generated when they are not there yet."""
    path = work / f"{maze}.h5"
    if not path.exists():
        from odaf.environments.stitch_data import CONFIGS, generate

        path.parent.mkdir(parents=True, exist_ok=True)
        generate(CONFIGS[maze], seed=DATA_SEED).save(path)
    return path


def data_figures(run: Any, maze: str) -> dict[str, Any]:
    """What a record keeps of the data: their returns, and what the scripted driver earns who is sent straight to the
    goal's cell (`direct_return`) or to the hidden target (`ceiling`)."""
    from odaf.environments.stitch_data import CONFIGS, direct_controller_return

    summary = run.data["summary"]
    direct, ceiling = (
        float(direct_controller_return(CONFIGS[maze], EPISODES, knows_target=knows).mean()) for knows in (False, True)
    )
    return {
        **{key: summary[key] for key in ("transitions", "episodes", "mean_return", "best_return")},
        "direct_return": direct,
        "ceiling": ceiling,
    }


def _measure(study: StudyRun, work: Path) -> dict[str, Any]:
    """Train (or continue) one run and return its record."""
    from odaf.evaluation import Rollouts
    from odaf.runs import presets

    learner = presets.load(study.preset, dict(study.changes))
    evaluate = Rollouts(episodes=EPISODES, every=EVALUATE_EVERY)
    run = train(study, work, learner, data_file(work, study.task), evaluate)
    facts = run_facts(study, run)
    return {
        "study": "pointmaze",
        "maze": study.task,
        "command": "odaf reproduce pointmaze",
        **facts,
        "data": {**facts["data"], **data_figures(run, study.task)},
    }
