"""The stitching table: what every method makes of four mazes, and the paths it takes there."""

import functools
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.job import Record
from odaf.studies.logs import LOCAL, MazeLog
from odaf.studies.pointmaze_methods import BASE, EPISODES, LOG_SEED, MAZES, MBRCSL, STEPS_OF, TRIED, TRIES, Winners
from odaf.studies.pointmaze_search import earned, said
from odaf.studies.tables import grouped, interval
from odaf.studies.training import kept_paths

if TYPE_CHECKING:
    from odaf.report.study_figures import Paths

PUBLISHED = {
    MBRCSL: "91.5 +- 7.1",
    "mopo": "77.9 +- 41.9",
    "combo": "56.6 +- 50.1",
    "behaviour-cloning-best": "54.0 +- 9.2",
    "cql": "34.8 +- 24.9",
}
"""In the stitching maze, by Zhou et al. 2024: ten episodes, four seeds, last checkpoint; from notes on the paper."""
LOGGED_EPISODES = 4  # of each route, behind the paths of a policy


def of_table(records: Sequence[Record]) -> list[Record]:
    """The records that the table is made of: trainings on whole logs of one driver, of another seed than searched."""
    return [one for one in records if "measure" not in one and one.get("map") in MAZES and _whole(one)]


def _whole(record: Record) -> bool:
    return record["percent"] == 100 and not record["broad"] and record["log_seed"] == LOG_SEED


def setting_of(record: Record, winners: Winners) -> str:
    """How a record's method was set, and how that setting came about."""
    preset, changes = record["preset"], record["changes"]
    words = said(tuple(changes.items()))
    if preset not in TRIED:
        return words
    if preset not in winners:
        return f"{words}, not searched"
    return f"{words}, best of {TRIES}" if dict(winners[preset]) == changes else f"{words}, not the best of {TRIES}"


def table(winners: Winners, records: Sequence[Record]) -> str:
    """Markdown: for each maze a row for every method, the highest mean return first."""
    own = of_table(records)
    budgets = ", ".join(f"`{preset}` {steps:,}" for preset, steps in STEPS_OF.items())
    lines = [
        f"Returns on {LOCAL} of seed {LOG_SEED}, on which no setting was tried; last checkpoint, deterministic policy,",
        f"{EPISODES} episodes a seed. Intervals are 95 % Student intervals over seeds. With a number of updates of",
        f"their own: {budgets}. `over the log` is the mean less the best logged return, `P > base` the",
        f"probability that a seed earns more than one of `{BASE}`. Seconds hold everything, models before",
        "the training included, on one core of a machine that had other work. A rival's setting is the best of",
        "`odaf reproduce pointmaze-search`; `not searched` is the preset as it is. A seed that diverged earned 0.",
        "Published values are those of MBRCSL's paper, second-hand and on its own log; ODAF's paper shows its returns",
        "in a picture without numbers. Made by `odaf reproduce pointmaze` from the records in this folder.",
    ]
    if not own:
        return "\n".join([*lines, "", "Not measured yet."]) + "\n"
    lines += ["", *_overview(own, winners)]
    for maze, group in grouped(own, lambda one: MAZES.index(one["map"])).items():
        data, methods = group[0]["data"], grouped(group, lambda one: one["method"])
        base = [earned(one) for one in methods.get(BASE, [])]
        lines += [
            "",
            f"**{MAZES[maze]}**: {data['transitions']:,} rows, mean logged return {data['mean_return']:.1f}, best "
            f"{data['best_return']:.1f}; the scripted driver sent straight to the goal's cell earns "
            f"{data['direct_return']:.1f}, to the hidden target {data['ceiling']:.1f}.",
            "",
            "| method | setting | updates | seeds | return | 95 % interval | worst seed | over the log | stitched "
            "| P > base | seconds | published |",
            f"|{'---|' * 12}",
        ]
        ranked = sorted(methods.values(), key=lambda runs: -statistics.fmean(map(earned, runs)))
        lines += [_row(runs, base, winners, MAZES[maze] == "stitch") for runs in ranked]
    return "\n".join(lines) + "\n"


