"""Columns that lie in files and are read piece by piece, so that a log may be larger than memory.

They hold no open file: slicing one opens the file, reads, and closes it again.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.data.log import Column
from odaf.data.validation import any_in_row, name_rows
from odaf.errors import DatasetError

# Reads (number of the piece, first row, end) for each entry asked for, in that order.
Reader = Callable[[Sequence[tuple[int, int, int]]], list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Pieces:
    """Arrays of equal row shape, one after another, as one column: one array a file, or one an episode.

    Attributes:
        read: gets the rows of some pieces.
        lengths: [pieces] rows that each piece contributes.
        row_shape: shape of one row.
        dtype: of the whole column.
        skip: rows of each piece to leave out at its beginning; 1 turns T + 1 observations into T successors.
    """

    read: Reader
    lengths: np.ndarray
    row_shape: tuple[int, ...]
    dtype: Any
    skip: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self), *self.row_shape)

    def __len__(self) -> int:
        return int(self.lengths.sum())

    def __getitem__(self, key: Any) -> Any:
        if not isinstance(key, slice):
            return self[:][key]
        first, end, step = key.indices(len(self))
        if step != 1 or first >= end:
            return self[:][key] if first < end or step < 0 else np.empty((0, *self.row_shape), self.dtype)
        ends = np.cumsum(self.lengths)
        wanted, row = [], first
        for piece in range(int(np.searchsorted(ends, first, side="right")), len(ends)):
            start = int(ends[piece] - self.lengths[piece])
            stop = min(end, int(ends[piece]))
            if stop > row:
                wanted.append((piece, row - start + self.skip, stop - start + self.skip))
                row = stop
            if row == end:
                break
        parts = self.read(wanted)
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).astype(self.dtype, copy=False)


@dataclass(frozen=True, eq=False)
class Joined:
    """Several columns side by side, each row flattened: the entries of a dictionary as one vector.

    Attributes:
        parts: at least one, of equal length.
    """

    parts: tuple[Column, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self), sum(self.widths))

    @property
    def widths(self) -> tuple[int, ...]:
        """Numbers that each part contributes to a row."""
        return tuple(int(np.prod(part.shape[1:], dtype=np.int64)) for part in self.parts)

    @property
    def dtype(self) -> Any:
        return np.result_type(*(part.dtype for part in self.parts))

    def __len__(self) -> int:
        return len(self.parts[0])

    def __getitem__(self, key: Any) -> Any:
        if not isinstance(key, slice):
            return self[:][key]
        arrays = [np.asarray(part[key]) for part in self.parts]
        flat = [array.reshape(len(array), width) for array, width in zip(arrays, self.widths, strict=True)]
        return flat[0] if len(flat) == 1 else np.concatenate(flat, axis=1)


@dataclass(frozen=True, eq=False)
class Kept:
    """Some rows of a column.

    Attributes:
        column: of N rows.
        rows: [M] their numbers, ascending.
    """

    column: Column
    rows: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self), *self.column.shape[1:])

    @property
    def dtype(self) -> Any:
        return self.column.dtype

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, key: Any) -> Any:
        if not isinstance(key, slice):
            return self[:][key]
        chosen = self.rows[key]
        first, end = (int(chosen.min()), int(chosen.max()) + 1) if len(chosen) else (0, 0)
        return np.asarray(self.column[first:end])[chosen - first]


def common_type(source: str, field: str, types: Iterable[Any]) -> Any:
    """The type that holds the values of all pieces; `DatasetError` where whole numbers would lose digits in it."""
    found = {np.dtype(each) for each in types}
    common = np.result_type(*found)
    wide = sorted(str(each) for each in found if each.kind in "iu" and each.itemsize > 4)
    if common.kind == "f" and wide:
        raise DatasetError(
            f"{source}: field '{field}' holds {' and '.join(sorted(map(str, found)))} values in different pieces; "
            f"whole numbers of {wide[0]} would lose digits beside the others: store all pieces in one type"
        )
    return common


def sound_flags(source: str, field: str, array: np.ndarray) -> np.ndarray:
    """`array` itself; `DatasetError` where a damaged file put other bytes than 0 and 1 into flags.

    NumPy trusts that a bool is one byte of 0 or 1, and sums of other bytes come out wrong.
    """
    if array.dtype == bool and array.size:
        odd = np.ascontiguousarray(array).view(np.uint8) > 1
        if odd.any():
            raise DatasetError(
                f"{source}: field '{field}' holds flags that are neither true nor false in "
                f"{name_rows(any_in_row(np.atleast_1d(odd)))}; the file is damaged: copy or generate it again"
            )
    return array
