"""Our own file format: HDF5 with a version and a checksum, written atomically, read without running code.

Layout, version 1: root attributes `format` = "odaf-dataset", `version` = 1, `sha256`; one data set per array of
`Dataset` under its own name; `infos/NAME` for each further column; and `metadata`, a JSON text with the names and units
of the columns and the provenance. Version 2 adds `mixture` to that text; data without one are written as version 1, for
readers that know of no mixtures and would draw all rows evenly. Version 3 holds the columns of `HALVED` in half
precision; its numbers are those of a data set that was rounded before (`odaf.data.half_precision`). The checksum covers
names, types, shapes and bytes of all arrays, as learners see them, and the metadata, not the HDF5 packing around them.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from odaf.data import fingerprint, writing
from odaf.data.fingerprint import FIELDS, TEXTS
from odaf.data.log import Log
from odaf.data.mixture import Mixture
from odaf.data.progress import Counter, Progress
from odaf.data.rows import Rows
from odaf.errors import DatasetError

FORMAT = "odaf-dataset"
VERSION = 3
# What a file of half precision holds in two bytes a number.
HALVED = ("observations", "actions", "rewards", "next_observations")


def write(dataset: Rows, path: str | os.PathLike[str], progress: Progress | None = None, half: bool = False) -> None:
    """Writes `dataset` to `path` through a temporary file beside it that is renamed when complete.

    Args:
        dataset: the data.
        path: the file.
        progress: told how far it has come, in bytes summed and bytes written.
        half: whether its columns are written in half precision, which must hold each of their numbers.

    Raises:
        DatasetError: the folder does not exist or cannot be written to.
    """
    arrays, text = fingerprint.arrays_of(dataset), fingerprint.metadata(dataset)
    counter = Counter(2 * sum(array.nbytes for array in arrays.values()), progress)
    # The library version sets a layout whose own bookkeeping is checksummed, so damage there is noticed too.
    with replacing(path) as partial, h5py.File(partial, "w", libver=("v110", "v110")) as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = 3 if half else 1 if dataset.mixture is None else 2
        file.attrs["sha256"] = fingerprint.checksum(arrays, text, counter.add)
        for name, array in arrays.items():
            dtype = np.dtype("<f2") if half and name in HALVED else fingerprint.stored_dtype(name, array)
            item = file.create_dataset(name, array.shape, dtype)
            rows = max(1, fingerprint.PIECE * len(array) // max(array.nbytes, 1))
            for first in range(0, len(array), rows):
                piece = array[first : first + rows]
                item[first : first + rows] = piece.astype(dtype, copy=False)
                counter.add(piece.nbytes)
        file.create_dataset("metadata", data=text)


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A place beside `path` to write a file to; it takes the place of `path` when the block ends without an error.

    Raises:
        DatasetError: the folder does not exist or cannot be written to.
    """
    try:
        with writing.replacing(path) as partial:
            yield partial
    except OSError as error:
        raise DatasetError(
            f"{os.fspath(path)}: cannot be written ({error}); choose a folder that exists and is writable"
        ) from error


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[tuple[h5py.File, str]]:
    """An HDF5 file open for reading and the name that messages use for it.

    Raises:
        DatasetError: there is no such file, it is not HDF5, it is cut short, or a read from it fails.
    """
    source = os.fspath(path)
    if not os.path.exists(source):
        raise DatasetError(f"{source}: there is no such file; check the path, or make the data first")
    if os.path.isdir(source):
        raise DatasetError(f"{source}: is a folder; name the HDF5 file inside it")
    size = os.path.getsize(source)
    try:
        if size == 0:
            raise DatasetError(f"{source}: the file is empty; copy or generate it again")
        if not h5py.is_hdf5(source):
            raise DatasetError(
                f"{source}: not an HDF5 file (its first bytes are {_first_bytes(source)!r}); "
                "give a file written by odaf or in the D4RL layout"
            )
        file = h5py.File(source, "r")
    except OSError as error:
        if "truncated" in str(error):
            raise DatasetError(f"{source}: the file is cut short at {size:,} bytes ({error}); copy it again") from error
        raise DatasetError(f"{source}: cannot be opened ({error}); copy it again or check its permissions") from error
    with file:
        yield file, source


