"""What makes two data sets equal: their arrays and metadata in one fixed form, and the checksum over it."""

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from odaf.data.rows import Rows

# Arrays of `Dataset` in their order, with the type and the number of axes that a file holds them in.
FIELDS = {
    "observations": ("<f4", 2),
    "actions": ("<f4", 2),
    "rewards": ("<f4", 1),
    "next_observations": ("<f4", 2),
    "terminated": ("|b1", 1),
    "truncated": ("|b1", 1),
    "episode_starts": ("<i8", 1),
    "action_low": ("<f4", 1),
    "action_high": ("<f4", 1),
}
TEXTS = ("observation_names", "action_names", "observation_units", "action_units")
PIECE = 2**24  # bytes that are worked on at a time


def arrays_of(dataset: Rows) -> dict[str, np.ndarray]:
    """Every array of the file, in its order: those of `Dataset`, then its infos by name."""
    arrays = {name: getattr(dataset, name) for name in FIELDS}
    return arrays | {f"infos/{name}": dataset.infos[name] for name in sorted(dataset.infos)}


def stored_dtype(name: str, array: np.ndarray) -> np.dtype:
    """The type in which a file holds an array."""
    return np.dtype(FIELDS[name][0]) if name in FIELDS else array.dtype.newbyteorder("<")


def metadata(dataset: Rows) -> str:
    """Column names, provenance and mixture as canonical JSON: sorted keys, no spaces."""
    content: dict[str, Any] = {field: list(getattr(dataset, field)) for field in TEXTS}
    content["provenance"] = dataset.provenance
    if dataset.mixture is not None:
        content["mixture"] = dataset.mixture.to_dict()
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def checksum(arrays: Mapping[str, np.ndarray], text: str, advance: Callable[[int], None] | None = None) -> str:
    """SHA-256 (hex) over the arrays in the order of the format, each after its name, type and shape, then `text`.

    Args:
        arrays: as `arrays_of` gives them.
        text: as `metadata` gives it.
        advance: told how many more bytes were summed.
    """
    digest = hashlib.sha256()
    for name in (*FIELDS, *sorted(set(arrays) - set(FIELDS))):
        array = np.ascontiguousarray(arrays[name], dtype=stored_dtype(name, arrays[name]))
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        if array.size:
            content = array.view(np.uint8).reshape(-1).data  # its own bytes, uncopied
            for first in range(0, len(content), PIECE):
                digest.update(content[first : first + PIECE])
                if advance is not None:
                    advance(len(content[first : first + PIECE]))
    digest.update(f"metadata {len(text.encode())}\n".encode())
    digest.update(text.encode())
    return digest.hexdigest()
