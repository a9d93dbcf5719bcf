"""Writing files so that a kill at any moment leaves either the old file or the new one."""

import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from odaf.data.writing import write_atomically, write_text
from odaf.errors import CheckpointError


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes named arrays to one compressed .npz file, atomically."""

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)

    write_atomically(path, write)


def read_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """All arrays of an .npz file; pickled objects are refused.

    Raises:
        CheckpointError: the file is damaged or holds anything but plain arrays; the message ends with `remedy`.
    """
    try:
        # Opened here, because numpy leaves the file open when the archive is damaged.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception as error:  # numpy and zipfile raise half a dozen unrelated types for damaged archives
        raise CheckpointError(f"{path}: cannot be read as plain arrays ({error}). {remedy}") from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes `content` as indented JSON, atomically. Numbers that are not finite become null."""
    text = json.dumps(finite(content), indent=2, allow_nan=False) + "\n"
    write_text(path, text)


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
