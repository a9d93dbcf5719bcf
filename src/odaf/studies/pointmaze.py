"""The stitching study: which methods find the path that no demonstration took, which copy, and where outcomes pay.

The logs of the tables have another seed than the one that settings were tried on. A rival has the setting that did best
in `odaf reproduce pointmaze-search`, by that study's ledger in the folder where this one's lies; its preset where there
is none. The first part of the study, on the other log, comes last: its records are there.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType

from odaf.studies import pointmaze_first, pointmaze_outcomes, pointmaze_table
from odaf.studies.job import Phase, Record, Study
from odaf.studies.pointmaze_methods import (
    CHEAP,
    COSTLY,
    MAZES,
    MBRCSL,
    OWN,
    PAPER,
    Changes,
    Winners,
    maze_task,
    training,
)
from odaf.studies.pointmaze_search import held_winners
from odaf.studies.training import Training, phases_of

FIRST_SEEDS, MORE_SEEDS = (0, 1), (2, 3)
NOTHING: Winners = MappingProxyType({})


def plan(winners: Winners = NOTHING) -> list[Phase]:
    """The stitching maze with two seeds, cheap methods first; then the other mazes, and more seeds, for lanes."""

    def settings(presets: Sequence[str]) -> list[tuple[str, Changes]]:
        return [(preset, winners.get(preset, ())) for preset in presets]

    def runs(methods: Sequence[tuple[str, Changes]], mazes: Sequence[str], seeds: Sequence[int]) -> list[Training]:
        return [
            training(preset, changes, maze_task(maze), seed)
            for seed in seeds
            for maze in mazes
            for preset, changes in methods
        ]

    cheap, costly = [*settings(CHEAP), *OWN], settings(COSTLY)
    last = [*settings((MBRCSL,)), (PAPER, ())]
    replaced = [(preset, ()) for preset, changes in winners.items() if changes]
    table = phases_of(
        ("the stitching maze, two seeds: cheap methods, our default and its base", runs(cheap, MAZES[:1], FIRST_SEEDS)),
        ("the stitching maze, two seeds: costly rivals", runs(costly, MAZES[:1], FIRST_SEEDS)),
        ("the stitching maze, two seeds: MBRCSL, ODAF as printed", runs(last, MAZES[:1], FIRST_SEEDS)),
        ("three other mazes, two seeds: cheap methods, our default and its base", runs(cheap, MAZES[1:], FIRST_SEEDS)),
        ("three other mazes, two seeds: costly rivals", runs(costly, MAZES[1:], FIRST_SEEDS)),
        ("three other mazes, two seeds: MBRCSL, ODAF as printed", runs(last, MAZES[1:], FIRST_SEEDS)),
        ("four mazes, two more seeds (lanes): all of these", runs([*cheap, *costly, *last], MAZES, MORE_SEEDS)),
        ("presets beside the searched settings, the stitching maze", runs(replaced, MAZES[:1], FIRST_SEEDS)),
    )
    outcomes = pointmaze_outcomes.phases(winners, table)
    first = [Phase(f"the first part, {phase.title}", phase.jobs) for phase in pointmaze_first.plan()]
    return [*table, *outcomes, *first]


def study(winners: Winners = NOTHING) -> Study:
    """The study once the search has these winners."""
    return Study(
        "pointmaze",
        "stitching in four mazes: every method, and where looking at outcomes pays",
        partial(plan, winners),
        {
            "table.md": partial(pointmaze_table.table, winners),
            "outcomes.md": partial(pointmaze_outcomes.table, winners),
            "outcomes.json": partial(pointmaze_outcomes.summary, winners),
            "first.md": _first,
        },
        {"figure.png": _first_figure, "paths.png": pointmaze_table.figure},
        beside=lambda results: study(held_winners(results)),
    )


def _of_first(records: Sequence[Record]) -> list[Record]:
    return [one for one in records if "map" not in one]


def _first(records: Sequence[Record]) -> str:
    return pointmaze_first.table(_of_first(records))


def _first_figure(records: Sequence[Record], out: Path) -> None:
    pointmaze_first.figure(_of_first(records), out)


STUDY = study()
