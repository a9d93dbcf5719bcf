"""Arrays in HDF5 files that others wrote: which of them may be read, and how.

An array is read only if it lies in the file itself, holds numbers, and can be as large as it says: a damaged shape must
not make us reserve more memory than there is. For use inside `storage.reading`, which explains what the library raises.
"""

import functools
import math
import os
from collections.abc import Iterable, Sequence
from typing import Any

import h5py
import numpy as np

from odaf.data import storage
from odaf.data.log import Column
from odaf.data.readers import text_heap
from odaf.data.readers.columns import Pieces, common_type, sound_flags
from odaf.data.validation import any_in_row, name_rows
from odaf.errors import DatasetError

# gzip packs at most 1,032 bytes into one. Small files may say what they like: the harm is small too.
_PACKING = 1_100
_HARMLESS = 2**24


def dataset(file: h5py.File, source: str, name: str) -> h5py.Dataset:
    """The array at a path inside the file, checked but not yet read.

    Raises:
        DatasetError: there is no array, it lies elsewhere, holds no numbers, or has a size that cannot be true.
    """
    place: h5py.HLObject = file
    for part in name.split("/"):
        if not isinstance(place, h5py.Group) or (link := place.get(part, getlink=True)) is None:
            raise DatasetError(
                f"{source}: field '{name}' is missing; the file has {shown(keys(file))}: "
                "rename the column or generate the file again"
            )
        if not isinstance(link, h5py.HardLink):
            raise DatasetError(
                f"{source}: field '{name}' is a link to another place; write the data into the file itself"
            )
        place = place[part]
    if not isinstance(place, h5py.Dataset):
        raise DatasetError(f"{source}: field '{name}' is a {type(place).__name__.lower()}, expected an array")
    if place.is_virtual or place.external:
        raise DatasetError(f"{source}: field '{name}' is stored in another file; write the data into the file itself")
    if place.shape is None:
        raise DatasetError(f"{source}: field '{name}' is empty; generate the file again")
    _refuse_impossible_size(file, source, name, place)
    return place


def numbers(file: h5py.File, source: str, name: str) -> h5py.Dataset:
    """The array at a path, which holds real numbers or flags, one entry per row."""
    found = dataset(file, source, name)
    if found.dtype.kind not in "biuf":
        kind = "text or objects" if found.dtype.kind == "O" else f"{found.dtype} values"
        raise DatasetError(f"{source}: field '{name}' holds {kind}, not real numbers; convert the column to float32")
    if not found.shape:
        raise DatasetError(f"{source}: field '{name}' is one number, expected one entry per step")
    if _number_beside(found, "scale_factor", 1.0) != 1.0 or _number_beside(found, "add_offset", 0.0) != 0.0:
        raise DatasetError(
            f"{source}: field '{name}' holds packed numbers, to be multiplied by its attribute 'scale_factor' and "
            "added to 'add_offset'; unpack them where the file was made, for instance with xarray, and store the result"
        )
    return found


def whole(file: h5py.File, source: str, name: str) -> np.ndarray:
    """All rows of an array of numbers."""
    found = numbers(file, source, name)
    return _with_gaps(source, name, found, sound_flags(source, name, np.asarray(found[()])))


def scalar(file: h5py.File, source: str, name: str) -> str | int | float | bool:
    """A text or a single number at a path."""
    found = dataset(file, source, name)
    value = None
    if math.prod(found.shape) == 1:
        variable = found.dtype.kind == "O"
        value = text_heap.read(file, source, name, found) if variable else np.asarray(found[()]).item()
    if isinstance(value, bytes):
        value = value.decode(errors="replace")
    if not isinstance(value, (str, int, float, bool)):
        raise DatasetError(f"{source}: field '{name}' is no single text or number; generate the file again")
    return value


def keys(group: h5py.Group) -> list[str]:
    """Names in a group. Those that are no UTF-8 text, which a damaged file may have, come with marks in their place."""
    return [_text(name) for name in group]


def column(path: str | os.PathLike[str], file: h5py.File, source: str, name: str) -> Column:
    """An array of numbers that is read piece by piece."""
    return pieces(path, file, source, [name])


def pieces(
    path: str | os.PathLike[str],
    file: h5py.File,
    source: str,
    names: Sequence[str],
    lengths: Sequence[int] | np.ndarray | None = None,
    skip: int = 0,
) -> Pieces:
    """Arrays of equal row shape as one column that is read piece by piece.

    Args:
        path: of `file`, which is opened again at each read.
        file: open now.
        source: how messages name it.
        names: paths inside the file, in order; at least one.
        lengths: rows that each contributes; None takes all of them.
        skip: rows to leave out at the beginning of each.
    """
    found = [numbers(file, source, name) for name in names]
    shape = found[0].shape[1:]
    for name, item in zip(names, found, strict=True):
        if item.shape[1:] != shape:
            raise DatasetError(
                f"{source}: field '{name}' has rows of shape {item.shape[1:]}, '{names[0]}' has {shape}; "
                "every episode must describe the same quantities"
            )
    return Pieces(
        functools.partial(_read, os.fspath(path), tuple(names)),
        np.array([len(item) for item in found] if lengths is None else lengths, np.int64),
        shape,
        common_type(source, names[0], (item.dtype for item in found)),
        skip,
    )


