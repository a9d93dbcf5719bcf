"""The outcome study: what does the outcome term add where its base is stressed, with few critics?

The stitching maze, ensembles of two, four and ten critics, three weights of the term; then the same question on Hopper.
One JSON file a run under the results directory and tables drawn from those files. Runs whose file is there are not
repeated; a run that was stopped goes on from its last checkpoint.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from odaf.studies import locomotion as locomotion_study
from odaf.studies.ledger import (
    LOCAL,
    StudyRun,
    chosen_phases,
    grouped,
    measure_missing,
    read_records,
    run_facts,
    train_while_finite,
)
from odaf.studies.pointmaze import EPISODES, EVALUATE_EVERY, data_figures
from odaf.studies.pointmaze import data_file as maze_file

MAZE, HOPPER = "stitch", locomotion_study.HOPPER
SEEDS = range(3)
# Where the three seeds of four critics on Hopper all gained from weight 1: seeds that had no part in finding that.
FRESH_SEEDS = range(3, 8)
STEPS = 20_000
# A phase for each: the task, its preset, the size of the ensemble, the weights of the term, and the seeds.
PHASES = (
    (MAZE, "odaf", 2, (0.0, 0.3, 3.0), SEEDS),
    (MAZE, "odaf", 4, (0.0, 0.3, 3.0), SEEDS),
    (MAZE, "odaf", 10, (0.0, 0.3, 3.0), SEEDS),
    (HOPPER, "odaf-locomotion", 4, (0.0, 1.0, 20.0), SEEDS),
    (HOPPER, "odaf-locomotion", 4, (0.0, 1.0), FRESH_SEEDS),
    (HOPPER, "odaf-locomotion", 10, (0.0, 1.0, 20.0), SEEDS),
)


def plan() -> list[list[StudyRun]]:
    """A phase for every task and size of the ensemble, the smallest first; all weights of a seed come together."""
    return [
        [
            StudyRun(preset, task, seed, STEPS, (("num_critics", critics), ("outcome.weight", weight)))
            for seed in seeds
            for weight in weights
        ]
        for task, preset, critics, weights, seeds in PHASES
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


def data_file(work: Path, task: str) -> Path:
    """The task's log, made when it is not there yet."""
    return maze_file(work, task) if task == MAZE else locomotion_study.data_file(work, task)


def measure(study: StudyRun, work: Path) -> dict[str, Any]:
    """Train (or continue) one run and return its record."""
    changes = dict(study.changes)
    record = _measure_maze(study, work) if study.task == MAZE else locomotion_study.measure(study, work)
    return record | {
        "study": "outcome",
        "critics": changes["num_critics"],
        "weight": changes["outcome.weight"],
        "command": "odaf reproduce outcome",
    }


def _measure_maze(study: StudyRun, work: Path) -> dict[str, Any]:
    from odaf.evaluation import Rollouts
    from odaf.runs import presets

    rollouts = Rollouts(episodes=EPISODES, every=EVALUATE_EVERY)
    learner = presets.load(study.preset, dict(study.changes))
    run = train_while_finite(study, work, learner, maze_file(work, study.task), rollouts)
    facts = run_facts(study, run)
    return {"maze": study.task, **facts, "data": {**facts["data"], **data_figures(run, study.task)}}


