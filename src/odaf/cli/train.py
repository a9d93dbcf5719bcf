"""`odaf train PRESET`: learn policies from a data set; every field of the preset is an option."""

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from odaf.cli.compilation_cache import use_compilation_cache
from odaf.cli.interrupts import resumable
from odaf.cli.options import parse, run_settings, settings_of, with_settings
from odaf.cli.process import option_given, prepare_process
from odaf.cli.results import print_run
from odaf.errors import ConfigError
from odaf.runs import presets

if TYPE_CHECKING:
    from odaf.data import Dataset
    from odaf.evaluation import Rollouts


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """The data, where the run goes, and where its policies are tried."""

    data: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Data set to learn from: a file of `odaf data generate`, or one in the D4RL layout."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory for everything the run leaves behind; the same command again continues the run in it."""
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
    quiet: bool = False
    """Show no progress, only the result."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    if not arguments or arguments[0].startswith("-"):
        return _without_preset(arguments)
    preset, rest = arguments[0], arguments[1:]
    prepare_process(*(option_given(rest, option) for option in ("--out", "--cores", "--device")))
    # The defaults of the options depend on the task.
    algorithm = presets.load(preset, task=option_given(rest, "--task"))
    options: Any = parse(_options(preset, algorithm), rest, f"train {preset}")
    return train(preset, with_settings(algorithm, options.settings), options.run, options.how)


def train(preset: str, algorithm: Any, options: RunOptions, how: Any) -> None:
    """Train, then print where each seed stands.

    Args:
        preset: its name.
        algorithm: the learner.
        options: data, directory and evaluation.
        how: the other fields of `RunSettings`.
    """
    from odaf.data import Dataset
    from odaf.runs.fit import fit
    from odaf.runs.side_by_side import default_workers
    from odaf.training.fit import recorded_config
    from odaf.training.run_writing import refuse_foreign
    from odaf.training.settings import RunSettings
    from odaf.training.trackers import tracker

    use_compilation_cache(options.compilation_cache)
    refuse_foreign(options.out)
    loggers = [tracker(name) for name in options.log_to]
    dataset = Dataset.load(options.data)
    settings = RunSettings(**vars(how), evaluate=_evaluation(options, dataset))
    if settings.workers is None:
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
            data_path=options.data,
            loggers=loggers,
        )
    print_run(result)


def _evaluation(options: RunOptions, dataset: "Dataset") -> "Rollouts | None":
    from odaf.evaluation import Rollouts

    if options.evaluate_every == 0:
        return None
    if options.env is None and dataset.environment is None:
        print(
            f"{options.data} names no environment and no --env was given: policies are not evaluated", file=sys.stderr
        )
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
        "`odaf train PRESET --help` lists every setting of that preset."
    )
