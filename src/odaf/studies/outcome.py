"""The outcome study: what does the outcome term add where its base is stressed, with few critics?

The stitching maze, ensembles of two, four and ten critics, three weights of the term; then the same question on Hopper.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter

from odaf.studies.first_form import first_form
from odaf.studies.job import Phase, Record, Study
from odaf.studies.locomotion import FINAL_EPISODES, HOPPER, locomotion_task
from odaf.studies.logs import LOCAL, origin_of
from odaf.studies.pointmaze_first import EPISODES, maze_task
from odaf.studies.tables import grouped, interval
from odaf.studies.task import Task
from odaf.studies.training import Training, phases_of

SEEDS = range(3)
# Where the three seeds of four critics on Hopper all gained from weight 1: seeds that had no part in finding that.
FRESH_SEEDS = range(3, 8)
STEPS = 20_000


def plan() -> list[Phase]:
    """A phase for every task and size of the ensemble, the smallest first; all weights of a seed come together."""

    def runs(preset: str, task: Task, critics: int, weights: Sequence[float], seeds: range) -> list[Training]:
        return [
            Training(
                preset,
                task,
                seed,
                STEPS,
                (("num_critics", critics), ("outcome.weight", weight)),
                first_form(preset),
                notes=(("critics", critics), ("weight", weight)),
            )
            for seed in seeds
            for weight in weights
        ]

    maze, hopper = ("odaf", maze_task("stitch")), ("odaf-locomotion", locomotion_task(HOPPER))
    return phases_of(
        ("the maze, two critics", runs(*maze, 2, (0.0, 0.3, 3.0), SEEDS)),
        ("the maze, four critics", runs(*maze, 4, (0.0, 0.3, 3.0), SEEDS)),
        ("the maze, ten critics", runs(*maze, 10, (0.0, 0.3, 3.0), SEEDS)),
        ("Hopper, four critics", runs(*hopper, 4, (0.0, 1.0, 20.0), SEEDS)),
        ("Hopper, four critics, fresh seeds", runs(*hopper, 4, (0.0, 1.0), FRESH_SEEDS)),
        ("Hopper, ten critics", runs(*hopper, 10, (0.0, 1.0, 20.0), SEEDS)),
    )


def table(records: Sequence[Record]) -> str:
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
            f"{FINAL_EPISODES} episodes a seed, normalised scores.",
            f"Data ({origin_of(data)}): {data['transitions']:,} transitions, mean score "
            f"{data['normalised_score']:.1f}.",
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


Figure = Callable[[Record], float]  # of a record's final evaluation


def _rows(records: Sequence[Record], name: str, result: Figure, stitched: Figure | None = None) -> list[str]:
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
    return f"{estimate.mean:.1f} | {interval(estimate)} | {min(results.values()):.1f}"


def _gain(results: dict[int, float], base: dict[int, float]) -> str:
    from odaf.evaluation.statistics import paired_difference

    seeds = sorted(results.keys() & base.keys())
    if not seeds:
        return "| | | |"
    difference = paired_difference([results[seed] for seed in seeds], [base[seed] for seed in seeds])
    return f"| {difference.mean:+.1f} | {interval(difference, '+')} | {len(seeds)} |"


STUDY = Study(
    "outcome",
    "what the outcome term adds in the maze with two, four and ten critics, and on Hopper",
    plan,
    {"table.md": table},
)
