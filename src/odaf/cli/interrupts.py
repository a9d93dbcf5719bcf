"""Ctrl-C during a long command: the line that says how to go on."""

import contextlib
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def resumable(directory: Path) -> Iterator[None]:
    """Adds to an interruption what to type to go on with the run in `directory`."""
    try:
        yield
    except KeyboardInterrupt:
        if (directory / "config.json").exists():
            hint = f"everything up to the last checkpoint is kept; go on with: odaf resume {directory}"
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