@contextlib.contextmanager
def reading(source: str) -> Iterator[None]:
    """Turns what the HDF5 library raises on damaged files into `DatasetError`; wraps reads and nothing else."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise DatasetError(
            f"{source}: the file is damaged and cannot be read ({type(error).__name__}: {error}); "
            "copy or generate it again"
        ) from error


def is_own(file: h5py.File, source: str) -> bool:
    """Whether the file claims to be an odaf dataset; another claim than ours or none at all raises or is False."""
    from odaf.data.readers import text_heap

    with reading(source):
        if "format" not in file.attrs:
            return False
        text_heap.refuse_endless(file.filename, source)
        claim = file.attrs.get("format")
    if not isinstance(claim, str) or claim != FORMAT:
        raise DatasetError(
            f"{source}: the file says its format is {claim!r}, expected {FORMAT!r}; "
            "give a dataset, not another kind of file"
        )
    return True


def is_own_file(path: str | os.PathLike[str]) -> bool:
    """Whether there is an HDF5 file that claims to be an odaf dataset; never raises on what is no HDF5 file."""
    if not os.path.isfile(path) or not h5py.is_hdf5(path):
        return False
    with opened(path) as (file, source):
        return is_own(file, source)


def read(file: h5py.File, source: str, progress: Progress | None = None) -> dict[str, Any]:
    """The fields of the `Dataset` in an open file of our own format, as its constructor takes them.

    Args:
        file: the open file.
        source: how messages name it.
        progress: told how far it has come, in bytes read and bytes summed.

    Raises:
        DatasetError: a newer version, a missing or odd field, or a wrong checksum.
    """
    stored = _stored_checksum(file, source)
    with reading(source):
        infos = [f"infos/{name}" for name in _info_names(file, source)]
        for name in FIELDS:
            require_field(file, source, name)
        counter = Counter(2 * sum(array_item(file, source, name).nbytes for name in (*FIELDS, *infos)), progress)
        arrays: dict[str, np.ndarray] = {}
        for name in (*FIELDS, *infos):
            arrays[name] = _widened(name, read_array(file, source, name))
            if name in FIELDS:
                _require_type(source, name, arrays[name], *FIELDS[name])
            counter.add(arrays[name].nbytes)
        text = _metadata_text(file, source)
    names, provenance = _verified(source, arrays, text, stored, counter.add)
    for array in arrays.values():
        array.setflags(write=False)  # nobody else holds them, so the dataset may keep them uncopied
    own = {name: arrays[name] for name in FIELDS}
    extra = {name.removeprefix("infos/"): arrays[name] for name in infos}
    return {**own, **names, "infos": extra, "provenance": provenance}


def open_log(path: str | os.PathLike[str]) -> Log:
    """The rows of a file of our own format, memory-mapped: only what is looked at is read.

    The checksum is compared in one pass over the file, whose pages need not stay in memory.

    Raises:
        DatasetError: as `read`, but for the rows, which nobody has looked at yet.
    """
    with opened(path) as (file, source):
        if not is_own(file, source):
            raise DatasetError(f"{source}: no attribute 'format', so this is no odaf dataset; name its layout")
        stored = _stored_checksum(file, source)
        with reading(source):
            arrays = {name: _widened(name, _mapped(file, source, name)) for name in FIELDS}
            for name, (dtype, axes) in FIELDS.items():
                _require_type(source, name, arrays[name], dtype, axes)
            arrays |= {f"infos/{name}": _mapped(file, source, f"infos/{name}") for name in _info_names(file, source)}
            text = _metadata_text(file, source)
    names, provenance = _verified(source, arrays, text, stored)
    rows = len(arrays["observations"])
    starts = arrays["episode_starts"]
    return Log(
        columns={
            **{name: arrays[name] for name in ("observations", "actions", "rewards", "next_observations")},
            **{name: arrays[name] for name in ("terminated", "truncated")},
            "episode": EpisodeNumbers(starts, rows),
        },
        source=source,
        format="odaf",
        action_bounds=(np.array(arrays["action_low"]), np.array(arrays["action_high"])),
        infos={name.removeprefix("infos/"): arrays[name] for name in arrays if name not in FIELDS},
        provenance=provenance,
        findings=tuple(provenance.get("findings", ())),
        **names,
    )


def _widened(name: str, array: np.ndarray) -> np.ndarray:
    """A column as learners see it: in single precision, if the file holds it in half."""
    return array.astype(np.float32) if name in HALVED and array.dtype == np.dtype("<f2") else array


class EpisodeNumbers:
    """The number of each row's episode, computed where it is looked at."""

    def __init__(self, starts: np.ndarray, rows: int):
        self._starts = starts
        self.shape = (rows,)
        self.dtype = np.dtype(np.int64)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any, /) -> np.ndarray:
        rows = np.arange(*key.indices(len(self))) if isinstance(key, slice) else np.asarray(key)
        return np.searchsorted(self._starts, rows, side="right") - 1


def _stored_checksum(file: h5py.File, source: str) -> str:
    """The checksum that the file claims, once its version is one that can be read."""
    with reading(source):
        version, stored = file.attrs.get("version"), file.attrs.get("sha256")
    if not isinstance(version, (int, np.integer)) or version < 1:
        raise DatasetError(
            f"{source}: attribute 'version' is {version!r}, expected a whole number; the file is damaged: copy it again"
        )
    if version > VERSION:
        raise DatasetError(
            f"{source}: written in version {version} of the format, this odaf reads up to {VERSION}; upgrade odaf"
        )
    if not isinstance(stored, str):
        raise DatasetError(f"{source}: attribute 'sha256' is missing, so damage could not be noticed; copy it again")
    return stored


