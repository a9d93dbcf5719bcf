"""Assembles the page: what to say about the runs, in the order in which a reader asks."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import jinja2

import odaf
from odaf.data.writing import write_atomically
from odaf.errors import ConfigError
from odaf.report import charts, paths
from odaf.report.configuration import ABSENT, differences
from odaf.report.drawing import DARK, LIGHT, plain_number
from odaf.report.layout import maze_layout
from odaf.report.records import RunRecord, data_prints, find_runs, optional, read_run
from odaf.report.scores import Score, headline_index, labels, normalised, score
from odaf.report.svg import variables

_NOT_SETTINGS = ("format", "version")


def build(run_directories: Sequence[Path], out: Path, title: str | None = None) -> Path:
    """See `odaf.report.build`."""
    out = Path(out)
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name the HTML file to write, for example {out / 'report.html'}")
    runs = [read_run(directory) for directory in find_runs(run_directories)]
    page = render(runs, title)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, lambda file: file.write(page.encode("utf-8")))
    return out


def render(runs: Sequence[RunRecord], title: str | None = None) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    names = labels(runs)
    named = list(zip(names, runs, strict=True))
    scores = [score(run, name) for name, run in named]
    main = headline_index(runs)
    origins = [run.origin for run in runs]
    settings = [{key: value for key, value in run.config.items() if key not in _NOT_SETTINGS} for run in runs]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("odaf.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"figure": figure, "count": count, "share": share, "duration": duration}
    return environment.get_template("page.html").render(
        title=title or default_title(names),
        light=variables(LIGHT),
        dark=variables(DARK),
        version=odaf.__version__,
        runs=runs,
        names=names,
        scores=scores,
        main=main,
        any_normalised=any(entry.normalised for entry in scores),
        log_normalised=[
            normalised(runs[main].data_environment_id, value) for value in (runs[main].data_best, runs[main].data_mean)
        ],
        seeds_normalised=[
            [
                normalised(run.evaluation_environment_id, None if seed.evaluation is None else seed.evaluation.mean)
                for seed in run.seeds
            ]
            for run in runs
        ],
        origins=origins,
        verdict=verdict(runs[main], scores[main]),
        facts=data_facts(runs[main]),
        gaps=gaps(runs, names),
        mazes=paths.maze_charts(runs, names),
        no_maze=why_no_maze(runs),
        curves=charts.curves_chart(runs, names),
        returns=charts.returns_chart(runs, scores),
        decimals=decimals([value for entry in scores for value in (entry.mean, *entry.seed_means)]),
        critics=charts.critic_charts(runs, names),
        no_critic=[name for name, run in named if charts.quantity(run, name, 0, "critic/mean") is None],
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
        provenance=json.dumps(runs[main].provenance, indent=2, ensure_ascii=False),
        commands=[(name, command(run)) for name, run in named],
    )  # fmt: skip


def default_title(names: Sequence[str]) -> str:
    """The methods by name, or their number where names would fill the screen."""
    if len(names) == 1:
        return f"{names[0]}: what it learned"
    if len(names) > 4:
        return f"{len(names)} methods compared"
    return f"{', '.join(names[:-1])} and {names[-1]} compared"


def verdict(run: RunRecord, entry: Score) -> str:
    """The comparison of the main score with the log, in one sentence."""
    if entry.mean is None:
        return f"{entry.label} has not been evaluated, so there is no score to compare with the log."
    best, mean = run.data_best, run.data_mean
    if best is None or mean is None:
        return f"{entry.label} earns {plain_number(entry.mean)} on average; the run does not tell what the log earned."
    times = f"{entry.mean / best:.2f} times the best logged return" if best > 0 and entry.mean > best else ""
    if entry.mean > best:
        text = f"On average {entry.label} earns more than the best logged episode" + (f", {times}." if times else ".")
        if entry.evaluated > 1:
            above = sum(value > best for value in entry.seed_means)
            text += " Every seed is" if above == entry.evaluated else f" {above} of {entry.evaluated} seeds are"
            text += " above it."
        return text
    if entry.mean > mean:
        return f"On average {entry.label} earns more than the log's mean, and less than the best logged episode."
    return f"On average {entry.label} earns less than the log's mean."


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
    for name, run in zip(names, runs, strict=True):
        if not run.data:
            found.append(f"{name}: data.json is missing, so neither the log's returns nor its origin are known.")
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
            if seed.evaluation is None:
                found.append(f"{name}, seed {seed.seed}: no evaluation, so it has no score.")
            elif seed.evaluation.step < seed.step:
                measured = f"evaluated last after {seed.evaluation.step:,}"
                found.append(f"{name}, seed {seed.seed}: trained for {seed.step:,} updates, {measured}.")
        if run.evaluated and all(seed.episodes is None for seed in run.seeds) and maze_layout(run.environment):
            found.append(f"{name}: no evaluation episodes were kept, so its paths cannot be drawn.")
    return found


def why_no_maze(runs: Sequence[RunRecord]) -> str:
    """Why there is no picture of paths; the reason of the first run that has one."""
    environments = [run.environment for run in runs]
    if all(environment is None for environment in environments):
        return "The data name no environment, so there is no map to draw paths on."
    if not any(maze_layout(environment) for environment in environments):
        return "The environment is not a maze, so there is no map to draw paths on."
    return "No evaluation kept its episodes, so there are no paths to draw."


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


def decimals(values: Sequence[float | None]) -> int:
    """Digits after the point that show about four digits of the largest value, the same for a whole column."""
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    return 0 if largest >= 10_000 else 1 if largest >= 10 else 2 if largest >= 1 else 3


def figure(value: int | float | None, places: int | None = None) -> str:
    """A number for a table; a dash for none."""
    if value is None:
        return ABSENT
    return plain_number(value) if places is None else f"{value:,.{places}f}"


def count(value: int | float | None) -> str:
    """A whole number with separators; a dash for none."""
    return ABSENT if value is None else f"{round(value):,}"


def share(value: int | float | None) -> str:
    """A rate in percent; a dash for none."""
    return ABSENT if value is None else f"{100 * value:.0f} %"


def duration(seconds: int | float | None) -> str:
    """Seconds as a person says them."""
    if seconds is None:
        return ABSENT
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
