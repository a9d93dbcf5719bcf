"""`odaf resume DIR`: go on with a run exactly where it stopped."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.compilation_cache import use_compilation_cache
from odaf.cli.interrupts import resumable
from odaf.cli.options import parse
from odaf.cli.results import print_run


@dataclass(frozen=True)
class ResumeOptions:
    """Go on with a run exactly where it stopped. The result has the bits of a run that never stopped."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """What `odaf train --out` named."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Updates for each seed in all, to make the run longer; without it, the number it was begun with."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Processes that train seeds side by side; without it, as many as `odaf train` takes when it is not told."""
    on_divergence: Annotated[Literal["warn", "stop"] | None, tyro.conf.arg(metavar="{warn,stop}")] = None
    """What to do when values leave the range that the rewards allow; without it, as the run was begun."""
    compilation_cache: bool = True
    """Keep compiled programs in the user's cache folder (ODAF_CACHE_DIR names another), for a quick start next time."""
    quiet: bool = False
    """Show no progress, only the result."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ResumeOptions, arguments, "resume")

    from odaf.runs.fit import load_run, resume
    from odaf.runs.side_by_side import default_workers

    use_compilation_cache(options.compilation_cache)
    with resumable(options.directory):
        seeds = len(load_run(options.directory).seeds)
        result = resume(
            options.directory,
            options.steps,
            workers=default_workers(seeds) if options.workers is None else options.workers,
            on_divergence=options.on_divergence,
            progress=not options.quiet,
        )
    print_run(result)
