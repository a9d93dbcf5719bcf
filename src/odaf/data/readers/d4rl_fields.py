"""The arrays of a D4RL layout in either container: an HDF5 file, or the `.npz` file that `numpy.savez` makes of one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np

from odaf.data import storage
from odaf.data.log import Column
from odaf.data.readers import hdf5, numpy_files
from odaf.errors import DatasetError


class Hdf5Fields:
    """Arrays by their path, such as `infos/qpos`, that stay in their HDF5 file until they are sliced.

    Attributes:
        source: how messages name the file.
        names: paths of all arrays, sorted.
    """

    def __init__(self, path: str | os.PathLike[str], file: h5py.File, source: str):
        self.source, self.file = source, file
        self.names = hdf5.arrays_below(file, source)
        self._path = path

    def __contains__(self, name: str) -> bool:
        """Whether something has this name; it may be no array of numbers."""
        return name in self.file or self.file.get(name, getlink=True) is not None

    def column(self, name: str) -> Column:
        """Numbers with one entry per step; `DatasetError` where there is nothing of the kind."""
        return hdf5.column(self._path, self.file, self.source, name)

    def whole(self, name: str) -> np.ndarray:
        """The same, in memory."""
        return hdf5.whole(self.file, self.source, name)

    def kind(self, name: str) -> tuple[str, tuple[int, ...]]:
        """Kind of its type, as NumPy writes it, and its shape."""
        item = hdf5.dataset(self.file, self.source, name)
        return item.dtype.kind, item.shape

    def further(self, name: str, rows: int) -> Column | None:
        """A column to keep beside the rows; None where it is not one of numbers, or has not one entry a row."""
        kind, shape = self.kind(name)
        return self.column(name) if kind in "biuf" and shape[:1] == (rows,) else None

    def scalar(self, name: str) -> str | int | float | bool:
        """A text or a single number."""
        return hdf5.scalar(self.file, self.source, name)


class ArchiveFields:
    """The same of an `.npz` file, in memory."""

    def __init__(self, source: str, arrays: dict[str, np.ndarray]):
        self.source = source
        self.names = sorted(arrays)
        self._arrays = arrays

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def column(self, name: str) -> np.ndarray:
        return self.whole(name)

    def whole(self, name: str) -> np.ndarray:
        if name not in self._arrays:
            raise DatasetError(
                f"{self.source}: field '{name}' is missing; the file has {hdf5.shown(self.names)}: "
                "rename the column or generate the file again"
            )
        array = self._arrays[name]
        if array.dtype.kind not in "biuf" or array.ndim == 0:
            raise DatasetError(
                f"{self.source}: field '{name}' holds {array.dtype} values of shape {array.shape}, expected real "
                "numbers, one entry per step; convert the column to float32"
            )
        return array

    def further(self, name: str, rows: int) -> np.ndarray | None:
        return numpy_files.further(self._arrays[name], rows)

    def kind(self, name: str) -> tuple[str, tuple[int, ...]]:
        return self._arrays[name].dtype.kind, self._arrays[name].shape

    def scalar(self, name: str) -> str | int | float | bool:
        value: Any = self._arrays[name].item() if self._arrays[name].size == 1 else None
        if isinstance(value, bytes):
            value = value.decode(errors="replace")
        if not isinstance(value, (str, int, float, bool)):
            raise DatasetError(f"{self.source}: field '{name}' is no single text or number; generate the file again")
        return value


Fields = Hdf5Fields | ArchiveFields


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Fields]:
    """The fields of a file; those of an HDF5 file can be asked for while it is open, columns are read later too."""
    source = os.fspath(path)
    if os.path.isfile(source) and not h5py.is_hdf5(source) and _is_archive(source):
        yield ArchiveFields(source, numpy_files.read_members(path))
        return
    with storage.opened(path) as (file, source), storage.reading(source):
        yield Hdf5Fields(path, file, source)


def _is_archive(source: str) -> bool:
    with open(source, "rb") as handle:
        return handle.read(4) == b"PK\x03\x04"
