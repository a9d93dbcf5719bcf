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
    """

    study: tyro.conf.Positional[Literal["pointmaze"]]
    """What to measure."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Directory for the results; without it, results/STUDY."""
    workers: int = 1
    """Runs at the same time, each in its own process."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ReproduceOptions, arguments, "reproduce")

    from odaf.experiments import pointmaze_study

    with repeatable():
        pointmaze_study.run(options.out or Path("results") / options.study, workers=options.workers)
