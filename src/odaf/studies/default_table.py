"""Tables and the figure of the default study: the choice among candidates, the verdict, what carries the default."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from odaf.studies.default_methods import (
    ABLATION_SEEDS,
    CANDIDATES,
    DEFAULT,
    EVALUATION,
    RIVALS,
    TUNING_EVALUATION,
    TUNING_SEEDS,
    VERDICT_LOG_SEED,
    ablation_tasks,
    ablations,
    name_of,
)
from odaf.studies.default_scores import (
    by_log,
    choice,
    figures,
    judged,
    last_score,
    log_score,
    ranking,
    second_half,
    tuned,
    verdict_methods,
)
from odaf.studies.job import Record
from odaf.studies.logs import LOCAL, origin_of
from odaf.studies.tables import interval

HEAD: tuple[str, ...] = (
    "| method | updates | seeds | last | 95 % interval | worst seed | second half | steadiness | minutes |",
    "|---|---|---|---|---|---|---|---|---|",
)


def _words(part: str, episodes: int) -> list[str]:
    return [
        f"{part} {LOCAL[0].upper()}{LOCAL[1:]}.",
        "Scores of robots are normalised: 0 for a random policy, 100 for an expert; in mazes 100 is what the scripted",
        f"driver earns who is sent straight to the goal. {episodes} episodes an evaluation, deterministic policy;",
        "`last` is the last checkpoint, `second half` the mean of the evaluations after half of the updates,",
        "`steadiness` the standard deviation of these, as a mean over seeds. Intervals are 95 % Student intervals over",
        "seeds.",
        "`minutes` are those of training, one run on a core of a machine that had other work.",
        "Made by `odaf reproduce default` from the records in this folder.",
    ]


def _rows(methods: dict[str, list[Record]]) -> list[str]:
    from odaf.evaluation.statistics import t_interval

    lines = list(HEAD)
    for name, runs in methods.items():
        found, estimate = figures(runs), t_interval([last_score(run) for run in runs])
        halves = [score for run in runs for score in second_half(run)]
        lost = sum(run["final"] is None for run in runs)
        spread = "" if found["steadiness"] is None else f"{found['steadiness']:.1f}"
        lines.append(
            f"| {name}{f', {lost} diverged' if lost else ''} | {max(run['steps'] for run in runs):,} | {len(runs)} "
            f"| {found['mean']:.1f} | {interval(estimate)} | {found['worst_seed']:.1f} "
            f"| {f'{statistics.fmean(halves):.1f}' if halves else ''} | {spread} | {found['seconds'] / 60:.1f} |"
        )
    return lines


def _of_log(log: str, methods: dict[str, list[Record]]) -> list[str]:
    runs = [run for own in methods.values() for run in own]
    logs = {run["task"]: run for run in runs}  # of each seed of the log one record
    means = " and ".join(f"{log_score(run):.1f}" for run in logs.values())
    data = runs[0]["data"]
    seeds = ", ".join(str(seed) for seed in sorted({run["log_seed"] for run in runs}))
    of = f"{origin_of(data)}, {data['transitions']:,} rows, log seed {seeds}"
    return ["", f"**{log}** ({of}): the log's mean is {means}.", "", *_rows(methods)]


def tuning(records: Sequence[Record]) -> str:
    """Markdown: the ranking of the candidates, then each tuning log."""
    own, ranked, chosen = tuned(records), ranking(records), choice(records)
    lines = _words("Candidates for the default on the tuning logs.", TUNING_EVALUATION.episodes)
    lines += [
        "",
        "Ranked by the mean over the four logs of `second half` less `steadiness`, run by run; a candidate stands here",
        f"once all its records are there ({len(ranked)} of {len(CANDIDATES)} are).",
        "" if chosen is None else f"The choice is **{chosen}**.",
        "",
        "| candidate | value |",
        "|---|---|",
        *(f"| {name} | {value:.1f} |" for name, value in ranked.items()),
    ]
    for log, methods in by_log(own).items():
        lines += _of_log(log, methods)
    return "\n".join(lines) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: for each verdict log the default and its rivals, best first, beneath what the log itself earns."""
    lines = _words(f"The default ({name_of(DEFAULT)}) and its rivals on the verdict logs.", EVALUATION.episodes)
    found = by_log(judged(records), verdict_methods())
    lines += ["", *_in_short(found)]
    for log, methods in found.items():
        lines += _of_log(log, methods)
    return "\n".join(lines) + "\n"


def _in_short(found: dict[str, dict[str, list[Record]]]) -> list[str]:
    """Means over the logs that all methods have, and on how many the default is level with the best rival."""
    names = verdict_methods()
    whole = [methods for methods in found.values() if set(names) <= methods.keys()]
    lines = [
        f"{len(whole)} of {len(found)} logs have all methods. Means over these of `last`, and of `steadiness`:",
        "",
        "| method | last | steadiness |",
        "|---|---|---|",
    ]
    if not whole:
        return lines[:1]
    by_name = {name: [figures(methods[name]) for methods in whole] for name in names}
    for name, own in sorted(by_name.items(), key=lambda item: -statistics.fmean(one["mean"] for one in item[1])):
        spreads = [one["steadiness"] for one in own if one["steadiness"] is not None]
        spread = f"{statistics.fmean(spreads):.1f}" if spreads else ""
        lines.append(f"| {name} | {statistics.fmean(one['mean'] for one in own):.1f} | {spread} |")
    return lines


def ablation(records: Sequence[Record]) -> str:
    """Markdown: the default and, without each of its parts, its score, and the paired difference over seeds."""
    from odaf.evaluation.statistics import paired_difference

    name = name_of(DEFAULT)
    lines = _words(f"The default ({name}) without each of its parts.", EVALUATION.episodes)
    lines += [f"`costs` is the default's `last` less the row's, seed by seed; seeds {ABLATION_SEEDS[0]} to"]
    lines += [f"{ABLATION_SEEDS[-1]}, logs of seed {VERDICT_LOG_SEED}."]
    logs = [task.log.known_as for task in ablation_tasks()]
    names = [name_of(method) for method in ablations()]
    for log, methods in by_log(judged(records, ABLATION_SEEDS), names).items():
        if log not in logs or name not in methods or len(methods) < 2:
            continue
        whole = {run["seed"]: last_score(run) for run in methods[name]}
        lines += ["", f"**{log}**", "", "| method | seeds | last | costs | 95 % interval |", "|---|---|---|---|---|"]
        for other, runs in methods.items():
            own = {run["seed"]: last_score(run) for run in runs}
            seeds = sorted(own.keys() & whole.keys())
            gain = ""
            if other != name and seeds:
                difference = paired_difference([whole[seed] for seed in seeds], [own[seed] for seed in seeds])
                gain = f"{difference.mean:+.1f} | {interval(difference, '+')}"
            lines.append(f"| {other} | {len(own)} | {statistics.fmean(own.values()):.1f} | {gain or ' |'} |")
    return "\n".join(lines) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel for each verdict log: a bar for every method, a dot for every seed."""
    from odaf.report.study_figures import Bar, bars_figure

    names = [name_of(method) for method in (DEFAULT, *RIVALS)]
    panels: dict[str, list[Bar]] = {}
    for log, methods in by_log(judged(records), names).items():
        for name in [name for name in names if name in methods]:
            values = [last_score(run) for run in methods[name]]
            panels.setdefault(log, []).append(Bar(name, statistics.fmean(values), values))
    if panels:
        note = f"{LOCAL}; last checkpoints, a dot each seed; tuned on logs and seeds {TUNING_SEEDS} of other names"
        bars_figure(panels, out, "The default and its rivals", note, columns=4)
