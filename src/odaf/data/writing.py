"""Files that appear whole or not at all: written beside their place, then renamed."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

# Names that start so belong to a write that has not finished; whoever opens a run directory next removes them.
TEMPORARY_PREFIX = ".writing-"


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A place beside `path` to write a file to; it takes the place of `path` when the block ends without an error.

    A link stays: what it points to is replaced. A pipe or a device, such as /dev/stdout, is written to directly.

    Raises:
        OSError: the file cannot be written.
    """
    target = Path(os.path.realpath(path))
    if os.path.exists(path) and not target.is_file():
        yield Path(path)
        return
    temporary = target.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{target.name}")
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            sync_file(file)
        os.replace(temporary, target)
    except OSError as error:
        if error.errno is not None and error.filename is None:  # a full disk does not say which file it has no room for
            error.filename = os.fspath(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
    sync_directory(target.parent)


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Calls `write` with a file opened beside `path`, then renames it to `path` once it is safely on the disk."""
    with replacing(path) as place, place.open("wb") as file:
        write(file)


def write_text(path: Path, text: str) -> None:
    """Writes `text` as UTF-8, atomically."""
    write_atomically(path, lambda file: file.write(text.encode()))


def sync_file(file: Any) -> None:
    """Hands everything written to `file` to the disk."""
    file.flush()
    os.fsync(file.fileno())


def sync_directory(path: Path) -> None:
    """Hands the names in a directory to the disk, so that a rename survives a power failure."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:  # not every platform opens directories; the rename itself is still atomic
        return
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
