"""Writing files so that a kill at any moment leaves either the old file or the new one."""

import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from odaf.errors import CheckpointError

# Names that start so belong to a write that has not finished; whoever opens the run directory next removes them.
TEMPORARY_PREFIX = ".writing-"


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Calls `write` with a file opened beside `path`, then renames it to `path` once it is safely on the disk."""
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    try:
        with temporary.open("wb") as file:
            write(file)
            sync_file(file)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_directory(path.parent)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes named arrays to one compressed .npz file, atomically."""

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)

    write_atomically(path, write)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes `content` as indented JSON, atomically. Numbers that are not finite become null."""
    text = json.dumps(finite(content), indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """The JSON object in `path`.

    Raises:
        CheckpointError: the file is missing or is not one JSON object; the message names it and ends with `remedy`.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CheckpointError(f"{path}: there is no such file. {remedy}") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise CheckpointError(f"{path}: cannot be read as JSON ({error}). {remedy}") from None
    if not isinstance(content, dict):
        raise CheckpointError(f"{path}: expected a JSON object, found {type(content).__name__}. {remedy}")
    return content


def finite(value: Any) -> Any:
    """`value` with every number that is not finite replaced by None, because JSON has no name for it."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def plain(value: Any) -> Any:
    """`value` as it comes back from a JSON file: tuples are lists, names are strings, all numbers are finite."""
    return json.loads(json.dumps(finite(value), allow_nan=False))


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
