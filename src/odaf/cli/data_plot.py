"""`odaf data plot`: pictures of a data set on one page."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import PAGE, check_outputs


@dataclass(frozen=True)
class PlotOptions:
    """Draw what a data set holds: returns, lengths, the ground it covers, and how its actions are spread.

    Each sign that the log cannot teach what is asked has a picture too: see docs/reference/checks.md.

    One HTML file that needs no network to be read.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A file of ours, or one in any layout that says itself what its columns mean."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """HTML file to write."""
    title: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Heading of the page; without it, the file's name."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(PlotOptions, arguments, "data plot")
    check_outputs({"--out": (options.out, PAGE)}, [options.file], options.force)

    from odaf.data import Dataset
    from odaf.report import data_page

    data_page.check_extra()
    dataset = Dataset.load(options.file)
    print(f"wrote {data_page.build(dataset, options.out, options.title or options.file.name)}")
