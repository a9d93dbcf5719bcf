"""What the default's records say: scores on one scale, steadiness, seconds, and the choice among candidates."""

import json
import statistics
from collections.abc import Sequence
from typing import Any

from odaf.studies.default_methods import (
    CANDIDATES,
    DEFAULT,
    MORE_SEEDS,
    RIVALS,
    TUNING_SEEDS,
    VERDICT_LOG_SEED,
    VERDICT_SEEDS,
    first_verdict_tasks,
    name_of,
    other_verdict_tasks,
    tuning_tasks,
)
from odaf.studies.job import Record
from odaf.studies.scoreboard import seconds_at
from odaf.studies.tables import grouped


def on_scale(record: Record, mean_return: float, normalised: float | None) -> float:
    """A score of robots as it is; in a maze the return as a percentage of what the scripted driver earns who is sent
    straight to the goal."""
    return 100.0 * mean_return / record["data"]["direct_return"] if normalised is None else normalised


def scores(record: Record) -> list[float]:
    """Of every evaluation while it trained."""
    return [on_scale(record, one["mean_return"], one.get("normalised_score")) for one in record["evaluations"]]


def last_score(record: Record) -> float:
    """Of the last checkpoint; a run that diverged earns what a random policy does, 0."""
    final = record["final"]
    return 0.0 if final is None else on_scale(record, final["mean_return"], final.get("normalised_score"))


def log_score(record: Record) -> float:
    """What the log itself earns, on the same scale."""
    data = record["data"]
    return on_scale(record, data.get("mean_return") or 0.0, data.get("normalised_score"))


def second_half(record: Record) -> list[float]:
    """Scores of the evaluations after half of the updates; of a run that diverged none."""
    if record["final"] is None:
        return []
    found = zip(record["evaluations"], scores(record), strict=True)
    return [score for point, score in found if 2 * point["step"] > record["steps"]]


def steadiness(record: Record) -> float | None:
    """Standard deviation of the scores in the second half; None for fewer than two."""
    half = second_half(record)
    return statistics.stdev(half) if len(half) > 1 else None


def settled(record: Record) -> float:
    """What candidates are ranked by: the mean of the second half's scores less their standard deviation."""
    half = second_half(record)
    return statistics.fmean(half) - (statistics.stdev(half) if len(half) > 1 else 0.0) if half else 0.0


def tuned(records: Sequence[Record]) -> list[Record]:
    """The records of the tuning logs."""
    return [one for one in records if "measure" not in one and one["log_seed"] in TUNING_SEEDS]


def judged(records: Sequence[Record], seeds: Sequence[int] = (*VERDICT_SEEDS, *MORE_SEEDS)) -> list[Record]:
    """The records of the verdict's logs, of these seeds."""
    of_logs = [one for one in records if "measure" not in one and one["log_seed"] == VERDICT_LOG_SEED]
    return [one for one in of_logs if one["seed"] in seeds]


def ranking(records: Sequence[Record]) -> dict[str, float]:
    """By candidate all of whose tuning records are there: the mean over the four logs of the mean over seeds of
    `settled`, the best first; of equals the cheaper, which `CANDIDATES` names first."""
    found: dict[str, float] = {}
    held = {(one["task"], one["method"], one["seed"]): one for one in tuned(records)}
    for candidate in CANDIDATES:
        name, logs = name_of(candidate), dict[str, list[float]]()
        wanted = [(task, seed) for seed in TUNING_SEEDS for task in tuning_tasks(seed)]
        for task, seed in wanted:
            if (record := held.get((task.name, name, seed))) is not None:
                logs.setdefault(record["log"], []).append(settled(record))
        if sum(map(len, logs.values())) == len(wanted):
            found[name] = statistics.fmean(statistics.fmean(values) for values in logs.values())
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def choice(records: Sequence[Record]) -> str | None:
    """The rule: once every candidate has all its tuning records, the first of the ranking; None before."""
    found = ranking(records)
    return next(iter(found)) if len(found) == len(CANDIDATES) else None


def figures(runs: Sequence[Record]) -> dict[str, Any]:
    """Of one method's runs on a log: mean and worst last score, mean steadiness, mean seconds of training, seeds."""
    finals = [last_score(run) for run in runs]
    spreads = [spread for run in runs if (spread := steadiness(run)) is not None]
    return {
        "mean": statistics.fmean(finals),
        "worst_seed": min(finals),
        "steadiness": statistics.fmean(spreads) if spreads else None,
        "seconds": statistics.fmean(seconds_at(run, run["updates"]) if run["updates"] else 0.0 for run in runs),
        "seeds": len(runs),
    }


def by_log(records: Sequence[Record], methods: Sequence[str] | None = None) -> dict[str, dict[str, list[Record]]]:
    """Runs by log, without its seed, and method; logs in the order of the plan, methods by their mean score."""
    order = [task.log.known_as for task in (*tuning_tasks(0), *first_verdict_tasks(), *other_verdict_tasks())]
    found: dict[str, dict[str, list[Record]]] = {}
    for log, group in sorted(grouped(records, lambda one: one["log"]).items(), key=lambda item: order.index(item[0])):
        runs = grouped(group, lambda one: one["method"])
        kept = {name: own for name, own in runs.items() if methods is None or name in methods}
        found[log] = dict(sorted(kept.items(), key=lambda item: -statistics.fmean(map(last_score, item[1]))))
    return {log: runs for log, runs in found.items() if runs}


def verdict_methods() -> list[str]:
    """The default and its rivals, by name."""
    return [name_of(method) for method in (DEFAULT, *RIVALS)]


def _json(found: dict[str, dict[str, list[Record]]]) -> str:
    table = {log: {name: figures(runs) for name, runs in methods.items()} for log, methods in found.items()}
    return json.dumps(table, indent=1) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON of the verdict: {log: {method: {"mean", "worst_seed", "steadiness", "seconds", "seeds"}}}."""
    return _json(by_log(judged(records), verdict_methods()))


def tuning_summary(records: Sequence[Record]) -> str:
    """JSON of the candidates on the tuning logs, in the same form; both seeds of a log under its name."""
    return _json(by_log(tuned(records)))