def table(records: Sequence[dict[str, Any]]) -> str:
    """Markdown: for each task a row for every ensemble and weight over its seeds, with the gain over weight 0."""
    maze = [record for record in records if "maze" in record]
    hopper = [record for record in records if "maze" not in record]
    lines = [
        f"Scores on {LOCAL}; last checkpoint, deterministic policy. Intervals are 95 % Student intervals over",
        "seeds. The gain is the result less that of weight 0 with the same seed and number of critics, over seeds",
        "that have both. Made by `odaf reproduce outcome` from the records in this folder.",
    ]
    if maze:
        data = maze[0]["data"]
        lines += [
            "",
            f"**The stitching maze**, preset `odaf` but for critics and weight, {EPISODES} episodes a seed.",
            f"Data ({LOCAL}): {data['transitions']:,} transitions, mean logged return {data['mean_return']:.1f}, best "
            f"{data['best_return']:.1f};",
            f"the scripted driver sent straight to the goal's cell earns {data['direct_return']:.1f}, to the hidden "
            f"target {data['ceiling']:.1f}.",
            "",
            *_rows(maze, "return", itemgetter("mean_return"), itemgetter("stitched_rate")),
        ]
    if hopper:
        data, task, environment = hopper[0]["data"], hopper[0]["task"], hopper[0]["environment"]
        lines += [
            "",
            f"**{task}** ({environment}), preset `odaf-locomotion` but for critics and weight,",
            f"{locomotion_study.FINAL_EPISODES} episodes a seed, normalised scores.",
            f"Data ({LOCAL}): {data['transitions']:,} transitions, mean score {data['normalised_score']:.1f}.",
            "",
            *_rows([record for record in hopper if record["seed"] in SEEDS], "score", itemgetter("normalised_score")),
        ]
    fresh = [record for record in hopper if record["seed"] in FRESH_SEEDS]
    if fresh:
        lines += [
            "",
            f"**{fresh[0]['task']} again**, seeds {FRESH_SEEDS[0]} to {FRESH_SEEDS[-1]}; none is in the rows above.",
            "",
            *_rows(fresh, "score", itemgetter("normalised_score")),
        ]
    return "\n".join(lines) + "\n"


Figure = Callable[[dict[str, Any]], float]  # of a record's final evaluation


def _rows(records: Sequence[dict[str, Any]], name: str, result: Figure, stitched: Figure | None = None) -> list[str]:
    """The table of one task, and beneath it the runs that have no result."""
    titles = ["critics", "weight", "updates", "seeds", name, "95 % interval", "worst seed"]
    titles += ["stitched"] if stitched else []
    titles += ["gain over weight 0", "95 % interval of the gain", "pairs"]
    lines = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    finished = [record for record in records if record["final"] is not None]
    for (critics, steps), ensemble in grouped(finished, itemgetter("critics", "steps")).items():
        weights = grouped(ensemble, itemgetter("weight"))
        results = {
            weight: {record["seed"]: result(record["final"]) for record in group} for weight, group in weights.items()
        }
        for weight, group in weights.items():
            share = f"{sum(stitched(record['final']) for record in group) / len(group):.2f} " if stitched else ""
            gain = _gain(results[weight], results.get(0.0, {})) if weight != 0.0 else "| | | |"
            cells = f"| {critics} | {weight:g} | {steps:,} | {len(group)} | {_summary(results[weight])} "
            lines.append(cells + (f"| {share}" if share else "") + gain)
    lost = [record for record in records if record["final"] is None]
    if lost:
        lines += ["", "Diverged, and in no row above:", ""]
    return lines + [
        f"- {record['critics']} critics, weight {record['weight']:g}, seed {record['seed']}: after "
        f"{record['updates']:,} of {record['steps']:,} updates"
        for record in lost
    ]


def _summary(results: dict[int, float]) -> str:
    """Mean, interval and worst of the results by seed."""
    from odaf.evaluation.statistics import t_interval

    estimate = t_interval(list(results.values()))
    return f"{estimate.mean:.1f} | {_interval(estimate, '.1f')} | {min(results.values()):.1f}"


def _gain(results: dict[int, float], base: dict[int, float]) -> str:
    from odaf.evaluation.statistics import paired_difference

    seeds = sorted(results.keys() & base.keys())
    if not seeds:
        return "| | | |"
    difference = paired_difference([results[seed] for seed in seeds], [base[seed] for seed in seeds])
    return f"| {difference.mean:+.1f} | {_interval(difference, '+.1f')} | {len(seeds)} |"


def _interval(estimate: Any, form: str) -> str:
    return f"[{estimate.low:{form}}, {estimate.high:{form}}]" if estimate.count > 1 else "one seed"
