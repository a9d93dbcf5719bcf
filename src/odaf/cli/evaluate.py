"""`odaf evaluate DIR`: play episodes with the policies of a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.results import number, score_table


@dataclass(frozen=True)
class EvaluateOptions:
    """Play episodes with the policies of a run and print what they earn. The run itself is not changed."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """What `odaf train --out` named."""
    episodes: int = 50
    """Episodes for each policy."""
    seed: int = 0
    """Chooses the starts; the same for every policy, so that they can be compared."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Gymnasium id of the environment; without it, the run's own."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write the scores to."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(EvaluateOptions, arguments, "evaluate")

    from odaf.experiments.evaluate import evaluate
    from odaf.training.files import write_json

    scores = evaluate(
        options.directory, episodes=options.episodes, seed=options.seed, step=options.step, environment=options.env
    )
    print(score_table(scores))
    if len(scores.by_seed) > 1:
        print(f"\n{scores}")
    if (normalised := scores.normalised) is not None:
        print(
            f"\n{normalised['environment']}: normalised score {number(normalised['normalised_score'])} "
            f"(0 random, 100 expert), raw return {number(normalised['mean_return'])}"
        )
    if options.json is not None:
        write_json(options.json, scores.to_dict())
