"""Ctrl-C during a run: the line that says how to go on."""

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