def _verified(
    source: str,
    arrays: Mapping[str, np.ndarray],
    text: str,
    stored: str,
    advance: Callable[[int], None] | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Names and units of the columns with the mixture, and the provenance, once lengths and checksum agree."""
    rows = len(arrays["observations"])
    for name in ("actions", "rewards", "next_observations", "terminated", "truncated"):
        if len(arrays[name]) != rows:
            raise DatasetError(
                f"{source}: field '{name}' has {len(arrays[name]):,} rows, 'observations' has {rows:,}; "
                "the file was edited or mixed from two: generate it again"
            )
    found = fingerprint.checksum(arrays, text, advance)
    if found != stored:
        raise DatasetError(
            f"{source}: the contents do not match their checksum (stored {stored[:12]}..., found {found[:12]}...); "
            "the file was damaged or edited after it was written: copy or generate it again"
        )
    try:
        content = json.loads(text)
        names: dict[str, Any] = {field: tuple(content[field]) for field in TEXTS}
        if "mixture" in content:
            names["mixture"] = Mixture.from_dict(content["mixture"])
        return names, dict(content["provenance"])
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            f"{source}: field 'metadata' cannot be read ({type(error).__name__}: {error}); generate the file again"
        ) from error


def read_array(file: h5py.File, source: str, name: str) -> np.ndarray:
    """One whole data set, for use inside `reading`; `DatasetError` where it is no array or lies in another file."""
    return np.asarray(array_item(file, source, name)[()])


def array_item(file: h5py.File, source: str, name: str) -> h5py.Dataset:
    """A data set that is not read yet, for use inside `reading`; errors as `read_array`."""
    link = file.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise DatasetError(f"{source}: field '{name}' is a link to another place; write the data into the file itself")
    item = file[name]
    if not isinstance(item, h5py.Dataset):
        raise DatasetError(f"{source}: field '{name}' is a {type(item).__name__.lower()}, expected an array")
    if item.is_virtual or item.external:
        raise DatasetError(f"{source}: field '{name}' is stored in another file; write the data into the file itself")
    if item.shape is None:
        raise DatasetError(f"{source}: field '{name}' is empty; generate the file again")
    return item


def require_field(file: h5py.File, source: str, name: str) -> None:
    """Raises `DatasetError`, listing what is there, unless the file has something called `name` at its root."""
    if name not in file and file.get(name, getlink=True) is None:
        raise DatasetError(
            f"{source}: field '{name}' is missing; the file has {sorted(file.keys())}: "
            "rename the column or generate the file again"
        )


def _mapped(file: h5py.File, source: str, name: str) -> np.ndarray:
    """One whole data set as a read-only memory map; read where it lies in pieces or holds nothing."""
    require_field(file, source, name)
    item = array_item(file, source, name)
    offset = item.id.get_offset()
    if offset is None or item.chunks is not None or item.size == 0 or item.dtype.kind not in "biuf":
        return read_array(file, source, name)
    return np.memmap(file.filename, item.dtype, "r", offset, item.shape)


def _require_type(source: str, name: str, array: np.ndarray, dtype: str, axes: int) -> None:
    if array.dtype != np.dtype(dtype):
        raise DatasetError(
            f"{source}: field '{name}' holds {array.dtype}, expected {np.dtype(dtype)}; "
            "generate the file again with odaf"
        )
    if array.ndim != axes:
        raise DatasetError(
            f"{source}: field '{name}' has shape {array.shape}, expected {axes} axes; generate the file again with odaf"
        )


def _info_names(file: h5py.File, source: str) -> list[str]:
    if "infos" not in file:
        return []
    group = file["infos"]
    if not isinstance(group, h5py.Group):
        raise DatasetError(f"{source}: field 'infos' is no group of columns; generate the file again with odaf")
    return sorted(group.keys())


def _metadata_text(file: h5py.File, source: str) -> str:
    require_field(file, source, "metadata")
    value = read_array(file, source, "metadata")
    raw = value.item() if value.ndim == 0 else None
    if not isinstance(raw, (bytes, str)):
        raise DatasetError(f"{source}: field 'metadata' must be one JSON text; generate the file again with odaf")
    try:
        return raw.decode() if isinstance(raw, bytes) else raw
    except UnicodeDecodeError as error:
        raise DatasetError(f"{source}: field 'metadata' is not UTF-8 text ({error}); copy the file again") from error


def _first_bytes(path: str) -> bytes:
    with open(path, "rb") as handle:
        return handle.read(8)
