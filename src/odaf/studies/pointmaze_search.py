"""The search before the stitching table: six settings of every rival, on a log that no table is made of."""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path

from odaf.studies.job import Phase, Record, Study
from odaf.studies.ledger import Ledger
from odaf.studies.logs import LOCAL
from odaf.studies.pointmaze_methods import (
    CHEAP,
    COSTLY,
    EPISODES,
    MBRCSL,
    TRIED,
    Changes,
    Winners,
    maze_task,
    training,
)
from odaf.studies.tables import grouped
from odaf.studies.training import Training, phases_of

SEARCH_LOG_SEED = 0
SEEDS = (0,)


def plan() -> list[Phase]:
    """Cheap rivals first; a rival's settings stand together, so that a search that was cut has whole ones."""

    def runs(presets: Sequence[str]) -> list[Training]:
        task = maze_task("stitch", SEARCH_LOG_SEED)
        return [
            training(preset, changes, task, seed) for seed in SEEDS for preset in presets for changes in TRIED[preset]
        ]

    return phases_of(("cheap rivals", runs(CHEAP)), ("costly rivals", runs(COSTLY)), ("MBRCSL", runs((MBRCSL,))))


def earned(record: Record) -> float:
    """Mean return of the last checkpoint; a run that diverged earned nothing."""
    return 0.0 if record["final"] is None else float(record["final"]["mean_return"])


def winners(records: Sequence[Record]) -> dict[str, Changes]:
    """The rule: of each rival all of whose settings are recorded, the one whose last checkpoint earns most, as a mean
    over seeds; of equals the first that `TRIED` names. A rival with a setting that is not recorded has no winner."""
    found = {}
    for preset, settings in TRIED.items():
        returns = [_returns(records, preset, changes) for changes in settings]
        if all(returns):
            means = [statistics.fmean(each) for each in returns]
            found[preset] = settings[means.index(max(means))]
    return found


def held_winners(results: Path) -> Winners:
    """The winners by the ledger of this study in a folder of ledgers; none where there is no such ledger."""
    return winners(Ledger(STUDY, results / STUDY.name).held())


def _returns(records: Sequence[Record], preset: str, changes: Changes) -> list[float]:
    return [earned(one) for one in records if one["preset"] == preset and one["changes"] == dict(changes)]


def said(changes: Changes) -> str:
    """A setting in words."""
    return ", ".join(f"{field} {value}" for field, value in changes) or "the preset"


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for every setting that was tried, the winner of each rival marked."""
    chosen = winners(records)
    lines = [
        f"Mean returns in the stitching maze after the updates of the table, on {LOCAL} of seed {SEARCH_LOG_SEED};",
        f"last checkpoint, {EPISODES} episodes, training seed {', '.join(map(str, SEEDS))}. `odaf reproduce pointmaze`",
        "takes the setting that earns most, once all of a rival are there. Made by `odaf reproduce pointmaze-search`",
        "from the records in this folder.",
        "",
        "| method | setting | return | stitched | seconds | |",
        "|---|---|---|---|---|---|",
    ]
    for preset, group in grouped(records, lambda one: list(TRIED).index(one["preset"])).items():
        name = list(TRIED)[preset]
        for changes in TRIED[name]:
            runs = [one for one in group if one["changes"] == dict(changes)]
            if not runs:
                continue
            finals = [one["final"] for one in runs if one["final"] is not None]
            stitched = f"{statistics.fmean(one['stitched_rate'] for one in finals):.2f}" if finals else "diverged"
            seconds = statistics.fmean(one["seconds"]["total"] for one in runs)
            mark = "taken" if chosen.get(name) == changes else ""
            lines.append(
                f"| {name} | {said(changes)} | {statistics.fmean(map(earned, runs)):.1f} | {stitched} | {seconds:,.0f} "
                f"| {mark} |"
            )
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: the winners."""
    return json.dumps({preset: dict(changes) for preset, changes in winners(records).items()}, indent=1) + "\n"


STUDY = Study(
    "pointmaze-search",
    "six settings of every rival in the stitching maze, on a log that no table is made of",
    plan,
    {"table.md": table, "winners.json": summary},
)
