"""What must be settled before JAX is loaded, for a training's bits to be those of its record."""

import itertools
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def prepare_process(
    directory: str | Path | None, cores: str | None = None, device: str | None = None, deterministic: bool = True
) -> None:
    """Lets JAX count on as many cores, and take the device, that a run was begun with; makes a GPU's sums repeatable.

    Once JAX is loaded it is too late, and nothing is changed; training then says beforehand what differs. What the user
    has set in the environment stays.

    Args:
        directory: where the run goes or lies, if it is known.
        cores: asked for on the command line; without it, those in the run's record.
        device: asked for on the command line; without it, that in the run's record.
        deterministic: whether a GPU adds in a fixed order.
    """
    if "jax" in sys.modules:
        return
    record = _recorded(directory)
    wanted = str(cores or record.get("cores") or "")
    if wanted.isdecimal() and int(wanted) > 0:
        os.environ.setdefault("NPROC", wanted)
    if (device or record.get("device")) == "cpu":
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
    elif deterministic and _has_gpu():
        make_deterministic()


def make_deterministic() -> None:
    """Asks XLA for sums in a fixed order on a GPU, unless its flags say something of that already."""
    flags = os.environ.get("XLA_FLAGS", "")
    if not any(word in flags for word in ("xla_gpu_deterministic_ops", "xla_gpu_exclude_nondeterministic_ops")):
        os.environ["XLA_FLAGS"] = f"{flags} --xla_gpu_deterministic_ops=true".strip()


def _has_gpu() -> bool:
    """Whether this machine shows one of the makers' devices; JAX would have to be loaded to know more."""
    return any(Path("/dev").glob("nvidia[0-9]*")) or Path("/dev/kfd").exists()


def option_given(arguments: list[str], option: str) -> str | None:
    """What follows an option, for those that must be known before the options are read."""
    for word, following in itertools.zip_longest(arguments, arguments[1:]):
        if word == option:
            return following
        if word.startswith(f"{option}="):
            return word.removeprefix(f"{option}=")
    return None


def values_given(arguments: list[str], option: str) -> list[str]:
    """The words that follow an option that takes several, up to the next option."""
    found, inside = [], False
    for word in arguments:
        if word == option or word.startswith(f"{option}="):
            inside, (_, equals, value) = True, word.partition("=")
            found += [value] if equals else []
        elif word.startswith("--"):
            inside = False
        elif inside:
            found.append(word)
    return found


def _recorded(directory: str | Path | None) -> Mapping[str, Any]:
    if directory is None:
        return {}
    try:
        config = json.loads((Path(directory) / "config.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):  # no run yet, or a damaged one, which its reader will name
        return {}
    return config if isinstance(config, dict) else {}
