"""Repeats found by hashes in bounded memory."""

import numpy as np

from odaf.data.checks.hashing import BoundedHashes, hash_ids, hash_rows


def test_repeats_are_exact_below_the_limit():
    rng = np.random.default_rng(0)
    values = rng.integers(0, 400, 1_000)
    seen = BoundedHashes(limit=2_000)
    for first in range(0, 1_000, 130):
        piece = values[first : first + 130]
        seen.add(hash_ids(piece), np.arange(first, first + len(piece)))
    _, firsts = np.unique(values, return_index=True)
    again = np.setdiff1d(np.arange(1_000), firsts)
    found = seen.repeated()
    assert (found.count, found.rows, found.estimated) == (len(again), tuple(again[:5].tolist()), False)


def test_above_the_limit_the_number_is_estimated_and_memory_stays():
    rng = np.random.default_rng(1)
    rows = np.arange(200_000)
    values = rng.normal(size=(200_000, 3))
    copies = rng.choice(200_000, 20_000, replace=False)
    copies = copies[copies > 0]
    values[copies] = values[copies - 1]  # a tenth repeats the row before it
    seen = BoundedHashes(limit=4_096)
    for first in range(0, 200_000, 10_000):
        seen.add(hash_rows([values[first : first + 10_000]]), rows[first : first + 10_000])
        assert seen._kept <= 4_096
    found = seen.repeated()
    assert found.estimated
    # Of some 4,000 kept entries a tenth are repeats: 6 % standard error, so 25 % is missed once in ten thousand.
    assert abs(found.count - 20_000) < 5_000
    assert set(found.rows) <= set(copies.tolist())


def test_hashes_tell_small_whole_numbers_apart():
    """Floats such as 1, 2, 4 differ in few bits only, and in the upper ones."""
    grid = np.stack(np.meshgrid(*[np.arange(12.0)] * 4), axis=-1).reshape(-1, 4)
    for dtype in (np.float32, np.float64, np.int16, np.bool_):
        entries = np.unique(grid.astype(dtype), axis=0)
        assert len(np.unique(hash_rows([entries]))) == len(entries)


def test_hashes_depend_on_the_order_of_columns():
    row = np.array([[1.0, 2.0]])
    assert hash_rows([row]) != hash_rows([row[:, ::-1]])


def test_texts():
    hashes = hash_ids(np.array(["a", "b", "a"]))
    assert hashes[0] == hashes[2] != hashes[1]
