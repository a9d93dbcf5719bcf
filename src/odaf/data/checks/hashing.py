"""Equal things told by equal hashes, in a memory that does not grow with their number."""

from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from odaf.data.checks.findings import SHOWN_ROWS

LIMIT = 2_000_000
"""Hashes kept at once, 16 bytes each; up to this many different entries are compared exactly."""

_MULTIPLIERS = np.random.default_rng(20_240_229).integers(1, 2**63, 4_096, dtype=np.uint64) * np.uint64(2) + np.uint64(
    1
)


@dataclass(frozen=True)
class Repeated:
    """Entries that are equal to an earlier one.

    Attributes:
        count: how many.
        rows: the first of them.
        estimated: whether only a share of the entries was kept and `count` was scaled up.
    """

    count: int
    rows: tuple[int, ...]
    estimated: bool


class BoundedHashes:
    """Finds repeats among hashes. Where there are too many, it keeps those whose last bits are zero.

    All entries that are equal have one hash, so they are kept or left out together: the share of repeats among the kept
    ones estimates the share among all.
    """

    def __init__(self, limit: int = LIMIT):
        self._limit = limit
        self._level = 0
        self._hashes: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._kept = 0

    def add(self, hashes: np.ndarray, rows: np.ndarray) -> None:
        """Takes in [n] uint64 hashes and the rows they stand for."""
        if self._level:
            chosen = hashes & np.uint64(2**self._level - 1) == 0
            hashes, rows = hashes[chosen], rows[chosen]
        self._hashes.append(hashes)
        self._rows.append(rows.astype(np.int64))
        self._kept += len(hashes)
        while self._kept > self._limit and self._level < 60:
            self._level += 1
            kept = [hashes & np.uint64(2**self._level - 1) == 0 for hashes in self._hashes]
            self._hashes = [hashes[chosen] for hashes, chosen in zip(self._hashes, kept, strict=True)]
            self._rows = [rows[chosen] for rows, chosen in zip(self._rows, kept, strict=True)]
            self._kept = sum(map(len, self._hashes))

    def repeated(self) -> Repeated:
        """Entries after the first with the same hash."""
        if not self._kept:
            return Repeated(0, (), False)
        hashes, rows = np.concatenate(self._hashes), np.concatenate(self._rows)
        order = np.argsort(hashes, kind="stable")  # rows ascend, so the first of equals stays first
        ordered = hashes[order]
        again = np.sort(rows[order[1:][ordered[1:] == ordered[:-1]]])
        return Repeated(
            len(again) * 2**self._level, tuple(again[:SHOWN_ROWS].tolist()), self._level > 0 and len(again) > 0
        )


def hash_rows(columns: list[np.ndarray]) -> np.ndarray:
    """[rows] uint64: one hash over the bytes of each row of all columns, [rows] or [rows, n] each."""
    total = np.zeros(len(columns[0]), np.uint64)
    place = 0
    for column in columns:
        words = _words(column)
        width = words.shape[1]
        factors = np.resize(_MULTIPLIERS, place + width)[place:]
        place += width
        # Sums of products with random odd factors; the words are mixed first, because floats often end in zeros.
        for index in range(width):
            word = words[:, index]
            total += (word ^ (word >> np.uint32(15))).astype(np.uint64) * factors[index]
    return mix(total)


def hash_ids(ids: np.ndarray) -> np.ndarray:
    """[n] uint64 of numbers or texts."""
    if ids.dtype.kind in "biufM":
        if ids.dtype.kind == "M":
            ids = ids.astype(np.int64)
        return hash_rows([ids])
    digests = [blake2b(str(entry).encode(), digest_size=8).digest() for entry in ids]
    return np.frombuffer(b"".join(digests), np.uint64)


def mix(values: np.ndarray) -> np.ndarray:
    """Each bit of the result depends on every bit of its number (the final steps of MurmurHash3)."""
    with np.errstate(over="ignore"):
        values = values ^ (values >> np.uint64(33))
        values = values * np.uint64(0xFF51AFD7ED558CCD)
        values = values ^ (values >> np.uint64(33))
        values = values * np.uint64(0xC4CEB9FE1A85EC53)
        return values ^ (values >> np.uint64(33))


def _words(column: np.ndarray) -> np.ndarray:
    """[rows, n] uint32 views of the bytes."""
    values = column if column.ndim == 2 else column[:, None]
    if values.dtype.itemsize % 4 or not values.dtype.isnative:
        values = values.astype(np.float32 if values.dtype.itemsize < 4 else np.float64)
    return np.ascontiguousarray(values).view(np.uint32)
