"""Arrays in `.npy` and `.npz` files of others, read without unpickling and without trusting their claims of size."""

import contextlib
import math
import os
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.lib import format as npy

from odaf.data.readers.columns import sound_flags
from odaf.errors import DatasetError

_PACKING = 1_100  # deflate packs at most 1,032 bytes into one
_SLACK = 2**16


@contextlib.contextmanager
def reading(source: str) -> Iterator[None]:
    """Turns what zip and NumPy raise on damaged files into `DatasetError`; wraps reads and nothing else.

    Their decoders raise more than a dozen kinds of exception on bad bytes, hence the wide net.
    """
    try:
        yield
    except DatasetError:
        raise
    except Exception as error:
        raise DatasetError(
            f"{source}: the file is damaged and cannot be read ({type(error).__name__}: {error}); "
            "copy or generate it again"
        ) from error


def member_names(path: str | os.PathLike[str]) -> list[str]:
    """Names of all files in a zip archive, sorted."""
    with reading(os.fspath(path)), zipfile.ZipFile(path) as archive:
        return sorted(archive.namelist())


def read_members(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """All arrays of an `.npz` file by name.

    Raises:
        DatasetError: an array holds Python objects, claims an impossible size, or cannot be decoded.
    """
    source = os.fspath(path)
    arrays: dict[str, np.ndarray] = {}
    with reading(source), zipfile.ZipFile(path) as archive:
        length = os.path.getsize(source)
        for info in archive.infolist():
            if not info.filename.endswith(".npy"):
                continue
            name = info.filename.removesuffix(".npy")
            if info.file_size > _SLACK + _PACKING * min(info.compress_size, length):
                raise DatasetError(
                    f"{source}: field '{name}' claims {info.file_size:,} bytes, which cannot be packed into "
                    f"{info.compress_size:,}; the file is damaged: copy or generate it again"
                )
            with archive.open(info) as handle:
                arrays[name] = _array(handle, source, name, info.file_size)
    return arrays


def read_single(path: str | os.PathLike[str]) -> np.ndarray:
    """The array of an `.npy` file.

    Raises:
        DatasetError: as `read_members`; also when there is no such file.
    """
    source = os.fspath(path)
    if not os.path.isfile(source):
        raise DatasetError(f"{source}: there is no such file; check the path")
    with reading(source), open(source, "rb") as handle:
        return _array(handle, source, "array", os.path.getsize(source))


def further(array: np.ndarray, rows: int) -> np.ndarray | None:
    """A column to keep beside the rows: its numbers, or dates and durations counted in their own resolution; None where
    it is something else, has not one entry a row, or lacks a date, which no whole number can say."""
    if array.shape[:1] != (rows,):
        return None
    if array.dtype.kind in "mM" and not np.isnat(array).any() and np.datetime_data(array.dtype)[0] != "generic":
        return array.astype(array.dtype.newbyteorder("=")).view(np.int64)
    return array if array.dtype.kind in "biuf" else None


def holds_objects(path: str | os.PathLike[str]) -> bool:
    """Whether an `.npy` file holds pickled Python objects; read from its heading alone."""
    with reading(os.fspath(path)), open(path, "rb") as handle:
        return _heading(handle)[1].hasobject


def _heading(handle: Any) -> tuple[tuple[int, ...], np.dtype]:
    version = npy.read_magic(handle)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(handle)
    return shape, dtype


def _array(handle: Any, source: str, name: str, size: int) -> np.ndarray:
    shape, dtype = _heading(handle)
    if dtype.hasobject:
        raise DatasetError(
            f"{source}: field '{name}' holds Python objects, which are pickled; loading them would run code from the "
            "file. Store numbers: save a numeric array, one row per step"
        )
    if any(edge < 0 for edge in shape) or math.prod(shape) * dtype.itemsize > size:
        raise DatasetError(
            f"{source}: field '{name}' claims shape {shape} of {dtype}, more than the {size:,} bytes it has; "
            "the file is damaged: copy or generate it again"
        )
    handle.seek(0)
    return sound_flags(source, name, npy.read_array(handle, allow_pickle=False))
