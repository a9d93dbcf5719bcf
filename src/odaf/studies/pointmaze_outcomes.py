"""Where does looking at outcomes pay? Our default beside its base and three rivals, on parts of logs, narrow and broad.

A narrow log is driven by one scripted controller, a broad one by nine in turn. Each policy is played as it is, and
after it was shoved by random forces in the middle of its drive.
"""

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies.job import Phase, Record
from odaf.studies.logs import LOCAL
from odaf.studies.of_policy import OfPolicy, phase_of
from odaf.studies.pointmaze_methods import BASE, EPISODES, LOG_SEED, MAZES, OURS, Winners, maze_task, training
from odaf.studies.pointmaze_search import earned
from odaf.studies.tables import grouped, interval

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run
    from odaf.training.progress import ProgressReport

METHODS = (BASE, OURS, "scas", "spot", "osr-10")
PERCENTS = (100, 30, 10)
FIRST_SEEDS, MORE_SEEDS = (0, 1), (2, 3)
SHOVES = {"shove": 20, "hard shove": 40}
"""Steps in which the forces are drawn from a normal distribution of spread 1. A point at rest in an open field is then
0.1 and 0.3 cells away, as a mean, at 0.8 and 1.2 cells a second."""
AT = 20  # counted step of a shove: on the way to the joint of every maze


@dataclass(frozen=True)
class Shoving(OfPolicy):
    """What a policy earns, and whether it comes back to logged ground, when it is shoved on its way.

    Attributes:
        at: counted step of the shove.
        shoves: steps of each, by name.
        episodes: of each.
    """

    at: int = AT
    shoves: tuple[tuple[str, int], ...] = tuple(SHOVES.items())
    episodes: int = EPISODES

    measure_name = "shoved"

    def settings(self) -> dict[str, Any]:
        return {"at": self.at, "shoves": dict(self.shoves), "episodes": self.episodes}

    def guess(self) -> float:
        return 20.0

    def said(self, record: Record) -> str:
        if record["found"] is None:
            return "the policy diverged"
        return ", ".join(f"{name} {found['mean_return']:.1f}" for name, found in record["found"].items())

    def measure(self, run: "Run", place: Path, progress: "ProgressReport") -> Mapping[str, Any]:
        from odaf.environments.knocks import Knock
        from odaf.runs.evaluate_knocks import knock_scores

        progress.start("shoves", len(self.shoves), unit="disturbances")
        found = {}
        for number, (name, steps) in enumerate(self.shoves):
            knock, data = Knock(steps, self.at, "gaussian"), self.log.present(place)
            scores = knock_scores(run.directory, knock, data=data, episodes=self.episodes)
            score, recovery = scores.scores.by_seed[0], scores.recovery
            recovered = None if recovery is None else recovery.recovered_rate
            found[name] = {"mean_return": score.mean_return, **score.rates, "recovered": recovered}
            progress.advance(number + 1)
        progress.close()
        return found


def phases(winners: Winners, before: Sequence[Phase]) -> list[Phase]:
    """The stitching maze first, whole logs before parts; what the table's phases train is not trained again."""

    def works(mazes: Sequence[str], seeds: Sequence[int]) -> list[OfPolicy]:
        return [
            Shoving(training(preset, winners.get(preset, ()), maze_task(maze, LOG_SEED, broad, percent), seed))
            for seed in seeds
            for maze in mazes
            for percent in PERCENTS
            for broad in (False, True)
            for preset in METHODS
        ]

    found = list(before)
    for title, mazes, seeds in (
        ("where outcomes pay: the stitching maze, two seeds", MAZES[:1], FIRST_SEEDS),
        ("where outcomes pay: three other mazes, two seeds", MAZES[1:], FIRST_SEEDS),
        ("where outcomes pay: four mazes, two more seeds (lanes)", MAZES, MORE_SEEDS),
    ):
        found.append(phase_of(title, works(mazes, seeds), found))
    return found[len(before) :]


def cells(winners: Winners, records: Sequence[Record]) -> list[dict[str, Any]]:
    """For each maze, share and breadth of the log what the methods earn by seed, as they are and shoved."""
    own = [one for one in records if one.get("preset") in METHODS and one.get("log_seed") == LOG_SEED]
    taken = {preset: dict(winners.get(preset, ())) for preset in METHODS}
    whole = {_place(one): one for one in own if "measure" not in one and one["changes"] == taken[one["preset"]]}
    shoved = {_place(one): one["found"] for one in own if one.get("measure") == "shoved"}
    found = []
    for (maze, percent, broad), group in grouped(list(whole.values()), lambda one: _place(one)[:3]).items():
        methods: dict[str, Any] = {}
        for record in group:
            entry = methods.setdefault(record["preset"], {"returns": {}, "stitched": {}, "shoved": {}})
            seed = str(record["seed"])
            entry["returns"][seed] = earned(record)
            entry["stitched"][seed] = 0.0 if record["final"] is None else record["final"]["stitched_rate"]
            for name, found_there in (shoved.get(_place(record)) or {}).items():
                entry["shoved"].setdefault(name, {})[seed] = found_there["mean_return"]
        best = group[0]["data"]["best_return"]
        found.append(
            {"maze": MAZES[maze], "percent": -percent, "broad": broad, "best_logged": best, "methods": methods}
        )
    return found


def _place(record: Record) -> tuple[int, int, bool, str, int]:
    return MAZES.index(record["map"]), -record["percent"], record["broad"], record["method"], record["seed"]


