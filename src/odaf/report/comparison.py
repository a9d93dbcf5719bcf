"""Whether one run is better than another, and how sure that is: numbers, without a picture."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from odaf.errors import ConfigError
from odaf.evaluation.runs import Run
from odaf.evaluation.statistics import (
    Difference,
    Estimate,
    Improvement,
    difference,
    improvement,
    interquartile_mean,
    t_interval,
)
from odaf.report.names import listed, names_of
from odaf.report.plain_tables import table
from odaf.report.records import RunRecord, data_prints, environment_name, find_runs, read_run
from odaf.report.scores import decimals, simulator_of
from odaf.training.files import finite

STATISTICS = {
    "mean return": "mean over seeds of each seed's mean at its last checkpoint; Student's t interval over the seeds",
    "interquartile mean": "mean of the middle half of all episodes of all seeds, where every seed kept its episodes",
    "difference": (
        "mean of the first less mean of the second: paired t, each seed less its partner, where both runs have the "
        "same seeds, data and environment; else Welch's t on the seeds' means"
    ),
    "P(first > second)": (
        "share of pairs of a seed of each run in which the first has the higher mean, ties half; its interval "
        "resamples the seeds of each run (percentile bootstrap, 9,999 resamples) and knows no seeds but these"
    ),
    "seeds to decide": (
        "the least number of seeds a side whose interval of the difference would exclude zero, if means and standard "
        "deviations stayed as they are"
    ),
}
"""What each number of a comparison is."""

LONGEST_IN_PAIRS = 24
"""Characters of a name; where one is longer, the printed pairs name runs by number."""


@dataclass(frozen=True)
class ComparedRun:
    """One run of a comparison.

    Attributes:
        name: unique within the comparison.
        directory: where the run lies.
        seeds: those that have a score, ascending.
        seed_means: mean return of each at its last evaluation.
        estimate: of the mean over seeds.
        interquartile_mean: of all episodes; None where a seed did not keep them.
        episodes: of each seed.
        steps: updates of each seed before its evaluation.
    """

    name: str
    directory: str
    seeds: tuple[int, ...]
    seed_means: tuple[float, ...]
    estimate: Estimate
    interquartile_mean: float | None
    episodes: tuple[int, ...]
    steps: tuple[int, ...]


@dataclass(frozen=True)
class ComparedPair:
    """Two runs, by name, and how the first stands to the second."""

    first: str
    second: str
    difference: Difference
    improvement: Improvement


@dataclass(frozen=True)
class Comparison:
    """Runs beside each other; prints as a table.

    Attributes:
        runs: in the order in which they were given.
        pairs: every two of them, or each against one.
        notes: in what the runs differ that makes their scores no like for like, and what was left out.
    """

    runs: tuple[ComparedRun, ...]
    pairs: tuple[ComparedPair, ...]
    notes: tuple[str, ...]

    def pair(self, first: str, second: str) -> ComparedPair:
        """The pair of two names.

        Raises:
            ConfigError: they were not compared; the message lists those that were.
        """
        for pair in self.pairs:
            if (pair.first, pair.second) == (first, second):
                return pair
        known = "; ".join(f"{pair.first} against {pair.second}" for pair in self.pairs) or "none"
        raise ConfigError(f"comparison: no pair {first!r}, {second!r}; there are: {known}")

    def to_dict(self) -> dict[str, Any]:
        """JSON types: every number, None for one that is not known, and what each of them is."""
        pairs = [asdict(pair) for pair in self.pairs]
        for pair, entry in zip(self.pairs, pairs, strict=True):
            entry["difference"]["decided"] = pair.difference.decided
        runs = [asdict(run) for run in self.runs]
        return finite({"runs": runs, "pairs": pairs, "notes": self.notes, "statistics": STATISTICS})

    def __str__(self) -> str:
        places = decimals([mean for run in self.runs for mean in run.seed_means])
        parts = [f"note: {note}" for note in self.notes]
        long = any(len(run.name) > LONGEST_IN_PAIRS for run in self.runs)
        numbers = {run.name: f"[{number}]" for number, run in enumerate(self.runs, start=1)} if long else {}
        parts.append(_run_table(self.runs, places, numbers))
        if self.pairs:
            parts.append(_pair_table(self.pairs, places, numbers))
        shown = list(STATISTICS)[: 5 if self.pairs else 2]
        parts.append("\n".join(f"{name}: {STATISTICS[name]}" for name in shown))
        return "\n\n".join(parts)


def compare(
    runs: Sequence[str | PathLike[str] | Run],
    *,
    against: str | PathLike[str] | Run | None = None,
    names: Sequence[str] | None = None,
    data_free: bool = False,
    confidence: float = 0.95,
) -> Comparison:
    """Means of runs with intervals over seeds, their differences, and how many seeds would decide.

    Scores are those of the last checkpoint, as each run's own evaluation left them. A difference is taken seed by seed
    where two runs have the same seeds, the same data and the same environment, and between independent samples
    elsewhere. Runs without a score are left out, and a note says why. Where runs differ in data, environment, episodes
    or updates, the comparison says so in its notes.

    Args:
        runs: runs, their directories, or folders that hold some.
        against: the run that each other one is compared with; None compares every two.
        names: what to call the runs, one name each, that of `against` last where it is none of `runs`; None names them
            by what differs between them.
        data_free: take seeds for partners though the prints of the data differ or are not known, as where one log was
            read in two ways.
        confidence: of all intervals.

    Raises:
        ConfigError: a path is no run, no run has a score or that of `against` has none, or `names` do not fit.
        CheckpointError: a file of a run is damaged.
    """
    found = find_runs([_directory(run) for run in runs])
    reference = None
    if against is not None:
        (chosen, *others) = find_runs([_directory(against)])
        if others:
            raise ConfigError(f"against: {_directory(against)} holds {len(others) + 1} runs; name one of them")
        places = [run.resolve() for run in found]
        if chosen.resolve() not in places:
            found, places = [*found, chosen], [*places, chosen.resolve()]
        reference = places.index(chosen.resolve())
    every_record = [read_run(directory) for directory in found]
    called = names_of(every_record, names)
    scored = [place for place, record in enumerate(every_record) if record.evaluated]
    if not scored or (reference is not None and reference not in scored):
        raise ConfigError(_without_score(every_record[reference or 0]))
    records = [every_record[place] for place in scored]
    compared = [_compared(every_record[place], called[place], confidence) for place in scored]
    every = range(len(records))
    other = None if reference is None else scored.index(reference)
    wanted = itertools.combinations(every, 2) if other is None else ((i, other) for i in every if i != other)
    pairs = [_pair([records[i] for i in two], [compared[i] for i in two], data_free, confidence) for two in wanted]
    left_out = [
        f"{name} is left out: {_without_score(record)}"
        for name, record in zip(called, every_record, strict=True)
        if not record.evaluated
    ]
    return Comparison(tuple(compared), tuple(pairs), (*_notes(records, compared), *left_out))


def _directory(run: str | PathLike[str] | Run) -> Path:
    return run.directory if isinstance(run, Run) else Path(run)


def _without_score(record: RunRecord) -> str:
    """Why a run has no score, and what to do."""
    broken = ", ".join(str(seed.seed) for seed in record.seeds if seed.broken)
    if broken:
        return (
            f"{record.directory}: has no score, for each episode of the last evaluation of seeds {broken} "
            "broke off on a number that is not finite; `odaf evaluate` says on which"
        )
    return (
        f"{record.directory}: has no score, for no seed was evaluated; train with evaluation, or go on with "
        "`odaf resume`"
    )


def _compared(record: RunRecord, name: str, confidence: float) -> ComparedRun:
    evaluations = [seed.evaluation for seed in record.evaluated if seed.evaluation is not None]
    returns = [found.returns for found in evaluations if found.returns is not None and found.returns.size]
    return ComparedRun(
        name=name,
        directory=str(record.directory),
        seeds=tuple(seed.seed for seed in record.evaluated),
        seed_means=tuple(found.mean for found in evaluations),
        estimate=t_interval([found.mean for found in evaluations], confidence),
        interquartile_mean=interquartile_mean(np.concatenate(returns)) if len(returns) == len(evaluations) else None,
        episodes=tuple(found.episodes for found in evaluations),
        steps=tuple(found.step for found in evaluations),
    )


def _pair(
    records: Sequence[RunRecord], runs: Sequence[ComparedRun], data_free: bool, confidence: float
) -> ComparedPair:
    first, second = runs
    paired = first.seeds == second.seeds and (data_free or _same_data(records)) and _same_place(records)
    means = list(first.seed_means), list(second.seed_means)
    return ComparedPair(
        first.name,
        second.name,
        difference(*means, paired=paired, confidence=confidence),
        improvement(*means, confidence),
    )


def _same_data(records: Sequence[RunRecord]) -> bool:
    one, other = data_prints(records)
    return one is not None and one == other


def _same_place(records: Sequence[RunRecord]) -> bool:
    one, other = (record.evaluation_environment for record in records)
    return one == other


def _notes(records: Sequence[RunRecord], runs: Sequence[ComparedRun]) -> list[str]:
    """What makes the runs' scores no like for like, and which seeds and episodes count in none."""
    prints = [str(print_)[:12] if print_ else "not known" for print_ in data_prints(records)]
    places = [_place(record) for record in records]
    found = [
        _differing("these runs saw different data", prints, runs, lambda value: value),
        _differing("these runs were played in different environments", places, runs, lambda value: value[0]),
        _differing("these runs were played by different simulators", [*map(simulator_of, records)], runs, _or_unknown),
        _differing(
            "these runs had different numbers of updates",
            [_range(run.steps) for run in runs],
            runs,
            lambda value: value,
        ),
        _differing(
            "these runs have different numbers of episodes a seed",
            [_range(run.episodes) for run in runs],
            runs,
            lambda value: value,
        ),
    ]
    unknown = [run.name for run, print_ in zip(runs, data_prints(records), strict=True) if print_ is None]
    if unknown and len(unknown) == len(runs) > 1:
        found.append(f"the data that {listed(unknown)} saw are not known, so seeds are not taken for partners")
    for record, run in zip(records, runs, strict=True):
        for what, seeds in (
            ("each episode of their last evaluation broke off", [seed.seed for seed in record.seeds if seed.broken]),
            ("they were not evaluated", [s.seed for s in record.seeds if not s.broken and s.seed not in run.seeds]),
        ):
            if seeds:
                found.append(f"{run.name}: seeds {', '.join(map(str, seeds))} are left out, for {what}")
        lost = sum(
            seed.evaluation.episodes - seed.evaluation.returns.size
            for seed in record.evaluated
            if seed.evaluation is not None and seed.evaluation.returns is not None
        )
        if lost > 0:
            found.append(f"{run.name}: {lost} of {sum(run.episodes)} episodes broke off and count in no mean")
    return [note for note in found if note]


