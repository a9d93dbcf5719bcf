"""The outcome study: what does the outcome term add where its base is stressed, with few critics?

The stitching maze, ensembles of two, four and ten critics, three weights of the term. One JSON file a run under the
results directory and tables drawn from those files. Runs whose file is there are not repeated; a run that was stopped
goes on from its last checkpoint.
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from odaf.experiments.ledger import (
    LOCAL,
    StudyRun,
    chosen_phases,
    grouped,
    measure_missing,
    read_records,
    run_facts,
    train_while_finite,
)
from odaf.experiments.pointmaze_study import EPISODES, EVALUATE_EVERY, data_figures, data_file

MAZE = "stitch"
CRITICS = (2, 4, 10)
WEIGHTS = (0.0, 0.3, 3.0)
SEEDS = 3
STEPS = 20_000


def plan() -> list[list[StudyRun]]:
    """A phase for every size of the ensemble, the smallest first; in each, all weights of a seed come together."""
    return [
        [
            StudyRun("odaf", MAZE, seed, STEPS, (("num_critics", critics), ("outcome.weight", weight)))
            for seed in range(SEEDS)
            for weight in WEIGHTS
        ]
        for critics in CRITICS
    ]


def run(out: Path, workers: int = 1, phase: Sequence[int] = (), work: Path | None = None) -> None:
    """Measure what is missing, then draw the tables.

    Args:
        out: directory of the records and `table.md`.
        workers: runs at the same time, each on its own core.
        phase: phases of `plan` to measure, from 1; none takes all.
        work: directory of data and run directories; None takes `runs/outcome`.

    Raises:
        ConfigError: `phase` names one that the study has not.
    """
    work = Path("runs/outcome") if work is None else work
    # No run goes on where another stopped, so no worker has to wait for the end of a phase.
    runs = [job for part in chosen_phases(plan(), phase) for job in part]
    measure_missing(measure, [runs], out, work, workers=workers, prepare=data_file, summarise=summarise)


def summarise(out: Path) -> None:
    """Draw `table.md` from the records in `out`."""
    (out / "table.md").write_text(table(read_records(out)), encoding="utf-8")


def measure(study: StudyRun, work: Path) -> dict[str, Any]:
    """Train (or continue) one run and return its record."""
    from odaf.evaluation import Rollouts
    from odaf.experiments import presets

    changes = dict(study.changes)
    rollouts = Rollouts(episodes=EPISODES, every=EVALUATE_EVERY)
    run = train_while_finite(study, work, presets.load(study.preset, changes), data_file(work, study.task), rollouts)
    facts = run_facts(study, run)
    return {
        "study": "outcome",
        "maze": study.task,
        "critics": changes["num_critics"],
        "weight": changes["outcome.weight"],
        "command": "odaf reproduce outcome",
        **facts,
        "data": {**facts["data"], **data_figures(run, study.task)},
    }


def table(records: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row for every ensemble and weight over its seeds, with the paired difference against weight 0."""
    lines = [
        f"Scores on {LOCAL}: the stitching maze, preset `odaf` but for critics and weight; last checkpoint,",
        f"deterministic policy, {EPISODES} episodes a seed. Intervals are 95 % Student intervals over seeds. The gain",
        "is the return less that of weight 0 with the same seed and number of critics, over seeds that have both. Made",
        "by `odaf reproduce outcome` from the records in this folder.",
        "",
        "| critics | weight | updates | seeds | return | 95 % interval | worst seed | stitched | gain over weight 0 "
        "| 95 % interval of the gain | pairs |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    finished = [record for record in records if record["final"] is not None]
    for (critics, steps), ensemble in grouped(finished, itemgetter("critics", "steps")).items():
        weights = grouped(ensemble, itemgetter("weight"))
        base = _returns(weights.get(0.0, []))
        for weight, group in weights.items():
            lines.append(_row(critics, weight, steps, group, base))
    lost = [record for record in records if record["final"] is None]
    if lost:
        lines += ["", "Diverged, and in no row above:", ""]
        lines += [
            f"- {record['critics']} critics, weight {record['weight']:g}, seed {record['seed']}: after "
            f"{record['updates']:,} of {record['steps']:,} updates"
            for record in lost
        ]
    if records:
        data = records[0]["data"]
        lines += [
            "",
            f"Data ({LOCAL}): {data['transitions']:,} transitions, mean logged return {data['mean_return']:.1f}, best "
            f"{data['best_return']:.1f}; the scripted driver sent straight to the goal's cell earns "
            f"{data['direct_return']:.1f}, to the hidden target {data['ceiling']:.1f}.",
        ]
    return "\n".join(lines) + "\n"


def _row(critics: int, weight: float, steps: int, group: Sequence[dict[str, Any]], base: dict[int, float]) -> str:
    from odaf.evaluation.statistics import paired_difference, t_interval

    returns = _returns(group)
    estimate = t_interval(list(returns.values()))
    stitched = sum(record["final"]["stitched_rate"] for record in group) / len(group)
    gain = "| | | |"
    seeds = sorted(returns.keys() & base.keys())
    if weight != 0.0 and seeds:
        difference = paired_difference([returns[seed] for seed in seeds], [base[seed] for seed in seeds])
        gain = f"| {difference.mean:+.1f} | {_interval(difference, '+.1f')} | {len(seeds)} |"
    return (
        f"| {critics} | {weight:g} | {steps:,} | {len(group)} | {estimate.mean:.1f} | {_interval(estimate, '.1f')} "
        f"| {min(returns.values()):.1f} | {stitched:.2f} {gain}"
    )


def _interval(estimate: Any, form: str) -> str:
    return f"[{estimate.low:{form}}, {estimate.high:{form}}]" if estimate.count > 1 else "one seed"


def _returns(group: Sequence[dict[str, Any]]) -> dict[int, float]:
    """Mean return of the last checkpoint by seed."""
    return {record["seed"]: record["final"]["mean_return"] for record in group}
