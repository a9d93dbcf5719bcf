"""Minari's Arrow and Parquet containers: a folder per episode, all columns padded to the T + 1 rows of observations."""

import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from odaf.data.readers.columns import Pieces, common_type
from odaf.data.validation import any_in_row, name_rows
from odaf.errors import DatasetError

_SUFFIXES = (".arrow", ".parquet")


class ArrowEpisodes:
    """Folders named after the number of the episode, each with one table."""

    def __init__(self, folder: Path, source: str):
        self._source = source
        self._files = episode_files(folder, source)
        self.ids = tuple(sorted(self._files))
        self._paths = tuple(self._files[number] for number in self.ids)
        _pyarrow(source)

    def leaves(self) -> list[str]:
        with _reading(self._paths[0]):
            found: list[str] = []
            for field in _table(self._paths[0]).schema:
                _list_leaves(field.name, field.type, found)
            return sorted(found)

    def column(self, leaf: str) -> Pieces:
        padding = 0 if leaf.split("/")[0] in ("observations", "infos") else 1
        shapes, kinds = [], set()
        for path in self._paths:
            with _reading(path):
                array = _leaf(path, leaf)
            shapes.append(array.shape)
            kinds.add(array.dtype)
        for path, shape in zip(self._paths, shapes, strict=True):
            if shape[1:] != shapes[0][1:]:
                raise DatasetError(
                    f"{path}: field '{leaf}' has rows of shape {shape[1:]}, the first episode's have {shapes[0][1:]}; "
                    "every episode must describe the same quantities"
                )
        lengths = np.array([max(shape[0] - padding, 0) for shape in shapes], np.int64)
        kind = common_type(self._source, leaf, kinds)
        return Pieces(functools.partial(_read, self._paths, leaf), lengths, shapes[0][1:], kind)


def episode_files(folder: Path, source: str) -> dict[int, Path]:
    """The table of each episode by its number.

    Raises:
        DatasetError: there are none, or an episode has more than one.
    """
    files: dict[int, Path] = {}
    for place in folder.iterdir() if folder.is_dir() else ():
        if not (place.is_dir() and place.name.isascii() and place.name.isdigit() and len(place.name) < 19):
            continue
        tables = sorted(entry for entry in place.iterdir() if entry.suffix in _SUFFIXES)
        if len(tables) != 1 or int(place.name) in files:
            raise DatasetError(
                f"{place}: expected one Arrow or Parquet file per episode, found {[entry.name for entry in tables]}; "
                "copy the folder again"
            )
        files[int(place.name)] = tables[0]
    if not files:
        raise DatasetError(
            f"{source}: no episodes: neither main_data.hdf5 nor folders 0, 1, ... with Arrow files; "
            "give the folder that Minari wrote"
        )
    return files


def _pyarrow(source: str) -> ModuleType:
    try:
        import pyarrow
    except ImportError as error:
        raise DatasetError(
            f'{source}: Arrow files need pyarrow, which is not installed ({error}); pip install "odaf[minari]"'
        ) from error
    return pyarrow


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turns what pyarrow raises on damaged files into `DatasetError`; wraps reads and nothing else."""
    pa = _pyarrow(str(path))
    damage = (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError, NotImplementedError)
    try:
        yield
    except (pa.ArrowException, *damage) as error:
        raise DatasetError(
            f"{path}: the file is damaged and cannot be read ({type(error).__name__}: {error}); copy it again"
        ) from error


def _table(path: Path) -> Any:
    """The Arrow table of a file; its columns are not checked yet."""
    if path.suffix == ".parquet":
        from pyarrow import parquet

        return parquet.ParquetFile(path).read()
    import pyarrow
    from pyarrow import ipc

    with pyarrow.memory_map(str(path), "rb") as handle, ipc.open_file(handle) as reader:
        return reader.read_all()


def _list_leaves(address: str, kind: Any, found: list[str]) -> None:
    fields = [kind.field(index) for index in range(kind.num_fields)] if str(kind).startswith("struct") else []
    if not fields:
        found.append(address)
    for field in fields:
        _list_leaves(f"{address}/{field.name}", field.type, found)


def _leaf(path: Path, leaf: str) -> np.ndarray:
    """[rows, ...] numbers of one column, with those of padding rows."""
    pa = _pyarrow(str(path))
    name, *entries = leaf.split("/")
    table = _table(path)
    if table.column_names.count(name) != 1:
        raise DatasetError(f"{path}: field '{name}' is missing; the file has {table.column_names}: copy it again")
    column = table.column(name)
    column.validate(full=True)  # before anything follows an offset that the file claims
    values = column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks)
    gaps = _gaps(values)
    for entry in entries:
        index = values.type.get_field_index(entry) if pa.types.is_struct(values.type) else -1
        if index < 0:
            raise DatasetError(f"{path}: field '{leaf}' is missing in this episode; copy or record it again")
        values = values.field(index)
        gaps = gaps | _gaps(values)
    shape: tuple[int, ...] = (len(values),)
    while pa.types.is_fixed_size_list(values.type):
        size, start = values.type.list_size, values.offset
        shape = (*shape, size)
        values = values.values.slice(start * size, len(values) * size)
        gaps = np.repeat(gaps, size) | _gaps(values)
    if not (pa.types.is_integer(values.type) or pa.types.is_floating(values.type) or pa.types.is_boolean(values.type)):
        raise DatasetError(
            f"{path}: field '{leaf}' holds {values.type} values, expected numbers; odaf learns from vectors of numbers"
        )
    return _with_gaps(path, leaf, values, gaps, shape)


def _gaps(values: Any) -> np.ndarray:
    """[values] bool: where nothing was written."""
    return np.asarray(values.is_null().to_numpy(zero_copy_only=False), bool)


def _with_gaps(path: Path, leaf: str, values: Any, gaps: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The numbers with NaN where there are none; flags and whole numbers, which have no NaN, are refused there."""
    if not gaps.any():
        return np.asarray(values.to_numpy(zero_copy_only=False)).reshape(shape)
    nothing = False if str(values.type) == "bool" else 0
    numbers = np.asarray(values.fill_null(nothing).to_numpy(zero_copy_only=False)).reshape(shape)
    gaps = gaps.reshape(shape)
    if numbers.dtype.kind != "f":
        raise DatasetError(
            f"{path}: field '{leaf}' lacks a value in {name_rows(any_in_row(gaps))}, and {values.type} has no NaN to "
            "say so; record the episode again, or leave it out"
        )
    return np.where(gaps, np.asarray(np.nan, numbers.dtype), numbers)


def _read(paths: tuple[Path, ...], leaf: str, wanted: Sequence[tuple[int, int, int]]) -> list[np.ndarray]:
    parts = []
    for piece, first, end in wanted:
        with _reading(paths[piece]):
            array = _leaf(paths[piece], leaf)
        if len(array) < end:
            raise DatasetError(f"{paths[piece]}: field '{leaf}' became shorter while it was read; read it again")
        parts.append(array[first:end])
    return parts
