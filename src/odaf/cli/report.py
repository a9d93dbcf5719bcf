"""`odaf report DIR...`: one page that compares runs, or its table as data."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import PAGE, TABLE_CSV, TABLE_JSON, TABLE_LATEX, check_outputs
from odaf.errors import ConfigError

# For each format, what is written and the ending of its name.
_FORMATS = {
    "html": (PAGE, ".html"),
    "csv": (TABLE_CSV, ".csv"),
    "json": (TABLE_JSON, ".json"),
    "latex": (TABLE_LATEX, ".tex"),
}


@dataclass(frozen=True)
class ReportOptions:
    """Draw one page that compares runs: trajectories, curves, scores, settings. It needs no network to be read.

    With --format csv, json or latex, write its table of scores instead, a row a run.
    """

    directories: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="DIR [DIR ...]", help_behavior_hint="(at least one)"),
    ]
    """What `odaf train --out` named, or folders that hold such directories."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write, whose name ends in .html, .csv, .json or .tex as its format does."""
    format: Literal["html", "csv", "json", "latex"] = "html"
    """A page, or its table: with every episode's return (json), or for a paper (latex, with the package booktabs)."""
    title: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Heading of the page, or first words of the caption in LaTeX; without it, the names of the methods."""
    names: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """What to call the runs, a name for each in their order; without it, the methods and what differs between them."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ReportOptions, arguments, "report")
    if not options.directories:
        raise ConfigError("name at least one run directory, as in `odaf report runs/maze --out report.html`")
    check_outputs({"--out": (options.out, _FORMATS[options.format][0])}, options.directories, options.force)
    _check_name(options.out, options.format)
    if options.title is not None and options.format in ("csv", "json"):
        raise ConfigError(f"--title: has no place in --format {options.format}; leave it out")

    from odaf import report

    out = report.build(options.directories, options.out, options.title, names=options.names, format=options.format)
    if not out.is_relative_to("/dev"):
        print(f"wrote {out}")


def _check_name(out: Path, layout: str) -> None:
    """The name of the file says what comes into it."""
    ending = _FORMATS[layout][1]
    if out.suffix.lower() == ending or out.is_dir() or out.is_relative_to("/dev"):
        return
    other = next((name for name, (_, its) in _FORMATS.items() if its == out.suffix.lower()), None)
    remedy = f", or give --format {other}" if other else ""
    raise ConfigError(
        f"--out {out}: --format {layout} writes a file whose name ends in {ending}; "
        f"name it {out.with_suffix(ending)}{remedy}"
    )
