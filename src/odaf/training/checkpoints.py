"""Complete learner states on the disk: Equinox leaves beside a JSON header, written atomically; loading runs no code.

A checkpoint is a folder named after its step, with `state.eqx` (every array of the state, in the order of the tree)
and `header.json` (what the arrays are, and their checksum). Random keys are not stored: they are functions of seed and
step.
"""

import hashlib
import io
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu

from odaf.data.writing import TEMPORARY_PREFIX, sync_directory, sync_file
from odaf.errors import CheckpointError
from odaf.training.files import read_json, write_json
from odaf.training.settings import KeepCheckpoints

FORMAT = "odaf-checkpoint"
VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """One checkpoint folder; `step` is the number of updates it has seen."""

    path: Path
    step: int

    def header(self) -> dict[str, Any]:
        """The header, checked for format, version and step.

        Raises:
            CheckpointError: naming the file, the field and the remedy.
        """
        path = self.path / "header.json"
        header = read_json(path, _REMEDY)
        _expect(path, "format", header.get("format"), FORMAT)
        _expect(path, "version", header.get("version"), VERSION, "It was written by another version of odaf.")
        _expect(path, "step", header.get("step"), self.step, "The folder's name and the header must agree.")
        return header

    def load(self, like: Any, *, identity: dict[str, Any] | None = None) -> Any:
        """The state, in the shape of `like` (arrays or `jax.ShapeDtypeStruct`s; other leaves are taken over).

        Args:
            like: a state of the same learner, for its structure alone.
            identity: what the header must say about where the checkpoint comes from, such as the seed.

        Raises:
            CheckpointError: the files are missing, damaged, or hold the state of something else.
        """
        header = self.header()
        header_path, state_path = self.path / "header.json", self.path / "state.eqx"
        for field, value in (identity or {}).items():
            _expect(header_path, field, header.get(field), value, "The checkpoint belongs to another run.")
        try:
            content = state_path.read_bytes()
        except OSError as error:
            raise CheckpointError(f"{state_path}: cannot be read ({error.strerror}). {_REMEDY}") from None
        _expect(state_path, "size in bytes", len(content), header.get("bytes"), "The file was cut or changed.")
        checksum = hashlib.sha256(content).hexdigest()
        _expect(state_path, "sha256", checksum, header.get("sha256"), "The file was changed after it was written.")

        expected, found = describe(like), header.get("leaves")
        if expected != found:
            raise CheckpointError(
                f"{header_path}: leaves: {_first_difference(expected, found)}. The checkpoint was written by a learner "
                "with other settings; put back the config.json it was trained with, or train into another directory."
            )
        arrays, rest = eqx.partition(like, is_stored)
        template = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), arrays)
        try:
            loaded = eqx.tree_deserialise_leaves(io.BytesIO(content), template)
        except Exception as error:  # whatever NumPy makes of bytes that pass the checksum but are no arrays
            raise CheckpointError(f"{state_path}: cannot be read as arrays ({error}). {_REMEDY}") from None
        return eqx.combine(loaded, rest)


_REMEDY = "Remove this checkpoint's folder to fall back to the one before it."


def save(directory: Path, step: int, state: Any, record: dict[str, Any]) -> Checkpoint:
    """Writes `directory/STEP/` in one atomic rename; `record` joins the header. An equal step is replaced."""
    arrays = stored(state)
    buffer = io.BytesIO()
    eqx.tree_serialise_leaves(buffer, arrays)
    content = buffer.getvalue()
    header = {
        "format": FORMAT,
        "version": VERSION,
        "step": step,
        "bytes": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
        **record,
        "leaves": describe(arrays),
    }
    directory.mkdir(parents=True, exist_ok=True)
    final = directory / f"{step:08d}"
    temporary = directory / f"{TEMPORARY_PREFIX}{os.getpid()}-{step:08d}"
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    try:
        with (temporary / "state.eqx").open("wb") as file:
            file.write(content)
            sync_file(file)
        write_json(temporary / "header.json", header)
        if final.exists():
            # Two renames are not one: between them there is no folder of this step, and the one before it counts.
            replaced = directory / f"{TEMPORARY_PREFIX}{os.getpid()}-replaced-{step:08d}"
            os.replace(final, replaced)
            os.replace(temporary, final)
            shutil.rmtree(replaced)
        else:
            os.replace(temporary, final)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    sync_directory(directory)
    return Checkpoint(final, step)