def _differing(what: str, values: Sequence[Any], runs: Sequence[ComparedRun], said: Callable[[Any], str]) -> str:
    """A note that names which runs have which value; empty where all have one."""
    different = list(dict.fromkeys(values))
    if len(different) < 2:
        return ""
    groups = [[run.name for run, own in zip(runs, values, strict=True) if own == value] for value in different]
    return f"{what}: " + "; ".join(f"{said(v)} ({listed(group)})" for v, group in zip(different, groups, strict=True))


def _place(record: RunRecord) -> tuple[str, str]:
    environment = record.evaluation_environment
    return ("not known", "") if environment is None else (environment_name(environment), repr(_sorted(environment)))


def _sorted(value: Any) -> Any:
    return sorted((key, _sorted(entry)) for key, entry in value.items()) if isinstance(value, Mapping) else value


def _or_unknown(value: str) -> str:
    return value or "not known"


def _range(values: Sequence[int]) -> str:
    return f"{min(values):,}" if len(set(values)) == 1 else f"{min(values):,} to {max(values):,}"


def _run_table(runs: Sequence[ComparedRun], places: int, numbers: Mapping[str, str]) -> str:
    middle = any(run.interquartile_mean is not None for run in runs)
    header = ["run", "mean return", _interval_heading(runs[0].estimate.confidence)]
    header += [*(["interquartile mean"] if middle else []), "seeds", "episodes", "updates"]
    rows = []
    for run in runs:
        estimate = run.estimate
        row = [
            f"{numbers.get(run.name, '')} {run.name}".strip(),
            _number(estimate.mean, places),
            _interval(estimate.low, estimate.high, places, "one seed"),
        ]
        row += [_number(run.interquartile_mean, places)] if middle else []
        rows.append([*row, str(len(run.seeds)), f"{sum(run.episodes):,}", _range(run.steps)])
    return table(header, rows)


def _pair_table(pairs: Sequence[ComparedPair], places: int, numbers: Mapping[str, str]) -> str:
    interval = _interval_heading(pairs[0].difference.confidence)
    header = ["first against second", "difference", interval, "statistic", "P(first > second)", interval]
    rows = []
    for pair in pairs:
        found, better = pair.difference, pair.improvement
        enough = "cannot be said" if found.enough is None else f"{found.enough:,}"
        rows.append(
            [
                f"{numbers.get(pair.first, pair.first)} against {numbers.get(pair.second, pair.second)}",
                f"{found.mean:+,.{places}f}",
                _interval(found.low, found.high, places, "one seed", "+"),
                found.statistic,
                f"{better.probability:.2f}",
                _interval(better.low, better.high, 2, "one seed"),
                f"{enough}{', decided' if found.decided else ''}",
            ]
        )
    return table([*header, "seeds to decide"], rows)


def _interval_heading(confidence: float) -> str:
    return f"{100 * confidence:g} % interval"


def _interval(low: float, high: float, places: int, without: str, sign: str = "") -> str:
    return without if math.isnan(low) else f"{low:{sign},.{places}f} to {high:{sign},.{places}f}"


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:,.{places}f}"
