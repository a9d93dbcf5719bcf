"""What makes two data sets equal: one print over the rows that learners see, one over everything in the file."""

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
    return _canonical(content)


def checksum(arrays: Mapping[str, np.ndarray], text: str, advance: Callable[[int], None] | None = None) -> str:
    """SHA-256 (hex) over the arrays in the order of the format, each after its name, type and shape, then `text`.

    Args:
        arrays: as `arrays_of` gives them.
        text: as `metadata` gives it.
        advance: told how many more bytes were summed.
    """
    digest = hashlib.sha256()
    for name in (*FIELDS, *sorted(set(arrays) - set(FIELDS))):
        _add(digest, name, arrays[name], advance)
    return _with_text(digest, "metadata", text)


def of_rows(dataset: Rows) -> str:
    """SHA-256 (hex) over what a learner sees: columns, ends, action bounds, names of columns, mixture.

    Units, infos and provenance are no part of it, so a note does not make other data of the same rows.
    """
    digest = hashlib.sha256()
    for name in FIELDS:
        _add(digest, name, getattr(dataset, name), None)
    seen = {field: list(getattr(dataset, field)) for field in ("observation_names", "action_names")}
    mixture = None if dataset.mixture is None else dataset.mixture.to_dict()
    return _with_text(digest, "rows", _canonical({**seen, "mixture": mixture}))


def of_file(dataset: Rows) -> str:
    """SHA-256 (hex) over everything that a file of these data holds, as it stands in the file's attribute `sha256`."""
    return checksum(arrays_of(dataset), metadata(dataset))


def record(dataset: Rows) -> dict[str, str]:
    """Both prints, as records name them: `sha256` of everything, `rows_sha256` of what a learner sees."""
    return {"sha256": of_file(dataset), "rows_sha256": of_rows(dataset)}


def differing(dataset: Rows, recorded: Mapping[str, Any]) -> tuple[str, str] | None:
    """(print of the data, print of the record) where the rows are not those of a record; None where they are.

    A record from before prints of rows knows only that of the whole file, and is compared by it.
    """
    rows = recorded.get("rows_sha256")
    found, expected = (of_file(dataset), str(recorded.get("sha256"))) if rows is None else (of_rows(dataset), str(rows))
    return None if found == expected else (found, expected)


def _canonical(content: Mapping[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _add(digest: Any, name: str, array: np.ndarray, advance: Callable[[int], None] | None) -> None:
    """Takes an array into the sum, after its name, type and shape."""
    array = np.ascontiguousarray(array, dtype=stored_dtype(name, array))
    digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
    if array.size:
        content = array.view(np.uint8).reshape(-1).data  # its own bytes, uncopied
        for first in range(0, len(content), PIECE):
            digest.update(content[first : first + PIECE])
            if advance is not None:
                advance(len(content[first : first + PIECE]))


def _with_text(digest: Any, title: str, text: str) -> str:
    digest.update(f"{title} {len(text.encode())}\n".encode())
    digest.update(text.encode())
    return digest.hexdigest()