def rewrite_record(checkpoint: Checkpoint, record: dict[str, Any]) -> None:
    """Replaces what `save` was given as `record`, atomically; the state stays as it is."""
    write_json(checkpoint.path / "header.json", {**checkpoint.header(), **record})


def prune(directory: Path, keep: KeepCheckpoints, every: int) -> None:
    """Removes the checkpoints below `directory` that a run need not keep.

    Which stay does not depend on how often this was called before. A kill at any moment leaves whole checkpoints, and
    folders that `listed` does not count.

    Args:
        directory: a seed's checkpoints.
        keep: see `RunSettings.keep_checkpoints`.
        every: updates between two regular checkpoints.
    """
    if keep == "all":
        return
    last, one_in = keep
    for checkpoint in listed(directory)[:-last]:
        if one_in == 0 or checkpoint.step % (one_in * every):
            going = directory / f"{TEMPORARY_PREFIX}{os.getpid()}-removed-{checkpoint.path.name}"
            os.replace(checkpoint.path, going)
            shutil.rmtree(going)


def rule(keep: Any) -> str:
    """What `prune` keeps, in words."""
    if keep == "all":
        return "every checkpoint"
    last, one_in = keep
    return f"the last {last}" + (f" and one in {one_in} of the others" if one_in else "")


def listed(directory: Path) -> list[Checkpoint]:
    """The finished checkpoints below `directory`, earliest first; folders of writes that broke off do not count."""
    if not directory.is_dir():
        return []
    steps = sorted(int(child.name) for child in directory.iterdir() if re.fullmatch(r"\d{8,}", child.name))
    return [Checkpoint(directory / f"{step:08d}", step) for step in steps]


def is_stored(leaf: Any) -> bool:
    """Whether a leaf of a state belongs in the file: arrays and their stand-ins, and nothing else."""
    if isinstance(leaf, jax.Array | jax.ShapeDtypeStruct) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        raise TypeError("a learner's state must hold no random keys; update gets a fresh one at every step")
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def stored(state: Any) -> Any:
    """The part of a state that goes into the file; None elsewhere."""
    return eqx.filter(state, is_stored)


def describe(state: Any) -> list[dict[str, Any]]:
    """Path, shape and type of every stored array, in the order of the file."""
    leaves, _ = jtu.tree_flatten_with_path(stored(state))
    return [
        {"path": jtu.keystr(path), "shape": [int(size) for size in leaf.shape], "dtype": str(leaf.dtype)}
        for path, leaf in leaves
    ]


def _expect(path: Path, field: str, found: Any, expected: Any, cause: str = "") -> None:
    if found != expected:
        remedy = f"{cause} {_REMEDY}".strip()
        raise CheckpointError(f"{path}: {field}: expected {expected!r}, found {found!r}. {remedy}")


def _first_difference(expected: list[dict[str, Any]], found: Any) -> str:
    if not isinstance(found, list):
        return f"expected a list of {len(expected)} arrays, found {type(found).__name__}"
    for ours, theirs in zip(expected, found, strict=False):
        if ours != theirs:
            return f"this config makes {_words(ours)}, the checkpoint holds {_words(theirs)}"
    return f"this config makes {len(expected)} arrays, the checkpoint holds {len(found)}"


def _words(leaf: Any) -> str:
    if not isinstance(leaf, dict):
        return repr(leaf)
    return f"{leaf.get('path')} {leaf.get('dtype')}{leaf.get('shape')}"
