"""`odaf compare DIR...`: whether one run is better than another, and how many seeds would decide."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import COMPARISON, check_outputs
from odaf.errors import ConfigError


@dataclass(frozen=True)
class CompareOptions:
    """Print means with intervals over seeds, differences, and how many seeds would decide.

    Scores are those of the last checkpoint of each seed. Where two runs have the same seeds, data and environment, they
    are compared seed by seed (paired t), elsewhere as independent samples (Welch's t); the table says which.
    """

    directories: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="DIR [DIR ...]", help_behavior_hint="(at least one)"),
    ]
    """What `odaf train --out` named, or folders that hold such directories."""
    against: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The run that each other one is compared with; without it, every two are compared."""
    names: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """What to call the runs, a name for each in their order, that of --against last if it is none of them; without it,
    the methods and what differs between them."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write every number to."""
    data_free: bool = False
    """Compare seed by seed though the prints of the data differ, as where one log was read in two ways."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(CompareOptions, arguments, "compare")
    if not options.directories:
        raise ConfigError("name at least one run directory, as in `odaf compare runs/odaf runs/cloning`")
    check_outputs({"--json": (options.json, COMPARISON)}, [*options.directories, options.against], options.force)

    from odaf.report.comparison import compare
    from odaf.training.files import write_json

    found = compare(options.directories, against=options.against, names=options.names, data_free=options.data_free)
    print(found)
    if options.json is not None:
        write_json(options.json, found.to_dict())
