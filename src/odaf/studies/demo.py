"""The main job in one command: log poor demonstrations, learn from them, look at the policy that stitched them.

Trains ODAF, the same learner without its outcome term, and behaviour cloning on one budget, evaluates each at its last
checkpoint, and writes `report.html`, `maze.png` and `summary.json`.
"""

import sys
import time
from pathlib import Path
from typing import Any

from odaf.runs.workers import run_jobs
from odaf.training.files import write_json

METHODS = {"odaf": "odaf", "odaf-without-outcome": "odaf without its outcome term", "behaviour-cloning": "cloning"}
DATA_SEED, TRAINING_SEED = 0, 0
STEPS = 5_000
# Five-step targets carry values back within so few updates. In this maze they are worse than one-step targets later on.
CHANGES: dict[str, dict[str, Any]] = {name: {"return_steps": 5} for name in ("odaf", "odaf-without-outcome")}
EPISODES = 50


def run(out: Path, steps: int = STEPS, workers: int | None = None) -> dict[str, Any]:
    """Do it all; the same call again goes on where it stopped.

    Args:
        out: directory for data, runs, `report.html` and `summary.json`.
        steps: updates for each method.
        workers: methods trained at the same time; None takes one a core, at most one a method.

    Returns:
        The content of `summary.json`.
    """
    from odaf import report
    from odaf.data import Dataset
    from odaf.environments.stitch_data import generate
    from odaf.report.figures import maze_figure

    start = time.perf_counter()
    seconds: dict[str, float] = {}
    data = out / "pointmaze-stitch.h5"
    if not data.exists():
        print("Logging 1,000 poor demonstrations in a maze ...", file=sys.stderr)
        out.mkdir(parents=True, exist_ok=True)
        generate(seed=DATA_SEED).save(data)
    dataset = Dataset.load(data)
    seconds["data"] = time.perf_counter() - start

    jobs = [(preset, data, out / preset, steps) for preset in METHODS]
    methods: dict[str, Any] = {}
    for (preset, *_), record in run_jobs(_train, jobs, _workers() if workers is None else workers):
        methods[preset] = record["method"]
        seconds[preset] = record["seconds"]
    directories = [out / preset for preset in METHODS]
    report.build(directories, out / "report.html", title="ODAF stitches a maze")
    maze_figure(directories, out / "maze.png", names=list(METHODS.values()))
    seconds["total"] = time.perf_counter() - start

    returns = dataset.episode_returns()
    summary = {
        "dataset": {
            "mean_return": float(returns.mean()),
            "best_return": float(returns.max()),
            "origin": "locally generated data",
        },
        "methods": {preset: methods[preset] for preset in METHODS},
        "steps": steps,
        "episodes": EPISODES,
        "seconds": seconds,
    }
    write_json(out / "summary.json", summary)
    _print_table(summary, out)
    return summary


def _train(job: tuple[str, Path, Path, int]) -> dict[str, Any]:
    """Train one method and score its last checkpoint."""
    preset, data, directory, steps = job
    from odaf.evaluation import Rollouts
    from odaf.runs import presets
    from odaf.runs.fit import fit

    result = fit(
        presets.load(preset, CHANGES.get(preset)),
        data,
        steps=steps,
        seeds=[TRAINING_SEED],
        directory=directory,
        evaluate=Rollouts(episodes=EPISODES, every=max(1, steps // 4)),
        checkpoint_every=max(1, steps // 4),
        preset=preset,
    )
    summary = result.summary[TRAINING_SEED]
    score = summary["evaluation"]
    fields = ("mean_return", "std_return", "success_rate", "stitched_rate")
    method = {field: score[field] for field in fields} | {"updates_per_second": summary["updates_per_second"]}
    return {"method": method, "seconds": summary["seconds"]["total"]}


def _workers() -> int:
    import os

    return min(len(METHODS), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1)


def _print_table(summary: dict[str, Any], out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"After {summary['steps']:,} updates, {summary['episodes']} episodes (locally generated data)")
    for heading in ("", "mean return", "std", "success", "stitched", "updates/s"):
        table.add_column(heading, justify="left" if not heading else "right")
    logged = summary["dataset"]
    table.add_row("logged, mean", f"{logged['mean_return']:.1f}", "", "", "", "")
    table.add_row("logged, best", f"{logged['best_return']:.1f}", "", "", "", "", end_section=True)
    for preset, figures in summary["methods"].items():
        table.add_row(
            METHODS[preset],
            f"{figures['mean_return']:.1f}",
            f"{figures['std_return']:.1f}",
            f"{figures['success_rate']:.0%}",
            f"{figures['stitched_rate']:.0%}",
            f"{figures['updates_per_second']:.1f}",
        )
    Console().print(table)
    print(f"Look at {out / 'report.html'}")
