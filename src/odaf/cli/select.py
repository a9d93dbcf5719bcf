"""`odaf select RUN... --data HOLDOUT`: the best run and checkpoint, from a log alone."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.estimator_options import EstimatorOptions
from odaf.cli.options import parse
from odaf.cli.outputs import SELECTION, check_outputs
from odaf.cli.spelling import spelled


@dataclass(frozen=True)
class SelectOptions:
    """Choose among runs and their checkpoints from a log alone. Needs no simulator.

    Every checkpoint is judged by one estimator of `odaf estimate`. The best is the one that is better than whoever
    wrote the log by most at the least, by the lower end of the interval; those for which the estimator refuses a
    verdict stand behind all others. A run is worth the mean over its seeds of the best checkpoint of each. `better` is
    how probable it is that a checkpoint's policy is worth more than what whoever wrote the log earned.

    The log must be one that no run learned from: set episodes aside with `odaf data split` before training.
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN [RUN ...]")]
    """What `odaf train --out` named; a folder of several runs gives them all."""
    data: Annotated[Path, tyro.conf.arg(metavar="HOLDOUT")]
    """Data set that no run learned from, as `odaf data split --holdout` writes it."""
    method: Literal["fqe", "shrunk", "model", "blend", "wis", "pdis", "dr"] = "fqe"
    """Estimator that chooses."""
    checkpoints: Literal["all", "last"] = "all"
    """Checkpoints to choose among: all that a run keeps, or the last of each seed."""
    how: Annotated[EstimatorOptions, tyro.conf.arg(name="")] = field(default_factory=EstimatorOptions)
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write every number to."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(SelectOptions, arguments, "select")
    check_outputs({"--json": (options.json, SELECTION)}, [*options.runs, options.data], options.force)

    from odaf.data import Dataset
    from odaf.estimation import select
    from odaf.training.files import write_json

    with share_bar(f"reading {options.data}") as progress:
        dataset = Dataset.load(options.data, progress=progress)
    with share_bar("estimating") as progress:
        found = select(
            options.runs,
            dataset,
            method=options.method,
            checkpoints=options.checkpoints,
            **vars(options.how),
            progress=progress,
        )
    print(spelled(str(found)))
    if options.json is not None:
        write_json(options.json, found.to_dict())
