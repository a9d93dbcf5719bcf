"""`odaf data mix`: expert data diluted with data of a poorer controller."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.results import number


@dataclass(frozen=True)
class MixOptions:
    """Mix two data sets of one task, as studies of robustness do: expert rows diluted with random ones.

    Takes the first rows of the expert's file, then the first rows of the other's. Rows are not shuffled, and where a
    part stops inside an episode its last row counts as cut and keeps its logged successor.
    """

    expert: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERT")]
    """The better data."""
    other: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OTHER")]
    """The poorer data, such as random actions."""
    ratio: float
    """Share of the poorer rows, between 0 and 1; studies use 0.5 to 0.9."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write."""
    transitions: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Rows of the mixture; without it, as many as the poorer data have."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(MixOptions, arguments, "data mix")

    from odaf.data import Dataset
    from odaf.data.mixing import mix

    mixed = mix(Dataset.load(options.expert), Dataset.load(options.other), options.ratio, options.transitions)
    mixed.save(options.out)
    rows = [part["rows"] for part in mixed.provenance["mixture"]["parts"]]
    print(
        f"wrote {options.out}: {rows[0]:,} rows of {options.expert}, {rows[1]:,} of {options.other}, "
        f"mean return {number(mixed.summary()['mean_return'], 2)}"
    )
