"""Who may write into a run directory: one process at a time, and the workers that it starts.

Whoever trains holds a shared lock on `.lock` until it ends, however it ends. A process that wants to begin must first
have the lock for itself alone, so it waits out the last worker of a run that was killed; a worker only shares it.
"""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from odaf.errors import ConfigError

try:
    import fcntl
except ImportError:  # no such lock on this platform
    fcntl = None

NAME = ".lock"
# Workers of a process that was killed are gone after a moment.
_PATIENCE_SECONDS = 1.0


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keeps other processes out of the run directory `path`, except for workers that join.

    Raises:
        ConfigError: another process trains in it.
    """
    if fcntl is None:
        yield
        return
    with (path / NAME).open("w") as file:
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while not _taken(file, fcntl.LOCK_EX):
            if time.monotonic() > deadline:
                raise _refusal(path)
            time.sleep(0.02)
        # The change is not atomic. Whoever slips in between holds the lock alone, and then we are the ones to go.
        if not _taken(file, fcntl.LOCK_SH):
            raise _refusal(path)
        yield


@contextlib.contextmanager
def joined(path: Path) -> Iterator[None]:
    """Shares the lock of the process that started this one; for its workers.

    Raises:
        ConfigError: another process trains in the directory.
    """
    if fcntl is None:
        yield
        return
    with (path / NAME).open("w") as file:
        if not _taken(file, fcntl.LOCK_SH):
            raise _refusal(path)
        # From here on nobody else can begin. If the parent lives, nobody did before either: it shares the lock too.
        parent = multiprocessing.parent_process()
        if parent is not None and not parent.is_alive():
            os._exit(1)
        yield


def _taken(file: IO[str], kind: int) -> bool:
    assert fcntl is not None
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _refusal(path: Path) -> ConfigError:
    return ConfigError(f"{path}: another process is training in it; wait for it, or give another --out")
