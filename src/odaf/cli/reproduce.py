"""`odaf reproduce STUDY`: measure a whole study with one command that can be stopped and repeated."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse
from odaf.errors import ConfigError


@dataclass(frozen=True)
class ReproduceOptions:
    """Measure a whole study: every run, one JSON file each, then a table (and figures) drawn from those files.

    Runs that are there already are not repeated, so the command can be stopped and given again.

    pointmaze: stitching in a maze; our default, its base without the outcome term, the paper's form, cloning.
    outcome: what the outcome term adds in the maze with two, four and ten critics, and on Hopper.
    locomotion: learning curves of every learner on Hopper and HalfCheetah data made on the spot.
    generators: every locomotion set we can record, beside the published set of its name.
    """

    study: tyro.conf.Positional[Literal["pointmaze", "outcome", "locomotion", "generators"]]
    """What to measure."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Directory for the results; without it, results/STUDY."""
    workers: int = 1
    """Runs at the same time, each in its own process."""
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PRESET ...")] = ()
    """locomotion: measure only these presets, with their variants; or single variants, by the table's name."""
    phase: Annotated[tuple[int, ...], tyro.conf.arg(metavar="NUMBER ...")] = ()
    """locomotion and outcome: measure only these phases of the plan, from 1; they are ordered from cheap to costly."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ReproduceOptions, arguments, "reproduce")
    for name, given, studies in (
        ("only", options.only, ("locomotion",)),
        ("phase", options.phase, ("locomotion", "outcome")),
    ):
        if given and options.study not in studies:
            raise ConfigError(f"--{name}: belongs to {' and '.join(studies)}, not to {options.study}; leave it out")

    out = options.out or Path("results") / options.study
    with repeatable():
        if options.study == "pointmaze":
            from odaf.studies import pointmaze as pointmaze_study

            pointmaze_study.run(out, workers=options.workers)
        elif options.study == "outcome":
            from odaf.studies import outcome as outcome_study

            outcome_study.run(out, workers=options.workers, phase=options.phase)
        elif options.study == "locomotion":
            from odaf.studies import locomotion as locomotion_study

            locomotion_study.run(out, workers=options.workers, only=options.only, phase=options.phase)
        else:
            from odaf.studies import generators as generators_study

            generators_study.run(out, workers=options.workers)
