"""`odaf estimate RUN --data HOLDOUT`: what a policy is worth, from a log alone."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.estimator_options import EstimatorOptions
from odaf.cli.options import parse
from odaf.cli.outputs import VALUATION, check_outputs
from odaf.cli.spelling import spelled


@dataclass(frozen=True)
class EstimateOptions:
    """Say from a log alone what a policy is worth, beside what whoever wrote the log earned. Needs no simulator.

    Values are those of an episode and of a step, in the log's unit of reward, with intervals over episodes. The log
    must be one that the policy did not learn from: set episodes aside with `odaf data split` before training. Each
    estimator says better, worse or not decided, and refuses where the log cannot tell, with the reason.

    fqe fits what the policy's actions are worth, step by step; shrunk draws that toward what the log earned, the more
    the less the policy acts as the log does; model plays the policy in a fitted model of the plant; blend is the
    weighed mean of fqe and model, calibrated by what the log earned. These ask for no density. wis (whole
    episodes), pdis (per decision) and dr (doubly robust) weigh logged episodes by how much more probable the policy
    makes their actions; they need --acting draws and policies that have a density, and long episodes leave them few
    effective ones.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """What `odaf train --out` named, or the file of a policy."""
    data: Annotated[Path, tyro.conf.arg(metavar="HOLDOUT")]
    """Data set that the policy did not learn from, as `odaf data split --holdout` writes it."""
    method: Literal["fqe", "shrunk", "model", "blend", "wis", "pdis", "dr", "all"] = "all"
    """Estimator to ask."""
    training_seed: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Seed of the run whose policy to judge; without it, the first."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    how: Annotated[EstimatorOptions, tyro.conf.arg(name="")] = field(default_factory=EstimatorOptions)
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write every number to."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(EstimateOptions, arguments, "estimate")
    check_outputs({"--json": (options.json, VALUATION)}, [options.run, options.data], options.force)

    from odaf.data import Dataset
    from odaf.estimation import estimate
    from odaf.training.files import write_json

    with share_bar(f"reading {options.data}") as progress:
        dataset = Dataset.load(options.data, progress=progress)
    with share_bar("estimating") as progress:
        found = estimate(
            options.run,
            dataset,
            method=options.method,
            training_seed=options.training_seed,
            step=options.step,
            **vars(options.how),
            progress=progress,
        )
    print(spelled(str(found)))
    if options.json is not None:
        write_json(options.json, found.to_dict())
