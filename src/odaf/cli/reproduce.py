"""`odaf reproduce STUDY`: measure a whole study with one command that can be stopped and repeated."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse


@dataclass(frozen=True)
class ReproduceOptions:
    """Measure a whole study: every run, one JSON file each, then a table and a figure drawn from those files.

    Runs that are there already are not repeated, so the command can be stopped and given again.

    pointmaze: stitching in a maze; our default, its base without the outcome term, the paper's form, cloning.
    generators: every locomotion set we can record, beside the published set of its name.
    """

    study: tyro.conf.Positional[Literal["pointmaze", "generators"]]
    """What to measure."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Directory for the results; without it, results/STUDY."""
    workers: int = 1
    """Runs at the same time, each in its own process."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ReproduceOptions, arguments, "reproduce")

    out = options.out or Path("results") / options.study
    with repeatable():
        if options.study == "pointmaze":
            from odaf.experiments import pointmaze_study

            pointmaze_study.run(out, workers=options.workers)
        else:
            from odaf.experiments import generators_study

            generators_study.run(out, workers=options.workers)
