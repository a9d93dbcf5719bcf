"""`odaf resume DIR`: go on with a run exactly where it stopped."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from odaf.cli.compilation_cache import use_compilation_cache
from odaf.cli.interrupts import resumable
from odaf.cli.options import parse
from odaf.cli.process import prepare_process
from odaf.cli.results import print_run
from odaf.errors import ConfigError

if TYPE_CHECKING:
    from odaf.evaluation import Rollouts
    from odaf.training.fit import AsBegun


@dataclass(frozen=True)
class ResumeOptions:
    """Go on with a run exactly where it stopped. The result has the bits of a run that never stopped."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """What `odaf train --out` named."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Updates for each seed in all, to make the run longer; without it, the number it was begun with."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Processes that train seeds side by side, each on as many cores as the run was begun with; without it, one for
    each seed up to what the cores allow, or a single one where an accelerator is used."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Where the run's data are now; without it, where they were, seen from the run or from where it was begun."""
    evaluation: bool = True
    """Try policies as before; --no-evaluation goes on without."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Gymnasium id of another environment to evaluate in from here on."""
    evaluate_every: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Another number of updates between two evaluations."""
    episodes: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Another number of episodes in each evaluation."""
    on_divergence: Annotated[Literal["warn", "stop"] | None, tyro.conf.arg(metavar="{warn,stop}")] = None
    """What to do when values leave the range that the rewards allow; without it, as the run was begun."""
    log_to: tuple[Literal["tensorboard", "wandb", "mlflow"], ...] = ()
    """Trackers that hear of the metrics, too; each is an extra, as in pip install "odaf[tensorboard]"."""
    compilation_cache: bool = True
    """Keep compiled programs in the user's cache folder (ODAF_CACHE_DIR names another), for a quick start next time."""
    quiet: bool = False
    """Show no progress, only the result."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ResumeOptions, arguments, "resume")
    prepare_process(options.directory)

    from odaf.runs.fit import load_run, resume
    from odaf.runs.side_by_side import default_workers
    from odaf.training.trackers import tracker

    use_compilation_cache(options.compilation_cache)
    with resumable(options.directory):
        run = load_run(options.directory)
        workers = options.workers
        result = resume(
            options.directory,
            options.steps,
            workers=default_workers(len(run.seeds), run.config.get("cores") or 1) if workers is None else workers,
            dataset=options.data,
            evaluate=_evaluation(options, run.config.get("evaluate")),
            on_divergence=options.on_divergence,
            progress=not options.quiet,
            loggers=[tracker(name) for name in options.log_to],
        )
    print_run(result)


def _evaluation(options: ResumeOptions, recorded: dict[str, Any] | None) -> "Rollouts | AsBegun | None":
    from odaf.evaluation import Rollouts

    given = {"environment": options.env, "every": options.evaluate_every, "episodes": options.episodes}
    changes = {name: value for name, value in given.items() if value is not None}
    if not options.evaluation:
        if changes:
            raise ConfigError("--no-evaluation: leaves nothing for --env, --evaluate-every and --episodes to say")
        return None
    if not changes:
        return "as begun"
    return replace(Rollouts() if recorded is None else Rollouts.from_dict(recorded), **changes)
