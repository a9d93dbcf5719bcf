"""`odaf guard RUN --data HOLDOUT`: a policy that says when it is out of its depth, and seldom in error."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from odaf.cli.bars import share_bar
from odaf.cli.options import parse
from odaf.cli.outputs import GUARD, GUARD_RECORD, check_outputs
from odaf.cli.results import quoted
from odaf.cli.spelling import spelled
from odaf.errors import ConfigError


@dataclass(frozen=True)
class GuardOptions:
    """Put a guard beside a policy: in each step it asks whether the action leads away from what the log knows.

    The score has four parts: the range of each column, the distance from logged rows, the disagreement of the critics
    at the outcome that a dynamics model predicts, and how far the last action led from that. Critics and dynamics are
    the run's own, or fitted to its log where it has none. An alarm is a score above the threshold, which is set so that
    sound episodes, drawn as those in HOLDOUT were, have one in at most a share of --false-alarms.

    A rate of 0.01 needs 99 episodes that the policy did not learn from: set them aside with `odaf data split`.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """What `odaf train --out` named, or the file of a policy."""
    data: Annotated[Path, tyro.conf.arg(metavar="HOLDOUT")]
    """Data set that the policy did not learn from, as `odaf data split --holdout` writes it."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """What the policy learned from; without it, the run's own data."""
    false_alarms: float = 0.01
    """Share of sound episodes that may have an alarm."""
    reaction: Literal["warn", "hold", "clone", "stop"] = "warn"
    """What an alarm leads to: a warning alone, the last action held, what the log's own actors would have done, or no
    action any more."""
    episode_steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Rows of a recording that count as one episode, where recordings are long and have no ends."""
    why: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROW | NAME=VALUE...")] = ()
    """Show the logged rows nearest to an action, what was done there and what followed: at a row of HOLDOUT by its
    number, or at an observation, a number for each column. Columns of actions may be given too; else it is the policy's
    own action."""
    neighbours: int = 5
    """Rows to show."""
    training_seed: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Seed of the run whose policy to guard; without it, the first."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    seed: int = 0
    """Of the fits and of the reference rows; equal seeds give equal guards."""
    steps: int = 10_000
    """Gradient steps of each fit."""
    references: int = 1_024
    """Rows of the log that distances are measured to."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write policy and guard to; `odaf.deployment.GuardedPolicy.load` reads it."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write every number to."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(GuardOptions, arguments, "guard")
    outputs = {"--out": (options.out, GUARD), "--json": (options.json, GUARD_RECORD)}
    check_outputs(outputs, [options.run, options.data, options.log], options.force)

    from odaf.data import Dataset
    from odaf.deployment import guard
    from odaf.training.files import write_json

    with share_bar(f"reading {options.data}") as progress:
        holdout = Dataset.load(options.data, progress=progress)
    asked = _asked(options.why, holdout)
    with share_bar("guarding") as progress:
        guarded = guard(
            options.run,
            holdout,
            log=options.log,
            false_alarms=options.false_alarms,
            reaction=options.reaction,
            episode_steps=options.episode_steps,
            training_seed=options.training_seed,
            step=options.step,
            seed=options.seed,
            steps=options.steps,
            references=options.references,
            progress=progress,
        )
    print(spelled(str(guarded)))
    if asked is not None:
        from odaf.deployment.make_guard import log_of
        from odaf.deployment.why import Explainer

        print(f"\n{Explainer(guarded, log_of(options.run, options.log)).ask(*asked, options.neighbours)}")
    if options.out is not None:
        guarded.save(options.out)
        print(f"wrote {options.out}; for C, ONNX or NumPy: odaf export {quoted(options.out)} --out artefact")
    if options.json is not None:
        write_json(options.json, guarded.to_dict())


def _asked(words: tuple[str, ...], holdout: Any) -> tuple[Any, Any] | None:
    """The observation, and the action or None for the policy's own."""
    if not words:
        return None
    if len(words) == 1 and words[0].isdecimal():
        row = int(words[0])
        if row >= len(holdout):
            raise ConfigError(f"why: there is no row {row:,}; {len(holdout):,} rows are set aside, counted from 0")
        return holdout.observations[row], None
    names = {*holdout.observation_names, *holdout.action_names}
    given: dict[str, float] = {}
    for word in words:
        name, sign, value = word.rpartition("=")
        try:
            given[name] = float(value)
        except ValueError:
            sign = ""
        if not sign or name not in names:
            raise ConfigError(
                f"why: {word!r} is neither a row nor a column with a number; give a row of HOLDOUT, or "
                f"NAME=VALUE for each of {', '.join(holdout.observation_names)}"
            )
    lacking = [name for name in holdout.observation_names if name not in given]
    done = [name for name in holdout.action_names if name in given]
    if done:
        lacking += [name for name in holdout.action_names if name not in given]
    if lacking:
        raise ConfigError(f"why: {', '.join(lacking)} is missing; give a number for each column")
    action = [given[name] for name in holdout.action_names] if done else None
    return [given[name] for name in holdout.observation_names], action
