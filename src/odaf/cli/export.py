"""`odaf export RUN --out DIR`: a policy in forms that need neither odaf nor JAX."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import tyro

from odaf.cli.options import parse
from odaf.cli.outputs import ARTEFACT, check_outputs
from odaf.cli.spelling import spelled
from odaf.errors import ConfigError


@dataclass(frozen=True)
class ExportOptions:
    """Write a policy for where it is to run: for ONNX, for C, and for Python with NumPy alone.

    Scaling, bounds, limits and what the policy remembers are inside of every form, and each is compared with the policy
    on random, extreme and boundary inputs before anything is written. A reading that is not finite is refused by
    all of them. contract.json says what goes in, what comes out, what the log has shown, and what is not promised.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """What `odaf train --out` named, or the file of a policy: that of `odaf guard --out` brings its guard."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder to make."""
    forms: tuple[Literal["numpy", "onnx", "c"], ...] = ("numpy", "onnx", "c")
    """Forms to write: numpy (policy.safetensors, odaf_policy.py), onnx (policy.onnx), c (policy.h, policy_test.c)."""
    max_change: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = ()
    """The largest change of an action from one step to the next, in its unit; may be given again for another one."""
    formulas_outside: bool = False
    """Observations that are formulas are computed by the caller, who gives them by their names."""
    named_inputs: bool = False
    """The ONNX graph has an input for each column under its name, so that it refuses other names itself."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="LOG")] = None
    """The log, for the ranges that it has shown; without it, they are taken from the run."""
    training_seed: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Seed of the run whose policy to take; without it, the first."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Checkpoint to take, by its number of updates; without it, the last."""
    force: bool = False
    """Replace an earlier artefact, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ExportOptions, arguments, "export")
    limits = dict(_limit(text) for text in options.max_change)
    check_outputs({"--out": (options.out, ARTEFACT)}, [options.run, options.data], options.force)

    from odaf.deployment import export

    found = export(
        options.run,
        options.out,
        forms=options.forms,
        max_change=limits,
        formulas_outside=options.formulas_outside,
        named_inputs=options.named_inputs,
        data=options.data,
        training_seed=options.training_seed,
        step=options.step,
        replace=options.force,
    )
    print(spelled(str(found)))


def _limit(text: str) -> tuple[str, float]:
    name, equals, value = text.rpartition("=")
    try:
        return name if equals and name else _refuse(text), float(value)
    except ValueError:
        _refuse(text)


def _refuse(text: str) -> NoReturn:
    raise ConfigError(f"--max-change {text}: write NAME=VALUE, such as --max-change valve=5")
