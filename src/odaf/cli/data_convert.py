"""`odaf data convert`: a data set in the layout that another program reads."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import D4RL, MINARI, check_outputs


@dataclass(frozen=True)
class ConvertOptions:
    """Write a data set in the layout of D4RL (one HDF5 file) or Minari 0.5 (a folder).

    Read back, the rows are the same. Names, units and provenance go along as a JSON text.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A file of ours, or one in any layout that says itself what its columns mean."""
    to: Literal["d4rl", "minari"]
    """The layout to write."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write; for Minari, the folder to make."""
    id: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Minari's name of the data set, such as tank/valve-v0; without it, made of the folder's name."""
    force: bool = False
    """Write over a file of another kind, or replace a Minari folder, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ConvertOptions, arguments, "data convert")
    check_outputs({"--out": (options.out, D4RL if options.to == "d4rl" else MINARI)}, [options.file], options.force)

    from odaf.data import Dataset, convert

    with share_bar(f"reading {options.file}") as progress:
        dataset = Dataset.load(options.file, progress=progress)
    with share_bar(f"writing {options.out}") as progress:
        if options.to == "d4rl":
            convert.to_d4rl(dataset, options.out, progress)
        else:
            convert.to_minari(dataset, options.out, options.id, progress, replace=options.force)
    print(f"wrote {options.out}: {len(dataset):,} transitions in the layout of {options.to}")