def gains(cell: Mapping[str, Any], shove: str | None = None) -> list[float]:
    """What our default earns more than its base, for each seed that both have.

    Args:
        cell: one of `cells`.
        shove: after which of `SHOVES`; None as they are.
    """
    both = [cell["methods"].get(method, {"returns": {}, "shoved": {}}) for method in (OURS, BASE)]
    ours, base = (each["returns"] if shove is None else each["shoved"].get(shove, {}) for each in both)
    return [ours[seed] - base[seed] for seed in sorted(ours.keys() & base.keys())]


LOOKS: dict[str, str | None] = {"as it is": None, **{name: name for name in SHOVES}}
LOGS = tuple((percent, broad) for percent in PERCENTS for broad in (False, True))


def by_log(found: Sequence[Mapping[str, Any]], shove: str | None) -> dict[tuple[int, bool], list[float]]:
    """The gains on each share and breadth of the log, over all mazes and seeds."""
    return {
        log: [gain for cell in found if (cell["percent"], cell["broad"]) == log for gain in gains(cell, shove)]
        for log in LOGS
    }


def summary(winners: Winners, records: Sequence[Record]) -> str:
    """JSON: {"cells": what `cells` finds, and the gains over the base; "all_mazes": the gains by share and breadth}."""
    found = cells(winners, records)
    for cell in found:
        cell["gain"] = {name: _figures(gains(cell, shove)) for name, shove in LOOKS.items()}
    together = {name: by_log(found, shove) for name, shove in LOOKS.items()}
    logs = [
        {"percent": log[0], "broad": log[1], "gain": {name: _figures(each[log]) for name, each in together.items()}}
        for log in LOGS
    ]
    return json.dumps({"cells": found, "all_mazes": logs}, indent=1) + "\n"


def _figures(values: list[float]) -> dict[str, Any] | None:
    from odaf.evaluation.statistics import t_interval

    if not values:
        return None
    found = t_interval(values)
    return {"mean": found.mean, "interval": [found.low, found.high] if found.count > 1 else None, "pairs": found.count}


def table(winners: Winners, records: Sequence[Record]) -> str:
    """Markdown: what came out, then a row for every log, with the gain of our default over its base."""
    found = cells(winners, records)
    lines = [
        f"Returns on {LOCAL} of seed {LOG_SEED}, last checkpoint, {EPISODES} episodes a seed, means over seeds.",
        "One driver is the scripted controller of the mazes, nine take turns in a broad log. A gain is what the",
        f"default (`{OURS}`) earns more than its base (`{BASE}`), seed by seed, with its 95 % Student interval. After",
        f"a shove: forces random for {SHOVES['shove']} steps, {SHOVES['hard shove']} in a hard one, past step {AT}.",
        "Made by `odaf reproduce pointmaze` from the records in this folder.",
        "",
    ]
    if not any(map(gains, found)):
        return "\n".join([*lines, "Not measured yet."]) + "\n"
    lines += [*_answer(found), "", "| log, all mazes | drivers | pairs | gain | after a shove | after a hard shove |"]
    lines.append(f"|{'---|' * 6}")
    together = [by_log(found, shove) for shove in LOOKS.values()]
    for percent, broad in LOGS:
        values = [each[percent, broad] for each in together]
        shown = " | ".join(map(_shown, values))
        lines.append(f"| {percent} % | {_drivers(broad)} | {len(values[0])} | {shown} |")
    lines += [
        "",
        f"| maze | log | drivers | seeds | best logged | {' | '.join(METHODS)} | gain | after a shove "
        "| after a hard shove |",
        f"|{'---|' * (8 + len(METHODS))}",
    ]
    for cell in found:
        means = [cell["methods"].get(preset, {"returns": {}})["returns"].values() for preset in METHODS]
        cells_of_row = [f"{statistics.fmean(each):.1f}" if each else "" for each in means]
        cells_of_row += [_shown(gains(cell, shove)) for shove in LOOKS.values()]
        lines.append(
            f"| {cell['maze']} | {cell['percent']} % | {_drivers(cell['broad'])} | {len(gains(cell))} "
            f"| {cell['best_logged']:.1f} | {' | '.join(cells_of_row)} |"
        )
    return "\n".join(lines) + "\n"


def _answer(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Which logs decide for the default, and which for its base, by their intervals."""
    from odaf.evaluation.statistics import t_interval

    sides: dict[str, list[str]] = {"more": [], "less": [], "either": []}
    for cell in found:
        if values := gains(cell):
            estimate = t_interval(values)  # of one seed it is NaN, on neither side
            side = "more" if estimate.low > 0.0 else "less" if estimate.high < 0.0 else "either"
            sides[side].append(f"{cell['maze']} {cell['percent']} % {_drivers(cell['broad'])}")
    total = sum(map(len, sides.values()))
    more, less = (", ".join(sides[side]) or "none" for side in ("more", "less"))
    return [
        f"Of {total} logs on which both are measured, the interval of the gain lies above zero on {len(sides['more'])}",
        f"({more}), below on {len(sides['less'])} ({less}); {len(sides['either'])} do not decide at these seeds.",
    ]


def _drivers(broad: bool) -> str:
    return "nine" if broad else "one"


def _shown(values: list[float]) -> str:
    from odaf.evaluation.statistics import t_interval

    return f"{t_interval(values).mean:+.1f} {interval(t_interval(values), '+')}" if values else ""
