"""`odaf assess RUN --data HOLDOUT`: may I run this?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import ASSESSMENT, PAGE, check_outputs
from odaf.cli.spelling import spelled


@dataclass(frozen=True)
class AssessOptions:
    """Say whether a log speaks for running a policy: better than whoever wrote the log, not decided, worse, or refused.

    The value of an episode is estimated from episodes that the policy did not learn from, and laid beside what they
    earned. Each --keep adds the probability that an episode breaks a condition. The policy's actions are laid beside
    the logged ones in the same states, and a guard is calibrated. No simulator is asked.

    --after takes a log that was written while the policy ran, and lays what was promised beside what happened.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """What `odaf train --out` named, or the file of a policy."""
    data: Annotated[Path, tyro.conf.arg(metavar="HOLDOUT")]
    """Data set that the policy did not learn from, as `odaf data split --holdout` writes it."""
    keep: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="CONDITION")] = ()
    """A comparison of columns that shall hold in every row, such as "level < 3"; may be given again."""
    after: Annotated[Path | None, tyro.conf.arg(metavar="NEWLOG")] = None
    """Data set that was written while the policy ran, with the columns of HOLDOUT."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """What the policy learned from, for the guard; without it, the run's own data."""
    false_alarms: float = 0.01
    """Share of sound episodes that may have an alarm; a hold-out with too few episodes for it promises what it can."""
    discount: float = 1.0
    """Weight of a reward one step later; 1 gives plain sums."""
    horizon: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Steps of an episode to count; without it, what the log shows."""
    training_seed: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Seed of the run whose policy to judge; without it, the first."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    seed: int = 0
    """Of everything random; equal seeds give equal assessments."""
    steps: int = 20_000
    """Gradient steps of each fit of a value; the guard's fits take half as many."""
    members: int = 8
    """Networks of fitted Q, each with resampled episodes of its own."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """HTML file to write: one page that needs no network to be read."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write every number to."""
    title: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """Heading of the page; without it, the run's name."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(AssessOptions, arguments, "assess")
    outputs = {"--out": (options.out, PAGE), "--json": (options.json, ASSESSMENT)}
    check_outputs(outputs, [options.run, options.data, options.after, options.log], options.force)

    from odaf.assessment import aftermath, assess
    from odaf.data import Dataset
    from odaf.estimation import EstimateSettings
    from odaf.report.extras import check_extra
    from odaf.training.files import plain, write_json

    if options.out is not None:
        check_extra()
    with share_bar(f"reading {options.data}") as progress:
        holdout = Dataset.load(options.data, progress=progress)
    new = None
    if options.after is not None:
        with share_bar(f"reading {options.after}") as progress:
            new = Dataset.load(options.after, progress=progress)
    with share_bar("assessing") as progress:
        found = assess(
            options.run,
            holdout,
            keep=options.keep,
            log=options.log,
            false_alarms=options.false_alarms,
            discount=options.discount,
            horizon=options.horizon,
            training_seed=options.training_seed,
            step=options.step,
            seed=options.seed,
            settings=EstimateSettings(steps=options.steps, members=options.members),
            guard_changes={"steps": max(options.steps // 2, 1)},
            progress=progress,
        )
    after = None if new is None else aftermath(found, new)
    print(spelled(str(found)))
    if after is not None:
        print(f"\n{after}")
    if options.out is not None:
        from odaf.assessment import page

        print(f"wrote {page.build(found, options.out, options.title or options.run.name, after)}")
    if options.json is not None:
        write_json(options.json, found.to_dict() | {"after": None if after is None else plain(after.to_dict())})
