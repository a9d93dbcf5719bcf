"""The stitching study: who finds the path that no demonstration took, and does it last?

One JSON file a run under the results directory, a table and a figure drawn from those files. Runs whose file is there
are not repeated; a run that was stopped goes on from its last checkpoint.
"""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from odaf.experiments.workers import run_jobs
from odaf.training.files import write_json

DATA_SEED = 0
EPISODES = 50
EVALUATE_EVERY = 5_000
CHECKPOINT_EVERY = 5_000
LOCAL = "locally generated data"


@dataclass(frozen=True)
class StudyRun:
    """One policy to train and score."""

    preset: str
    maze: str
    seed: int
    steps: int
    changes: tuple[tuple[str, Any], ...] = ()  # settings other than the preset's

    @property
    def method(self) -> str:
        """The preset and what is changed in it, as in `odaf-return_steps-5`."""
        return "-".join([self.preset, *(f"{field}-{value}" for field, value in self.changes)])

    @property
    def name(self) -> str:
        """File name of its record, without the ending."""
        return f"{self.maze}-{self.method}-seed{self.seed}-{self.steps}"


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
    runs = [job for phase in plan() for job in phase]
    missing = [job for job in runs if not (out / f"{job.name}.json").exists()]
    print(f"{len(missing)} of {len(runs)} runs to go; records in {out}", file=sys.stderr)
    for maze in sorted({job.maze for job in missing}):
        _data_file(work, maze)
    for phase in plan():
        jobs = [(job, out, work) for job in phase if job in missing]
        for (job, _, _), record in run_jobs(_measure, jobs, workers):
            final = record["final"]
            print(f"{job.name}: {final['mean_return']:.1f} +- {final['std_return']:.1f}", file=sys.stderr)
            summarise(out)
    summarise(out)


def summarise(out: Path) -> None:
    """Draw `table.md` and `figure.png` from the records in `out`."""
    records = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*-seed*.json"))]
    out.mkdir(parents=True, exist_ok=True)
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
    groups: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for record in records:
        groups.setdefault((record["maze"], record["method"], record["steps"]), []).append(record)
    for (maze, method, steps), group in sorted(groups.items()):
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
    from odaf.experiments.figures import learning_curves_figure
    from odaf.experiments.report.quantities import Curve

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


def _measure(job: tuple[StudyRun, Path, Path]) -> dict[str, Any]:
    """Train (or continue) one run and write its record."""
    study, out, work = job
    from odaf.evaluation import Rollouts
    from odaf.experiments import presets
    from odaf.experiments.fit import fit, resume

    directory = work / f"{study.maze}-{study.method}-seed{study.seed}"
    if _steps_of(directory) < study.steps:
        run = resume(directory, study.steps)
    else:
        run = fit(
            presets.load(study.preset, dict(study.changes)),
            _data_file(work, study.maze),
            steps=study.steps,
            seeds=[study.seed],
            directory=directory,
            evaluate=Rollouts(episodes=EPISODES, every=EVALUATE_EVERY),
            checkpoint_every=CHECKPOINT_EVERY,
            preset=study.preset,
        )
    record = _record(study, run)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{study.name}.json", record)
    return record


def _steps_of(directory: Path) -> float:
    """Updates that the run in `directory` was made for; infinity where there is none to make longer."""
    from odaf.experiments.fit import load_run

    return load_run(directory).config["steps"] if (directory / "config.json").exists() else math.inf


def _data_file(work: Path, maze: str) -> Path:
    """The maze's logged episodes, generated when they are not there yet."""
    path = work / f"{maze}.h5"
    if not path.exists():
        from odaf.environments.stitch_data import CONFIGS, generate

        path.parent.mkdir(parents=True, exist_ok=True)
        generate(CONFIGS[maze], seed=DATA_SEED).save(path)
    return path


def _direct_returns(maze: str) -> dict[str, float]:
    """What the scripted driver earns when it is sent straight to the goal's cell, or to the hidden target."""
    from odaf.environments.stitch_data import CONFIGS, direct_controller_return

    return {
        name: float(direct_controller_return(CONFIGS[maze], EPISODES, knows_target=knows).mean())
        for name, knows in (("direct_return", False), ("ceiling", True))
    }


def _record(study: StudyRun, run: Any) -> dict[str, Any]:
    """What the ledger keeps of a run: scores, settings, versions, data fingerprint; no path of this machine."""
    summary = run.summary[study.seed]
    versions = json.loads((run.directory / "environment.json").read_text(encoding="utf-8"))
    figures = run.data["summary"]
    return {
        "study": "pointmaze",
        "maze": study.maze,
        "preset": study.preset,
        "changes": dict(study.changes),
        "method": study.method,
        "seed": study.seed,
        "steps": study.steps,
        "command": "odaf reproduce pointmaze",
        "data": {
            "origin": LOCAL,
            "sha256": run.data["sha256"],
            **{key: figures[key] for key in ("transitions", "episodes", "mean_return", "best_return")},
            **_direct_returns(study.maze),
        },
        "final": summary["evaluation"],
        "evaluations": [
            {
                "step": line["step"],
                "mean_return": line["evaluation/return_mean"],
                "std_return": line["evaluation/return_std"],
                "success_rate": line.get("evaluation/success_rate"),
                "stitched_rate": line.get("evaluation/stitched_rate"),
            }
            for line in run.metrics(study.seed)
            if "evaluation/return_mean" in line
        ],
        "updates_per_second": summary["updates_per_second"],
        "seconds": summary["seconds"],
        "pretrain": summary["pretrain"],
        "warnings": summary["warnings"],
        "algorithm": run.config["algorithm"],
        "versions": {key: versions[key] for key in ("python", "versions", "device", "platform")},
    }
