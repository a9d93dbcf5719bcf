"""What must be settled before JAX is loaded, for a training's bits to be those of its record."""

import itertools
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def prepare_process(directory: str | Path | None, cores: str | None = None, device: str | None = None) -> None:
    """Lets JAX count on as many cores, and take the device, that a run was begun with.

    Once JAX is loaded it is too late, and nothing is changed; training then says beforehand what differs. What the user
    has set in the environment stays.

    Args:
        directory: where the run goes or lies, if it is known.
        cores: asked for on the command line; without it, those in the run's record.
        device: asked for on the command line; without it, that in the run's record.
    """
    if "jax" in sys.modules:
        return
    record = _recorded(directory)
    wanted = str(cores or record.get("cores") or "")
    if wanted.isdecimal() and int(wanted) > 0:
        os.environ.setdefault("NPROC", wanted)
    if (device or record.get("device")) == "cpu":
        os.environ.setdefault("JAX_PLATFORMS", "cpu")


def option_given(arguments: list[str], option: str) -> str | None:
    """What follows an option, for those that must be known before the options are read."""
    for word, following in itertools.zip_longest(arguments, arguments[1:]):
        if word == option:
            return following
        if word.startswith(f"{option}="):
            return word.removeprefix(f"{option}=")
    return None


def _recorded(directory: str | Path | None) -> Mapping[str, Any]:
    if directory is None:
        return {}
    try:
        config = json.loads((Path(directory) / "config.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):  # no run yet, or a damaged one, which its reader will name
        return {}
    return config if isinstance(config, dict) else {}
