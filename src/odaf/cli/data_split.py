"""`odaf data split`: whole episodes set aside."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import DATASET, check_outputs


@dataclass(frozen=True)
class SplitOptions:
    """Set episodes aside for judging a policy on data it was not trained on; no episode is torn."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """Data set to split."""
    train: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File for the episodes to train on."""
    holdout: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File for the episodes set aside."""
    share: float = 0.2
    """Share of the episodes to set aside."""
    seed: int = 0
    """The same seed sets the same episodes aside."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(SplitOptions, arguments, "data split")
    outputs = {"--train": (options.train, DATASET), "--holdout": (options.holdout, DATASET)}
    check_outputs(outputs, [options.file], options.force)

    from odaf.data import Dataset

    with share_bar(f"reading {options.file}") as progress:
        dataset = Dataset.load(options.file, progress=progress)
    parts = dataset.split(options.share, options.seed)
    for path, part in zip((options.train, options.holdout), parts, strict=True):
        with share_bar(f"writing {path}") as progress:
            part.save(path, progress)
        print(f"wrote {path}: {part.num_episodes:,} episodes, {len(part):,} transitions")
