"""`odaf data convert`: a data set in the layout that another program reads."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import D4RL, DATASET, MINARI, check_outputs


@dataclass(frozen=True)
class ConvertOptions:
    """Write a data set in the layout of D4RL (one HDF5 file) or Minari 0.5 (a folder), or as a file of ours.

    Read back, the rows are the same, unless half precision is asked for. Names, units and provenance go along.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A file of ours, or one in any layout that says itself what its columns mean."""
    to: Literal["d4rl", "minari", "odaf"]
    """The layout to write."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write; for Minari, the folder to make."""
    id: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Minari's name of the data set, such as tank/valve-v0; without it, made of the folder's name."""
    precision: Literal["single", "half"] = "single"
    """Numbers of a file of ours: half takes half the bytes, for sets that travel. It rounds observations, actions and
    rewards, to 1 in 2,048 at most, and leaves infos out. That is another data set, with prints of its own: train on it
    wherever you compare."""
    force: bool = False
    """Write over a file of another kind, or replace a Minari folder, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ConvertOptions, arguments, "data convert")
    layouts = {"d4rl": D4RL, "minari": MINARI, "odaf": DATASET}
    check_outputs({"--out": (options.out, layouts[options.to])}, [options.file], options.force)

    from odaf.data import Dataset, convert, fingerprint, half_precision, storage
    from odaf.errors import ConfigError

    if options.precision == "half" and options.to != "odaf":
        raise ConfigError(f"--precision half: the layout of {options.to} holds single precision; take --to odaf")

    with share_bar(f"reading {options.file}") as progress:
        dataset = Dataset.load(options.file, progress=progress)
    with share_bar(f"writing {options.out}") as progress:
        if options.to == "d4rl":
            convert.to_d4rl(dataset, options.out, progress)
        elif options.to == "odaf":
            half = options.precision == "half"
            dataset = half_precision.rounded(dataset) if half else dataset
            storage.write(dataset, options.out, progress, half)
        else:
            convert.to_minari(dataset, options.out, options.id, progress, replace=options.force)
    print(f"wrote {options.out}: {len(dataset):,} transitions in the layout of {options.to}")
    if options.precision == "half":
        own = fingerprint.of_file(dataset)[:12]
        print(f"its fingerprint is {own}: a data set of its own; carry this file and train on it on both machines")
