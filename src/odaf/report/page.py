"""Assembles the page: what to say about the runs, in the order in which a reader asks."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from odaf.report import charts, paths
from odaf.report.columns import count, figure, log_rows, note_of, score_columns, seed_columns, share, statistic
from odaf.report.configuration import ABSENT, differences
from odaf.report.layout import maze_layout
from odaf.report.names import listed, names_of
from odaf.report.records import LOCAL, RunRecord, data_prints, environments, find_runs, optional, read_run
from odaf.report.scores import Score, decimals, headline_index, score
from odaf.report.template import rendered, require_file, write_page

_NOT_SETTINGS = ("format", "version", "advice")


def build(
    run_directories: Sequence[Path], out: Path, title: str | None = None, names: Sequence[str] | None = None
) -> Path:
    """See `odaf.report.build`."""
    out = Path(out)
    require_file(out, "report.html")
    runs = [read_run(directory) for directory in find_runs(run_directories)]
    page = render(runs, title, names)
    return write_page(page, out)


def render(runs: Sequence[RunRecord], title: str | None = None, names: Sequence[str] | None = None) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    names = names_of(runs, names)
    named = list(zip(names, runs, strict=True))
    scores = [score(run, name) for name, run in named]
    main = headline_index(scores)
    places = decimals([value for entry in scores for value in (entry.mean, *entry.seed_means)])
    columns = score_columns(scores, places)
    of_which_log = f"the log of {names[main]}" if len(set(data_prints(runs)) - {None}) > 1 else "the log"
    settings = [{key: value for key, value in run.config.items() if key not in _NOT_SETTINGS} for run in runs]
    return rendered(
        "page.html",
        {"figure": figure, "count": count, "share": share},
        title=title or default_title(names),
        runs=runs,
        names=names,
        scores=scores,
        main=main,
        any_normalised=any(entry.normalised for entry in scores),
        columns=columns,
        notes=[note_of(entry) for entry in scores],
        log_rows=log_rows(runs[main], of_which_log, columns, places),
        seed_rows=[name for name, run in named for _ in run.seeds],
        seed_columns=seed_columns(runs, places),
        statistic=statistic(scores),
        badge=badge(runs, names),
        verdict=verdict(runs, scores, main, places),
        facts=data_facts(runs[main]),
        gaps=gaps(runs, names),
        mazes=paths.maze_charts(runs, names),
        good_key=paths.good_key(runs),
        curves=charts.curves_chart(runs, names),
        returns=charts.returns_chart(runs, scores),
        decimals=places,
        critics=charts.critic_charts(runs, names),
        uncertainty=charts.metric_chart(
            runs, names, "outcome/uncertainty", "Outcome uncertainty",
            "Disagreement of the critics at the predicted outcomes. It grows with values; compare runs at one step.",
        ),
        temperature=charts.metric_chart(
            runs, names, "temperature/value", "Temperature",
            "Weight of the entropy bonus. It settles; above 10, values are too steep for the policy.", logarithmic=True,
        ),
        warnings=[(name, seed.seed, text) for name, run in named for seed in run.seeds for text in seed.warnings],
        dynamics=charts.dynamics_checks(runs, names),
        differing=differences(settings) if len(runs) > 1 else [],
        configurations=[json.dumps(run.config, indent=2, ensure_ascii=False) for run in runs],
        machines=[machine_facts(run) for run in runs],
        files=[(name, *(str(run.data.get(field, ABSENT)) for field in ("path", "sha256"))) for name, run in named],
        provenance=json.dumps(runs[main].provenance, indent=2, ensure_ascii=False) if runs[main].provenance else "",
        commands=[(name, command(run)) for name, run in named],
    )  # fmt: skip


def badge(runs: Sequence[RunRecord], names: Sequence[str]) -> str:
    """Where the data of all scores on the page came from, in one label; empty where nothing is to be said.

    Where only some runs learned from data of our generators, the label names them.
    """
    local = [name for name, run in zip(names, runs, strict=True) if run.origin]
    return "" if not local else LOCAL if len(local) == len(runs) else f"{LOCAL}: {listed(local)}"


def default_title(names: Sequence[str]) -> str:
    """The methods by name, or their number where names would fill the screen."""
    if len(names) == 1:
        return f"{names[0]}: what it learned"
    if len(names) > 4:
        return f"{len(names)} methods compared"
    return f"{listed(names)} compared" if "," in "".join(names) else f"{', '.join(names[:-1])} and {names[-1]} compared"


def verdict(runs: Sequence[RunRecord], scores: Sequence[Score], main: int, places: int) -> str:
    """What the table says of the run with the highest mean, in a few sentences.

    Numbers are compared as the table prints them, with `places` digits after the point, so that the sentences never say
    more than a reader can see.
    """
    entry, run = scores[main], runs[main]
    if entry.mean is None:
        what = f"{entry.label} has" if len(runs) == 1 else "No run has"
        return f"{what} not been evaluated, so there is no score to compare with the log."

    def shown(value: float) -> str:
        return figure(value, places)

    others = [other for index, other in enumerate(scores) if index != main and other.mean is not None]
    equal = [other.label for other in others if shown(other.mean or 0.0) == shown(entry.mean)]
    sure = f"95 % interval {shown(entry.interval[0])} to {shown(entry.interval[1])}" if entry.interval else "one seed"
    if not others:
        told = [f"{entry.label} has a mean return of {shown(entry.mean)} ({sure})."]
    elif equal:
        told = [f"{listed([entry.label, *equal])} have the highest mean return, {shown(entry.mean)} each."]
    else:
        told = [f"{entry.label} has the highest mean return, {shown(entry.mean)} ({sure})."]
    told += [*_against_the_log(run, entry, places), *_against_the_others(runs, entry, others, places)]
    return " ".join(told)


def _against_the_log(run: RunRecord, entry: Score, places: int) -> list[str]:
    if run.data_best is None or run.data_mean is None or entry.mean is None:
        return ["The run does not tell what the log earned."]
    best, logged, mean = (float(f"{value:.{places}f}") for value in (run.data_best, run.data_mean, entry.mean))
    names = f"the best logged episode ({figure(best, places)})", f"the log's mean ({figure(logged, places)})"
    if mean > best:
        place = f"above {names[0]}"
    elif mean == best:
        place = f"at {names[0]}"
    elif mean > logged:
        place = f"above {names[1]} and below {names[0]}"
    elif mean == logged:
        place = f"at {names[1]}"
    else:
        place = f"below {names[1]}"
    told = f"That is {place}"
    if entry.interval is not None:
        low, high = (float(f"{value:.{places}f}") for value in entry.interval)
        inside = [name for value, name in zip((best, logged), names, strict=True) if low <= value <= high]
        if inside:
            told += f"; {' and '.join(inside)} {'lie' if len(inside) > 1 else 'lies'} within the interval"
    return [f"{told}."]


def _against_the_others(runs: Sequence[RunRecord], entry: Score, others: Sequence[Score], places: int) -> list[str]:
    if not others:
        return []
    if len(environments(runs)) > 1:
        return ["The runs were played in different environments, so their returns do not rank them."]
    if entry.interval is None:
        return [f"{entry.label} has one seed, so that does not decide which method is better."]
    low = float(f"{entry.interval[0]:.{places}f}")
    alone = [other.label for other in others if other.interval is None]
    near = [other.label for other in others if other.interval and float(f"{other.interval[1]:.{places}f}") >= low]
    told = []
    if near:
        told.append(f"Its interval overlaps with that of {listed(near)}: that does not decide between them.")
    if alone:
        verb = "has" if len(alone) == 1 else "have"
        told.append(f"{listed(alone)} {verb} one seed, so nothing is decided there.")
    return told or ["Its interval lies above those of all others."]


def data_facts(run: RunRecord) -> list[str]:
    """Size and source of the training data, for the line under the title."""
    summary = run.summary_of_data
    facts = []
    if optional(summary.get("transitions")) is not None:
        facts.append(f"{int(summary['transitions']):,} logged transitions")
    if optional(summary.get("episodes")) is not None:
        facts.append(f"{int(summary['episodes']):,} episodes")
    layout = maze_layout(run.environment)
    if layout is not None:
        facts.append(f"maze {layout.name}")
    elif run.environment is not None:
        facts.append(str(run.environment.get("id") or run.environment.get("name") or "unnamed environment"))
    return facts


def gaps(runs: Sequence[RunRecord], names: Sequence[str]) -> list[str]:
    """What a reader could expect here and will not find, or should not take at face value."""
    found = []
    if len(set(data_prints(runs)) - {None}) > 1:
        found.append("The runs were trained on different data, so their scores do not compare like with like.")
    if len(environments(runs)) > 1:
        found.append(f"The runs were played in different environments: {', '.join(environments(runs))}.")
    for name, run in zip(names, runs, strict=True):
        if not run.data:
            found.append(f"{name}: data.json is missing, so neither the log's returns nor its origin are known.")
        if not run.machine:
            found.append(f"{name}: environment.json is missing, so versions and machine are not known.")
        if not run.seeds:
            found.append(f"{name}: no seed has started; the directory holds no seed folder.")
        planned = run.config.get("seeds")
        if isinstance(planned, list) and run.seeds and len(run.seeds) < len(planned):
            found.append(f"{name}: {len(run.seeds)} of {len(planned)} seeds have started.")
        for seed in run.seeds:
            if seed.status != "finished":
                target = run.config.get("steps")
                of = f" of {target:,}" if isinstance(target, int) else ""
                found.append(f"{name}, seed {seed.seed}: {seed.status}, {seed.step:,}{of} updates so far.")
            if seed.broken:
                found.append(
                    f"{name}, seed {seed.seed}: every episode of its last evaluation broke off on a number that is not "
                    "finite, so it has no score."
                )
            elif seed.evaluation is None:
                found.append(f"{name}, seed {seed.seed}: no evaluation, so it has no score.")
            elif seed.evaluation.step < seed.step:
                measured = f"evaluated last after {seed.evaluation.step:,}"
                found.append(f"{name}, seed {seed.seed}: trained for {seed.step:,} updates, {measured}.")
        if run.evaluated and all(seed.episodes is None for seed in run.seeds) and maze_layout(run.environment):
            found.append(f"{name}: no evaluation episodes were kept, so its paths cannot be drawn.")
    return found


def machine_facts(run: RunRecord) -> list[tuple[str, str]]:
    """Versions and device, in the order of the file."""
    facts: list[tuple[str, str]] = []
    for key, value in run.machine.items():
        if key == "command" or value == []:
            continue
        if isinstance(value, Mapping):
            facts += [(str(name), str(entry)) for name, entry in value.items()]
        else:
            facts.append((str(key), str(value)))
    return facts


def command(run: RunRecord) -> str | None:
    """The command line that made the run, ready to paste."""
    words = run.machine.get("command")
    if not isinstance(words, list) or not words:
        return None
    program, *options = (str(word) for word in words)
    if Path(program).name in ("odaf", "odaf.exe"):
        start = ["odaf"]
    elif Path(program).parts[-2:] == ("odaf", "__main__.py"):
        start = ["python", "-m", "odaf"]
    else:
        start = ["python", program]
    return shlex.join([*start, *options])
