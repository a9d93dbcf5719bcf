"""`odaf train PRESET`: learn policies from data sets; every field of the preset is an option."""

import contextlib
import dataclasses
import itertools
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from odaf.cli.advised import AUTO, AUTO_HELP, advised
from odaf.cli.compilation_cache import use_compilation_cache
from odaf.cli.interrupts import repeatable, resumable
from odaf.cli.options import parse, run_settings, settings_of, with_settings
from odaf.cli.process import option_given, prepare_process, values_given
from odaf.cli.results import print_run, print_runs
from odaf.errors import ConfigError
from odaf.runs import presets

if TYPE_CHECKING:
    from odaf.data import Dataset
    from odaf.evaluation import Rollouts
    from odaf.runs.many import Plan
    from odaf.training.logging import Logger

_MOST_SEEDS = 10_000


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """The data, where the run goes, and where its policies are tried."""

    data: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE [FILE ...]")]
    """Data set to learn from: a file of `odaf data generate`, or one in the D4RL layout. Several make a run each."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory for everything the run leaves behind; the same command again continues the run in it. Several runs get
    a directory each in it, named by data set and values."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE[,VALUE ...]")] = ()
    """Settings to try several values of, as in `actor_learning_rate=1e-4,3e-4 outcome.weight=0.1,1`: a run for each
    combination."""
    halving: Annotated[Path | None, tyro.conf.arg(metavar="HOLDOUT")] = None
    """With `--set`: train all runs a while, go on with the half that `odaf select` puts highest on this log, which no
    run learns from, and so on until one is left. What was decided stands in DIR/halving.json."""
    task: Annotated[str | None, tyro.conf.arg(metavar="TASK")] = None
    """Take the preset's values for this task, as in hopper-medium; the defaults of this page are then that task's."""
    evaluate_every: int = 5_000
    """Updates between two evaluations; the last update is evaluated too. 0 never evaluates."""
    episodes: int = 50
    """Episodes in each evaluation."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Gymnasium id of the environment to evaluate in, or MODULE:ID where a module must be imported first; without it,
    the one that the data set names."""
    contact_margins: Annotated[Literal["added", "larger"] | None, tyro.conf.arg(metavar="RULE")] = None
    """How MuJoCo counts the contact margins of two parts that touch: `added`, as it does from 3.5.0 on, or `larger`, as
    before, which makes Hopper and the point mazes the older bodies; without it, as the data set says or the
    installed one does."""
    log_to: tuple[Literal["tensorboard", "wandb", "mlflow"], ...] = ()
    """Trackers that hear of the metrics, too; each is an extra, as in pip install "odaf[tensorboard]"."""
    compilation_cache: bool = True
    """Keep compiled programs in the user's cache folder (ODAF_CACHE_DIR names another), for a quick start next time."""
    deterministic: bool = True
    """On a GPU, add in a fixed order, so that a run repeats and resumes to the bit; without it, some learners are up to
    a third faster. On a processor it is always so."""
    quiet: bool = False
    """Show no progress, only the result."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    arguments = with_ranges(arguments)
    if not arguments or arguments[0].startswith("-"):
        return _without_preset(arguments)
    preset, rest = arguments[0], arguments[1:]
    command, advice = f"train {preset}", None
    places = (option_given(rest, option) for option in ("--out", "--cores", "--device"))
    prepare_process(*places, deterministic="--no-deterministic" not in rest)
    if preset == AUTO:
        if not values_given(rest, "--data") and ("-h" in rest or "--help" in rest):
            return print(AUTO_HELP)
        advice = advised(rest)
        preset = advice.preset
    # The defaults of the options depend on the task, and what is advised is a default too.
    algorithm = presets.load(preset, advice and advice.settings, task=option_given(rest, "--task"))
    options: Any = parse(_options(preset, algorithm), rest, command)
    learner = with_settings(algorithm, options.settings)
    return train(preset, learner, options.run, options.how, advice and advice.to_dict())


def train(preset: str, algorithm: Any, options: RunOptions, how: Any, advice: Mapping[str, Any] | None = None) -> None:
    """Train, then print where each seed stands.

    Args:
        preset: its name.
        algorithm: the learner.
        options: data, directory and evaluation.
        how: the other fields of `RunSettings`.
        advice: what chose the preset, for the record.
    """
    from odaf.algorithms.config import replace
    from odaf.data import Dataset
    from odaf.runs.fit import fit
    from odaf.runs.side_by_side import default_workers
    from odaf.training.fit import recorded_config
    from odaf.training.run_writing import refuse_foreign
    from odaf.training.settings import RunSettings, default_lanes
    from odaf.training.trackers import tracker

    use_compilation_cache(options.compilation_cache)
    if not options.data:
        raise ConfigError("--data: name at least one file")
    values = values_of(options.set)
    data, *others = options.data
    if options.halving is not None and (others or not any(len(each) > 1 for each in values.values())):
        raise ConfigError(
            "--halving: chooses among values of --set on one data set; name one file, and several values of a setting"
        )
    if others or any(len(each) > 1 for each in values.values()):
        return _train_many(preset, algorithm, options, how, values, advice)
    algorithm = replace(algorithm, {name: each[0] for name, each in values.items()}, "--set")
    refuse_foreign(options.out)
    loggers = [tracker(name) for name in options.log_to]
    dataset = Dataset.load(data)
    settings = RunSettings(**vars(how), evaluate=_evaluation(options, {data: dataset}))
    if settings.workers is None and (settings.lanes or default_lanes(len(settings.seeds))) == 1:
        cores = settings.cores or (recorded_config(options.out) or {}).get("cores") or 1
        settings = dataclasses.replace(settings, workers=default_workers(len(settings.seeds), cores))
    with resumable(options.out):
        result = fit(
            algorithm,
            dataset,
            directory=options.out,
            settings=settings,
            progress=not options.quiet,
            preset=preset,
            data_path=data,
            advice=advice,
            loggers=loggers,
        )
    print_run(result)


def _train_many(
    preset: str,
    algorithm: Any,
    options: RunOptions,
    how: Any,
    values: Mapping[str, Sequence[Any]],
    advice: Mapping[str, Any] | None,
) -> None:
    """Train a run for each combination of data sets and values, then print where each stands."""
    from odaf.runs.many import combinations, fit_many
    from odaf.runs.side_by_side import default_workers
    from odaf.training.run_writing import refuse_foreign
    from odaf.training.settings import RunSettings, default_lanes
    from odaf.training.trackers import tracker

    loggers = [tracker(name) for name in options.log_to]
    runs = combinations(algorithm, options.data, values, options.out, preset, advice)
    for plan in runs:
        refuse_foreign(plan.directory)
    settings = RunSettings(**vars(how), evaluate=_evaluation(options, {plan.data_path: plan.dataset for plan in runs}))
    if options.env is None:
        runs = [dataclasses.replace(plan, evaluated=plan.dataset.environment is not None) for plan in runs]
    trainings = len(runs) * len(settings.seeds)
    if settings.workers is None and (settings.lanes or default_lanes(trainings)) == 1:
        workers = default_workers(len(settings.seeds), settings.cores or 1)
        settings = dataclasses.replace(settings, workers=workers)
    with repeatable():
        if options.halving is not None:
            return _halve(runs, settings, options, loggers)
        results = fit_many(runs, settings=settings, progress=not options.quiet, loggers=loggers)
    print_runs(results, options.out)


def _halve(runs: "Sequence[Plan]", settings: Any, options: RunOptions, loggers: "Sequence[Logger]") -> None:
    """Cull the runs by estimate while they train, then print what was chosen."""
    from odaf.cli.bars import share_bar
    from odaf.cli.spelling import spelled
    from odaf.data import Dataset
    from odaf.estimation import train_halving

    assert options.halving is not None
    holdout = Dataset.load(options.halving)
    with contextlib.ExitStack() as bars:

        def estimating(what: str) -> Any:
            bars.close()
            return bars.enter_context(share_bar(what))

        def say(line: str) -> None:
            bars.close()
            print(line, file=sys.stderr)

        found = train_halving(
            runs,
            holdout,
            options.out,
            settings=settings,
            progress=not options.quiet,
            estimating=estimating,
            loggers=loggers,
            say=say,
        )
    print_runs([found.best], options.out)
    print(spelled(str(found.selection)))


def with_ranges(arguments: list[str]) -> list[str]:
    """The words of a command with `0..3` behind `--seeds` written out as `0 1 2 3`."""
    found, of_seeds = [], False
    parted = itertools.chain.from_iterable(
        word.split("=", 1) if word.startswith("--seeds=") else [word] for word in arguments
    )
    for word in parted:
        if word.startswith("--"):
            of_seeds = word == "--seeds"
        first, dots, last = word.partition("..")
        if of_seeds and dots and first.isdecimal() and last.isdecimal():
            if int(last) < int(first) or int(last) - int(first) >= _MOST_SEEDS:
                raise ConfigError(
                    f"--seeds {word}: write the smaller number first, and at most {_MOST_SEEDS} seeds, as in 0..3"
                )
            found += map(str, range(int(first), int(last) + 1))
        else:
            found.append(word)
    return found


def values_of(words: Sequence[str]) -> dict[str, list[Any]]:
    """What `--set` says: for each setting the values that it takes.

    Numbers, true, false and lists such as [64,64] are read as TOML; any other word stands for itself.
    """
    found: dict[str, list[Any]] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.replace("-", "_")
        values = [_value(value) for value in re.split(r",(?![^\[]*\])", text)]
        if not name or not equals or "" in values:
            raise ConfigError(f"--set {word!r}: write a setting and its values, as in outcome.weight=0.1,1")
        if name in found:
            raise ConfigError(f"--set {word!r}: {name} stands there twice; put all its values behind one name")
        found[name] = values
    return found


def _value(text: str) -> Any:
    text = text.strip()
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _evaluation(options: RunOptions, datasets: "Mapping[Any, Dataset]") -> "Rollouts | None":
    from odaf.evaluation import Rollouts

    if options.evaluate_every == 0:
        return None
    if options.env is None and (nameless := [str(path) for path, each in datasets.items() if each.environment is None]):
        verb = "names" if len(nameless) == 1 else "name"
        which = ", ".join(nameless)
        whose = "policies" if len(nameless) == len(datasets) else "policies of these data"
        print(f"{which} {verb} no environment and no --env was given: {whose} are not evaluated", file=sys.stderr)
        if len(nameless) == len(datasets):
            return None
    return Rollouts(
        options.env,
        episodes=options.episodes,
        every=options.evaluate_every,
        contact_margins=options.contact_margins,
    )


def _options(preset: str, algorithm: Any) -> type:
    """The dataclass of all options of one preset."""
    settings = dataclasses.make_dataclass(
        "Settings",
        settings_of(algorithm),
        frozen=True,
        namespace={"__doc__": "The learner; the defaults are the preset's values."},
    )
    return dataclasses.make_dataclass(
        "TrainOptions",
        [
            ("run", Annotated[RunOptions, tyro.conf.arg(name="")]),
            ("how", Annotated[run_settings(), tyro.conf.arg(name="")]),
            ("settings", Annotated[settings, tyro.conf.arg(name="")]),
        ],
        frozen=True,
        namespace={"__doc__": f"{presets.description(preset) or preset}."},
    )


def _without_preset(arguments: list[str]) -> None:
    """The list of presets, as help or as part of an error message."""
    known = presets.names()
    width = max(map(len, known))
    lines = "\n".join(f"  {name:<{width}}   {line}" for name, line in known.items())
    if "-h" not in arguments and "--help" not in arguments:
        raise ConfigError(f"name a preset first, as in `odaf train odaf --data FILE --out DIR`; known are\n{lines}")
    print(
        "usage: odaf train PRESET --data FILE --out DIR [options]\n\n"
        "Learn policies from a data set.\n\n"
        f"presets:\n{lines}\n\n"
        "`odaf train PRESET --help` lists every setting of that preset. `odaf train auto --data FILE --out DIR`\n"
        "looks at the log and takes the preset that it asks for: see `odaf train auto --help`."
    )