def _overview(records: Sequence[Record], winners: Winners) -> list[str]:
    """A row for each method: means by maze with the share of stitched episodes, and how its seeds stand to the log."""
    lines = [
        "Who stitches: mean return and, in brackets, the share of episodes that stitch; then in how many mazes the",
        "mean is above the best logged return, and how many seeds are not.",
        "",
        f"| method | setting | {' | '.join(MAZES)} | mazes above the log | seeds not above it |",
        f"|{'---|' * (4 + len(MAZES))}",
    ]
    methods = grouped(records, lambda one: one["method"]).values()
    for runs in sorted(methods, key=lambda runs: -statistics.fmean(map(_over_log, runs))):
        by_maze = grouped(runs, lambda one: MAZES.index(one["map"]))
        cells = [""] * len(MAZES)
        for maze, some in by_maze.items():
            cells[maze] = f"{statistics.fmean(map(earned, some)):.1f} ({statistics.fmean(map(_stitched, some)):.2f})"
        above = sum(statistics.fmean(map(_over_log, some)) > 0.0 for some in by_maze.values())
        below = sum(_over_log(one) <= 0.0 for one in runs)
        lines.append(
            f"| {runs[0]['preset']} | {setting_of(runs[0], winners)} | {' | '.join(cells)} | {above} of {len(by_maze)} "
            f"| {below} of {len(runs)} |"
        )
    return lines


def _over_log(record: Record) -> float:
    return earned(record) - record["data"]["best_return"]


def _stitched(record: Record) -> float:
    return 0.0 if record["final"] is None else record["final"]["stitched_rate"]


def _row(runs: Sequence[Record], base: list[float], winners: Winners, published: bool) -> str:
    from odaf.evaluation.statistics import improvement, t_interval

    first, returns = runs[0], [earned(one) for one in runs]
    estimate = t_interval(returns)
    over, stitched = statistics.fmean(map(_over_log, runs)), statistics.fmean(map(_stitched, runs))
    better = ""
    if base and first["method"] != BASE:
        found = improvement(returns, base, resamples=999)
        better = f"{found.probability:.2f}"
        better += f" [{found.low:.2f}, {found.high:.2f}]" if found.low == found.low else ""
    seconds = statistics.fmean(one["seconds"]["total"] for one in runs)
    return (
        f"| {first['preset']} | {setting_of(first, winners)} | {first['steps']:,} | {len(runs)} | {estimate.mean:.1f} "
        f"| {interval(estimate)} | {min(returns):.1f} | {over:+.1f} | {stitched:.2f} | {better} | {seconds:,.0f} "
        f"| {PUBLISHED.get(first['preset'], '') if published else ''} |"
    )


def figure(records: Sequence[Record], out: Path) -> None:
    """The paths of every method's first seed, a row for each method and a column for each maze, drawn to `out`."""
    from odaf.report.study_figures import paths_figure

    own = [one for one in of_table(records) if one.get("paths", {}).get("places")]
    if not own:
        return
    mazes = [maze for maze in MAZES if any(one["map"] == maze for one in own)]
    means = {
        method: statistics.fmean(map(earned, runs)) for method, runs in grouped(own, lambda one: one["method"]).items()
    }
    rows: dict[str, list[Paths | None]] = {}
    for method in sorted(means, key=lambda name: -means[name]):
        there = {one["map"]: one for one in reversed(own) if one["method"] == method}  # the first seed comes last
        rows[method] = [_paths(there[maze]) if maze in there else None for maze in mazes]
    note = f"{LOCAL} in grey; the last checkpoint of one seed, dashed where an episode does not stitch"
    paths_figure(rows, mazes, out, "Paths of every method", note)


def _paths(record: Record) -> "Paths":
    from odaf.report.study_figures import Paths

    layout, logged = _background(record["map"])
    return Paths(layout, kept_paths(record), logged, f"{earned(record):.0f}")


@functools.cache
def _background(maze: str) -> Any:
    """A maze's layout, and some logged paths."""
    from odaf.environments.stitch_data import generate
    from odaf.report.layout import maze_layout
    from odaf.report.quantities import Trajectories

    log = generate(MazeLog(maze, LOG_SEED, LOGGED_EPISODES).config(), LOG_SEED)
    paths = [log.observations[log.episode(index), :2] for index in range(log.num_episodes)]
    return maze_layout(log.environment), Trajectories(np.stack(paths))
