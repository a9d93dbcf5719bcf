"""`odaf report DIR...`: draw one page that compares runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import PAGE, check_outputs
from odaf.errors import ConfigError


@dataclass(frozen=True)
class ReportOptions:
    """Draw one page that compares runs: trajectories, curves, scores, settings. It needs no network to be read."""

    directories: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="DIR [DIR ...]", help_behavior_hint="(at least one)"),
    ]
    """What `odaf train --out` named, or folders that hold such directories."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """HTML file to write."""
    title: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Heading of the page; without it, the names of the methods."""
    names: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """What to call the runs, a name for each in their order; without it, the methods and what differs between them."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ReportOptions, arguments, "report")
    if not options.directories:
        raise ConfigError("name at least one run directory, as in `odaf report runs/maze --out report.html`")
    check_outputs({"--out": (options.out, PAGE)}, options.directories, options.force)

    from odaf import report

    print(f"wrote {report.build(options.directories, options.out, options.title, names=options.names)}")
