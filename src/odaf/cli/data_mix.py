"""`odaf data mix`: expert data diluted with data of a poorer controller."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import DATASET, check_outputs
from odaf.cli.results import number
from odaf.errors import ConfigError


@dataclass(frozen=True)
class MixOptions:
    """Mix two data sets of one task, as studies of robustness do: expert rows diluted with random ones.

    Takes the first rows of the expert's file, then the first rows of the other's. Rows are not shuffled, and where a
    part stops inside an episode its last row counts as cut and keeps its logged successor.

    With --per-batch all rows of both are kept, and training draws each row of a batch from the poorer data with the
    probability of the ratio. All expert rows then stay within reach: an easier task at high ratios, whose scores must
    not be compared with those of the other kind.
    """

    expert: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERT")]
    """The better data."""
    other: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OTHER")]
    """The poorer data, such as random actions."""
    ratio: float
    """Share of the poorer rows in the file, or with --per-batch in each batch; studies use 0.5 to 0.9."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write."""
    transitions: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Rows of the mixture; without it, as many as the poorer data have. Not with --per-batch."""
    per_batch: bool = False
    """Keep all rows, and mix in training, batch by batch."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(MixOptions, arguments, "data mix")

    if options.per_batch and options.transitions is not None:
        raise ConfigError("--transitions: --per-batch keeps all rows of both; leave it out")
    check_outputs({"--out": (options.out, DATASET)}, [options.expert, options.other], options.force)

    from odaf.data import Dataset
    from odaf.data.mixing import mix, mix_per_batch

    with share_bar(f"reading {options.expert}") as progress:
        expert = Dataset.load(options.expert, progress=progress)
    with share_bar(f"reading {options.other}") as progress:
        other = Dataset.load(options.other, progress=progress)
    if options.per_batch:
        mixed = mix_per_batch(expert, other, options.ratio)
    else:
        mixed = mix(expert, other, options.ratio, options.transitions)
    with share_bar(f"writing {options.out}") as progress:
        mixed.save(options.out, progress)
    rows = [part["rows"] for part in mixed.provenance["mixture"]["parts"]]
    print(
        f"wrote {options.out}: {rows[0]:,} rows of {options.expert}, {rows[1]:,} of {options.other}, "
        f"mean return {number(mixed.summary()['mean_return'], 2)}"
    )
    if options.per_batch:
        print(f"training draws a share of {options.ratio:g} of each batch from {options.other}")
