"""`odaf evaluate DIR`: play episodes with the policies of a run, in peace, under attack, or knocked."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import ATTACK_SCORES, PICTURE, SCORES, check_outputs
from odaf.cli.results import attack_table, estimated, number, score_table
from odaf.errors import ConfigError

# The names of `odaf.evaluation.attacks.ATTACKS` and `odaf.environments.knocks.LEVELS`; help must load neither.
Attack = Literal[
    "random",
    "action-diff",
    "min-q",
    "min-q-std",
    "action-diff-first-order",
    "min-q-first-order",
    "min-q-std-first-order",
    "action-diff-mixed-order",
    "min-q-mixed-order",
    "min-q-std-mixed-order",
]
Level = Literal["none", "slight", "moderate", "large", "extra-large"]

_EPISODES, _ATTACKED_EPISODES = 50, 10
_ATTACK_ONLY, _KNOCK_ONLY = (
    ("eps", "attack_steps", "attacker", "plot"),
    ("knock_steps", "knock_at", "knock_action", "data"),
)


@dataclass(frozen=True)
class EvaluateOptions:
    """Play episodes with the policies of a run and print what they earn. The run itself is not changed."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """What `odaf train --out` named."""
    episodes: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Episodes for each policy; without it 50, and 10 for each budget of an attack."""
    seed: int = 0
    """Chooses the starts; the same for every policy, so that they can be compared."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Gymnasium id of the environment, or MODULE:ID where a module must be imported first; without it, the run's."""
    contact_margins: Annotated[Literal["added", "larger"] | None, tyro.conf.arg(metavar="RULE")] = None
    """How MuJoCo counts the contact margins of two parts that touch: `added`, as it does from 3.5.0 on, or `larger`, as
    before, which makes Hopper and the point mazes the older bodies; without it, as the run did."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Processes that play episodes side by side; without it, 1. More of them may change the last digits."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write the scores to, with every episode's return and length."""
    attack: Annotated[Attack | None, tyro.conf.arg(metavar="NAME")] = None
    """Show the policies falsified observations: `random`, or `action-diff`, `min-q`, `min-q-std`, each also with
    `-first-order` or `-mixed-order` after it."""
    eps: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="E")] = None
    """Largest offsets of an attack, in standard deviations of the log; without it 0 0.05 0.1 0.15 0.2 0.25 0.3."""
    attack_steps: Annotated[Literal["pgd", "rorl"] | None, tyro.conf.arg(metavar="RULE")] = None
    """Gradient steps of an attack: `pgd`, scaled to the box, or `rorl`, those of the published code; without it pgd."""
    attacker: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run whose critics the attacks `min-q` and `min-q-std` ask, so that all policies are judged alike and one without
    critics can be attacked; without it, each policy's own critics."""
    plot: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """SVG or PNG file to draw the return under attack in."""
    knock: Annotated[Level | None, tyro.conf.arg(metavar="LEVEL")] = None
    """Take the controls away once in every episode: `none` 0, `slight` 5, `moderate` 10, `large` 15, `extra-large` 30
    simulator steps."""
    knock_steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Another number of simulator steps for the knock."""
    knock_at: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Counted steps before the knock; without it 500."""
    knock_action: Annotated[Literal["motors-off", "uniform", "gaussian"] | None, tyro.conf.arg(metavar="KIND")] = None
    """Actions of the knock: `motors-off`, `uniform` or `gaussian`; without it motors-off."""
    initial_noise: Annotated[float | None, tyro.conf.arg(metavar="E")] = None
    """Start locomotion off its pose by so many standard deviations of the log, for instance 0.1; no published test."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File of the run's data, for the recovery time after a knock; without it, where the run found them."""
    force: bool = False
    """Write over files of another kind, if they are there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(EvaluateOptions, arguments, "evaluate")
    attacked = options.attack is not None
    disturbed = any(value is not None for value in (options.knock, options.knock_steps, options.initial_noise))
    if attacked and disturbed:
        raise ConfigError(
            "--attack: goes with neither --knock, --knock-steps nor --initial-noise; measure one at a time"
        )
    if not attacked:
        _refuse(options, _ATTACK_ONLY, "--attack NAME")
    if not disturbed:
        _refuse(options, _KNOCK_ONLY, "--knock LEVEL")
    outputs = {"--json": (options.json, ATTACK_SCORES if attacked else SCORES), "--plot": (options.plot, PICTURE)}
    check_outputs(outputs, [options.directory, options.attacker, options.data], options.force)
    if options.workers is not None and (attacked or disturbed):
        raise ConfigError("--workers: episodes under attack or with a knock are played in one process; leave it out")
    if attacked:
        _under_attack(options)
    elif disturbed:
        _knocked(options)
    else:
        _in_peace(options)


def _refuse(options: EvaluateOptions, fields: tuple[str, ...], wanted: str) -> None:
    given = [f"--{field.replace('_', '-')}" for field in fields if getattr(options, field) is not None]
    if given:
        raise ConfigError(f"{', '.join(given)}: means nothing without {wanted}; add it, or leave this out")


def _where(options: EvaluateOptions, episodes: int) -> dict[str, Any]:
    chosen = episodes if options.episodes is None else options.episodes
    rule = {"contact_margins": options.contact_margins}
    return {"episodes": chosen, "seed": options.seed, "step": options.step, "environment": options.env, **rule}


def _in_peace(options: EvaluateOptions) -> None:
    from odaf.runs.evaluate import evaluate
    from odaf.training.files import write_json

    workers = 1 if options.workers is None else options.workers
    scores = evaluate(options.directory, **_where(options, _EPISODES), workers=workers)
    print(score_table(scores))
    if len(scores.by_seed) > 1 or math.isnan(scores.mean):
        print(f"\n{scores}")
    if (normalised := scores.normalised) is not None and not math.isnan(scores.mean):
        print(
            f"\n{normalised['environment']}: normalised score {number(normalised['normalised_score'])} "
            f"({_meaning(normalised['environment'])}), raw return {number(normalised['mean_return'])}"
        )
    for note in scores.notes:
        print(f"\nnote: {note}")
    if options.json is not None:
        write_json(options.json, scores.to_dict())


def _meaning(environment: str) -> str:
    """What 0 and 100 are in an environment that has a normalised score."""
    from odaf.environments.reference_returns import reference_of

    reference = reference_of(environment)
    assert reference is not None
    return reference.meaning


def _under_attack(options: EvaluateOptions) -> None:
    from odaf.report import figures
    from odaf.runs.evaluate_attacks import BUDGETS, attack_curve
    from odaf.training.files import write_json

    assert options.attack is not None
    if options.plot is not None:
        figures.check_attack_figure(options.plot)
    curve = attack_curve(
        options.directory,
        options.attack,
        budgets=BUDGETS if options.eps is None else options.eps,
        rule=options.attack_steps or "pgd",
        attacker=options.attacker,
        **_where(options, _ATTACKED_EPISODES),
    )
    print(attack_table(curve))
    if curve.attacker is not None:
        print(f"\nJudged by the critics of {curve.attacker}.")
    print(f"\n{curve.environment_steps / curve.seconds:,.0f} environment steps/s, compilation included")
    if options.json is not None:
        write_json(options.json, curve.to_dict())
    if options.plot is not None:
        print(f"wrote {figures.attack_figure(curve, options.plot, options.directory.name)}")


def _knocked(options: EvaluateOptions) -> None:
    from odaf.environments.knocks import LEVELS, Knock
    from odaf.runs.evaluate_knocks import knock_scores
    from odaf.training.files import write_json

    steps = LEVELS[options.knock or "none"] if options.knock_steps is None else options.knock_steps
    given = {"at": options.knock_at, "action": options.knock_action}
    found = knock_scores(
        options.directory,
        Knock(steps, **{name: value for name, value in given.items() if value is not None}),
        initial_noise=options.initial_noise or 0.0,
        data=options.data,
        **_where(options, _EPISODES),
    )
    print(score_table(found.scores))
    print(f"\nreturn {estimated(found.scores.estimate())}")
    if found.normalised is not None and (played := found.scores.environment) is not None:
        print(f"{played}: normalised score {estimated(found.normalised)} ({_meaning(played)})")
    if (recovery := found.recovery) is not None:
        median = "never" if recovery.median == float("inf") else f"{recovery.median:g} steps"
        print(
            f"back on logged ground: {median} in the median, {recovery.recovered_rate:.0%} of {recovery.episodes} "
            f"episodes; within {recovery.threshold:.3g} of one of {recovery.rows:,} logged states"
        )
    elif found.no_recovery:
        print(f"back on logged ground: not measured, {found.no_recovery}")
    if options.json is not None:
        write_json(options.json, found.to_dict())