def arrays_below(file: h5py.File, source: str, name: str = "") -> list[str]:
    """Paths of all arrays in a group and its groups, sorted; links are not followed."""
    place: h5py.HLObject = file
    for part in name.split("/") if name else ():
        if not isinstance(place, h5py.Group) or not isinstance(place.get(part, getlink=True), h5py.HardLink):
            return []
        place = place[part]
    if not isinstance(place, h5py.Group):
        return []
    paths: list[str] = []
    place.visititems(lambda path, item: paths.append(_text(path)) if isinstance(item, h5py.Dataset) else None)
    return sorted(f"{name}/{path}" if name else path for path in paths)


def shown(texts: Iterable[str], limit: int = 12) -> str:
    """A sorted list for a message, cut where it grows long."""
    ordered = sorted(texts)
    return str(ordered) if len(ordered) <= limit else f"{ordered[:limit]} and {len(ordered) - limit:,} more"


def _text(name: object) -> str:
    return name.decode(errors="replace") if isinstance(name, bytes) else str(name)


def _read(path: str, names: tuple[str, ...], wanted: Sequence[tuple[int, int, int]]) -> list[np.ndarray]:
    with storage.opened(path) as (file, source), storage.reading(source):
        parts = []
        for piece, first, end in wanted:
            item = numbers(file, source, names[piece])
            if len(item) < end:
                raise DatasetError(f"{source}: field '{names[piece]}' became shorter while it was read; read it again")
            part = sound_flags(source, names[piece], np.asarray(item[first:end]))
            parts.append(_with_gaps(source, names[piece], item, part, first))
        return parts


def _number_beside(item: h5py.Dataset, name: str, default: float) -> Any:
    """A single number among an array's attributes."""
    if name not in item.attrs:
        return default
    kind = item.attrs.get_id(name)
    if kind.dtype.kind not in "biuf" or math.prod(kind.shape) != 1:
        return default
    return np.asarray(item.attrs[name]).reshape(-1)[0]


def _with_gaps(source: str, name: str, item: h5py.Dataset, array: np.ndarray, first: int = 0) -> np.ndarray:
    """The array with NaN where the file says that nothing was written, as netCDF's attributes do.

    Raises:
        DatasetError: there are such places among whole numbers or flags, which have no NaN.
    """
    for attribute in ("_FillValue", "missing_value"):
        fill = _number_beside(item, attribute, math.nan)
        gaps = array == fill
        if not gaps.any():
            continue
        if array.dtype.kind != "f":
            rows = range(first, first + len(gaps)) if gaps.ndim else None
            raise DatasetError(
                f"{source}: field '{name}' lacks a value in {name_rows(any_in_row(np.atleast_1d(gaps)), rows)}, "
                f"where it holds {fill}, its attribute '{attribute}'; store numbers with NaN, or leave out these rows"
            )
        array = np.where(gaps, np.asarray(np.nan, array.dtype), array)
    return array


def _refuse_impossible_size(file: h5py.File, source: str, name: str, item: h5py.Dataset) -> None:
    if item.dtype.kind == "O":
        if math.prod(item.shape) > _HARMLESS:
            raise DatasetError(
                f"{source}: field '{name}' holds {math.prod(item.shape):,} texts or objects; convert it to numbers"
            )
        return
    size = math.prod(item.shape) * item.dtype.itemsize
    if size == 0:
        return
    available, stored = file.id.get_filesize(), item.id.get_storage_size()
    remedy = "the file is damaged, or its writer was stopped: copy or generate it again"
    if stored > available:
        raise DatasetError(
            f"{source}: field '{name}' claims {stored:,} bytes of a file of {available:,} bytes; {remedy}"
        )
    if item.chunks is None:
        if stored < size:
            raise DatasetError(
                f"{source}: field '{name}' has shape {item.shape}, {size:,} bytes, but {stored:,} are there; {remedy}"
            )
        return
    chunk = math.prod(item.chunks) * item.dtype.itemsize
    if max(size, chunk) > max(_HARMLESS, _PACKING * stored):
        raise DatasetError(
            f"{source}: field '{name}' has shape {item.shape} in pieces of {item.chunks}, which cannot be packed into "
            f"the {stored:,} bytes it takes; {remedy}"
        )
    expected = math.prod(-(-rows // part) for rows, part in zip(item.shape, item.chunks, strict=True))
    written = item.id.get_num_chunks()
    if written < expected:
        raise DatasetError(
            f"{source}: field '{name}' misses {expected - written:,} of the {expected:,} pieces of shape {item.chunks} "
            f"it consists of, and nothing says what was in them; {remedy}"
        )
