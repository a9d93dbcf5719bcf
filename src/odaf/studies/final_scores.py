"""Final scores of a study's trainings by task, method and seed, and methods compared seed by seed."""

import statistics
from collections.abc import Mapping, Sequence

from odaf.studies.job import Record
from odaf.studies.verdict import Part

Finals = dict[str, dict[str, dict[int, float]]]
"""By task, method and seed the normalised score of the last checkpoint; of several lengths that of the most updates."""


def finals_of(records: Sequence[Record]) -> Finals:
    """Of all records of trainings; a seed that diverged earns what a random policy does, 0."""
    found: Finals = {}
    longest: dict[tuple[str, str, int], int] = {}
    for record in records:
        if "measure" in record:
            continue
        key = record["task"], record["method"], record["seed"]
        if record["steps"] < longest.get(key, 0):
            continue
        longest[key] = record["steps"]
        final = record["final"]
        score = 0.0 if final is None else float(final["normalised_score"])
        found.setdefault(key[0], {}).setdefault(key[1], {})[key[2]] = score
    return {task: {method: dict(sorted(seeds.items())) for method, seeds in found[task].items()} for task in found}


def pairs(first: Mapping[int, float], second: Mapping[int, float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The values of both at the seeds that both have."""
    seeds = sorted(first.keys() & second.keys())
    return tuple(first[seed] for seed in seeds), tuple(second[seed] for seed in seeds)


def mean_over_tasks(finals: Finals, method: str, tasks: Sequence[str]) -> dict[int, float]:
    """For each seed that has every task, its mean over them."""
    by_task = [finals.get(task, {}).get(method, {}) for task in tasks]
    seeds = set.intersection(*(set(each) for each in by_task)) if by_task else set()
    return {seed: statistics.fmean(each[seed] for each in by_task) for seed in sorted(seeds)}


def over_tasks(finals: Finals, method: str, other: str, tasks: Sequence[str]) -> Part:
    """That a method's mean over tasks exceeds another's, seed by seed; void unless both have all tasks."""
    first, second = pairs(mean_over_tasks(finals, method, tasks), mean_over_tasks(finals, other, tasks))
    both = [task for task in tasks if {method, other} <= finals.get(task, {}).keys()]
    void = "" if len(both) == len(tasks) else f"{len(both)} of {len(tasks)} logs are measured with both"
    return Part(f"{method} over {other}, mean of {len(tasks)} logs", first, second, void=void)
