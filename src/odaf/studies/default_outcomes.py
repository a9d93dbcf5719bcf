"""Where outcomes pay: the default, its base without the outcome term, and two rivals.

Their policies knocked and attacked, and what they make of logs of 50 to 90 % random rows.
"""

import json
import statistics
from collections.abc import Sequence
from typing import Any

from odaf.studies.attacks import BUDGETS, Attacking
from odaf.studies.default_methods import (
    DEFAULT,
    MORE_SEEDS,
    VERDICT_LOG_SEED,
    VERDICT_SEEDS,
    name_of,
    robot_task,
    training,
    without,
)
from odaf.studies.default_scores import judged, last_score
from odaf.studies.job import Record
from odaf.studies.knocks import AT, EARLY, Knocking
from odaf.studies.logs import LOCAL
from odaf.studies.of_policy import OfPolicy
from odaf.studies.robots import Method
from odaf.studies.training import Training

SHARES = (50, 60, 70, 80, 90)
CLONING: Method = ("behaviour-cloning-best", ())
RIVAL: Method = ("rebrac-return", ())


def compared(default: Method = DEFAULT) -> list[Method]:
    """The default, its base without the outcome term where it has one, the best cloning and the best simple rival."""
    bare = without("outcome.weight", 0.0, default)
    return [default, *([] if bare is None else [bare]), RIVAL, CLONING]


def mixtures(seeds: Sequence[int]) -> list[Training]:
    """Trainings on Hopper's logs of 50 to 90 % random rows."""
    tasks = [robot_task("hopper", f"mixture-{share}", VERDICT_LOG_SEED) for share in SHARES]
    return [training(method, task, seed) for seed in seeds for task in tasks for method in compared()]


def works(seeds: Sequence[int]) -> list[OfPolicy]:
    """Policies of the mostly random log, knocked in the middle of an episode, and of the medium log, early in it; then
    both attacked, at random and where there are critics by what these fear most."""
    found: list[OfPolicy] = []
    for seed in seeds:
        for kind, at in (("mixture-80", AT), ("medium", EARLY)):
            for method in compared():
                own = training(method, robot_task("hopper", kind, VERDICT_LOG_SEED), seed)
                found.append(Knocking(own, at))
                found.append(Attacking(own, "random", BUDGETS))
                if method != CLONING:
                    found.append(Attacking(own, "min-q", BUDGETS))
    return found


SEEDS, LATER_SEEDS = VERDICT_SEEDS, MORE_SEEDS
Table = dict[str, dict[str, dict[str, dict[str, float]]]]


def gathered(records: Sequence[Record]) -> dict[str, Table]:
    """Normalised scores by what was done, log, method and point: {"mean", "seeds"} each.

    "knocked" has points such as `large at 100`, "attacked" such as `random 0.1`; "mixtures" has the log `hopper` and as
    points the percentages of random rows.
    """
    values: dict[tuple[str, str, str, str], list[float]] = {}
    for one in records:
        if "measure" in one and one["found"] is not None:
            for point, score in _points(one):
                values.setdefault((one["measure"], one["log"], one["method"], point), []).append(score)
    names = [name_of(method) for method in compared()]
    for one in judged(records):
        if one["method"] in names and one["log"].startswith("hopper-mixture-"):
            share = one["log"].removeprefix("hopper-mixture-")
            values.setdefault(("mixtures", "hopper", one["method"], share), []).append(last_score(one))
    table: dict[str, Table] = {"knocked": {}, "attacked": {}, "mixtures": {}}
    for (kind, log, method, point), scores in values.items():
        cell = {"mean": statistics.fmean(scores), "seeds": len(scores)}
        table[kind].setdefault(log, {}).setdefault(method, {})[point] = cell
    return table


def _points(record: Record) -> list[tuple[str, float]]:
    found = record["found"]
    if record["measure"] == "knocked":
        at = record["identity"]["settings"]["at"]
        return [(f"{name} at {at}", each["score"]) for name, each in found["levels"].items()]
    return [(f"{found['attack']} {b:g}", score) for b, score in zip(found["budgets"], found["scores"], strict=True)]


def summary(records: Sequence[Record]) -> str:
    """JSON of `gathered`."""
    return json.dumps(gathered(records), indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for every method, a column for every knock, budget or share."""
    lines = [
        f"Normalised scores on {LOCAL}, means over seeds (their number in brackets): policies of the verdict's logs of",
        "Hopper knocked (motors off for so many simulator steps, in the middle of an episode or early in it), attacked",
        "(what they see moved by up to so many standard deviations), and trained on so many per cent of random rows.",
        "Made by `odaf reproduce default` from the records in this folder.",
    ]
    found: Any = gathered(records)
    for kind, logs in found.items():
        for log, methods in logs.items():
            columns = list(dict.fromkeys(point for points in methods.values() for point in points))
            if kind == "mixtures":
                columns.sort(key=int)
            lines += [
                "",
                f"**{kind}: {log}**",
                "",
                f"| method | {' | '.join(columns)} |",
                "|---" * (len(columns) + 1) + "|",
            ]
            for method, points in methods.items():
                cells = [f"{points[c]['mean']:.1f} ({points[c]['seeds']})" if c in points else "" for c in columns]
                lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
