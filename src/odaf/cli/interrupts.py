"""Ctrl-C during a long command: the line that says how to go on."""

import contextlib
import shlex
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def resumable(directory: Path) -> Iterator[None]:
    """Adds to an interruption what is saved of the run in `directory`, and what to type to go on with it."""
    try:
        yield
    except KeyboardInterrupt:
        place = shlex.quote(str(directory))
        saved = ", ".join(
            f"seed {folder.parent.name.removeprefix('seed-')} at update {max(steps):,}"
            for folder in sorted(directory.glob("seed-*/checkpoints"))
            if (steps := [int(child.name) for child in folder.iterdir() if child.name.isdigit()])
        )
        if saved:
            hint = f"saved: {saved}; go on with: odaf resume {place}"
        elif (directory / "config.json").exists():
            hint = f"nothing was trained yet; begin with: odaf resume {place}"
        else:
            hint = "nothing was trained yet; repeat the command to begin again"
        raise KeyboardInterrupt(hint) from None


@contextlib.contextmanager
def repeatable() -> Iterator[None]:
    """Adds to an interruption that the same command goes on where it stopped."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("repeat the command to go on where it stopped") from None
