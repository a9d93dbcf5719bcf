"""`odaf behaviour train` and `export`: make the policies that data are recorded from, and ship them."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse
from odaf.cli.results import number
from odaf.errors import ConfigError


@dataclass(frozen=True)
class TrainOptions:
    """Train a behaviour policy online, with truncated quantile critics.

    A run that was stopped goes on, and more --steps make a finished one longer.
    """

    task: tyro.conf.Positional[Literal["halfcheetah", "hopper", "walker2d", "ant"]]
    """What to learn; `ant` is the walker that the ant mazes are recorded with."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory of the run."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Environment steps, one update each after the first 10,000; without it 1,000,000, and 400,000 for the ant."""
    batch_size: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Transitions an update, without it 256, and 128 for the ant; half of it makes an update cost three fifths."""
    seed: int = 0
    """The same seed gives the same bits on the same machine and versions."""
    version: Annotated[Literal["v4", "v5"] | None, tyro.conf.arg(metavar="v4|v5")] = None
    """Environment version, v4 where none is named; of the ant there is one only."""
    contact_margins: Annotated[Literal["added", "larger"] | None, tyro.conf.arg(metavar="RULE")] = None
    """How MuJoCo counts the contact margins of two parts that touch: `added`, as it does from 3.5.0 on, or `larger`, as
    before, which makes Hopper the older body; without it, as the installed one does, and `larger` for the ant."""
    core: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Stay on this processor core, so that runs side by side do not fight over threads."""


def train(arguments: list[str]) -> None:
    """Entry point of `odaf behaviour train`."""
    options = parse(TrainOptions, arguments, "behaviour train")
    if options.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {options.core})  # before an array library counts the cores

    from odaf.behaviour.online import OnlineRun
    from odaf.behaviour.online import train as train_online
    from odaf.behaviour.tasks import usual_settings
    from odaf.training.progress import default_progress

    named = {"version": options.version, "steps": options.steps, "batch_size": options.batch_size}
    settings = {**usual_settings(options.task), **{name: value for name, value in named.items() if value is not None}}
    run = OnlineRun(options.task, seed=options.seed, contact_margins=options.contact_margins, **settings)
    with repeatable():
        train_online(run, options.out, default_progress(True))


@dataclass(frozen=True)
class ExportOptions:
    """Choose medium, expert and replay policies from a training run and put them where `odaf data generate` looks; of a
    run of the ant, one walker."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A directory of `odaf behaviour train`."""
    policies: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the arrays; without it, the installed package's own."""
    ledger: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/behaviour")
    """Folder for the record of the run and its learning curve."""
    expert_only: bool = False
    """Take only the expert from this run; the medium and replay policies that are there stay."""


def export(arguments: list[str]) -> None:
    """Entry point of `odaf behaviour export`."""
    options = parse(ExportOptions, arguments, "behaviour export")

    from odaf.behaviour.export import export as export_policies
    from odaf.behaviour.export_walker import export_walker
    from odaf.behaviour.online import run_in
    from odaf.environments import shipped_policies
    from odaf.training.progress import default_progress

    folder = options.policies or Path(shipped_policies.__file__).with_name("policies")
    progress = default_progress(True)
    if run_in(options.directory).task == shipped_policies.WALKER:
        if options.expert_only:
            raise ConfigError("--expert-only: a run of the ant has one walker; leave it out")
        _print_walker(export_walker(options.directory, folder, options.ledger, progress)["walker"])
        return
    facts = export_policies(options.directory, folder, options.ledger, progress, expert_only=options.expert_only)
    for name in ("medium", "expert"):
        level = facts[name]
        if level is None:
            print(f"{name}: not reached yet")
        else:
            print(
                f"{name}: step {level['step']:,}, {facts['environment']} score {number(level['normalised_score'])}, "
                f"return {number(level['mean_return'])} over {level['episodes']} stochastic episodes"
            )


def _print_walker(look: Mapping[str, Any]) -> None:
    success, count = look["success"], look["walks"] * len(look["success"])
    print(
        f"walker: step {look['step']:,}, reaches {sum(success) / len(success):.1%} of waypoints 8 m away (at least "
        f"{min(success):.0%} in each of {len(success)} directions, {count} walks), {look['mean_speed']:.2f} m/s, "
        f"turned over in {look['flipped']:.1%}"
    )
    print(
        f"{look['maze']}: {look['maze_reached']:.0%} of {look['maze_walks']} walks reached their goal, "
        f"{look['maze_flipped']:.0%} ended on their back"
    )
