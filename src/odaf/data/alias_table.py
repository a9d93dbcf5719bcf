"""Tables from which a row is drawn by its weight in two look-ups, however many rows there are.

A search for a random number among sums of weights, as `jax.random.choice` does it, draws no more rows than float32 has
such numbers, 2^23: of ten million rows about every sixth never comes. A table of aliases needs no sum. Each row has a
cell of the size of the mean weight; what a heavy row has too much fills the cells of light ones. A draw takes a cell,
all equally likely, and from it the row itself or the one that fills the rest.
"""

import numpy as np
from jaxtyping import Float, Int, UInt32

CELL = 2**32
"""The size of a cell, in units: what an unsigned 32-bit random number is compared within."""


def units_of(weights: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
    """The weights as whole units that sum to `CELL` for each row, each rounded up or down; equal weights without loss.

    Args:
        weights: finite, not negative, not all 0.
    """
    total = len(weights) * CELL
    exact = weights / weights.sum() * total
    units = np.floor(exact).astype(np.int64)
    lost = np.floor(np.cumsum(exact - units)).astype(np.int64)
    units += np.diff(lost, prepend=0)  # what was rounded off, in whole units along the rows
    units[np.argmax(units)] += total - int(units.sum())  # the rounding of these sums themselves: a few units
    return units


def alias_table(
    units: Int[np.ndarray, " rows"],
) -> tuple[UInt32[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """(units of its own cell that each row keeps, the row that has the rest of it), exact in whole numbers.

    A full cell keeps 0, and its rest is its own row too.

    Args:
        units: of `units_of`.

    Source:
        Walker (1977), built by the sweep of Hübschle-Schneider and Sanders (2022): light rows are filled in order by
        the first heavy row that has something left; one that gives away too much is filled by the next heavy row.
    """
    rows = len(units)
    kept, alias = np.minimum(units, CELL), np.arange(rows, dtype=np.int32)
    light, heavy = np.flatnonzero(units < CELL), np.flatnonzero(units > CELL)
    if len(heavy):
        wanted, offered = np.cumsum(CELL - units[light]), np.cumsum(units[heavy] - CELL)
        before = wanted - (CELL - units[light])
        alias[light] = heavy[np.searchsorted(offered, before, side="right")]
        last = np.searchsorted(wanted, offered, side="left")  # the light row that uses up each heavy one
        kept[heavy] = CELL - (wanted[last] - offered)
        open_ = heavy[:-1][kept[heavy[:-1]] < CELL]
        alias[open_] = heavy[np.searchsorted(heavy, open_) + 1]
    return kept.astype(np.uint32), alias  # a full cell wraps to 0, which leaves all of it to its alias: itself


def drawn_units(kept: UInt32[np.ndarray, " rows"], alias: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
    """How many of all units lead to each row: what the table really draws by."""
    units = kept.astype(np.int64)
    np.add.at(units, alias, CELL - units)
    return units
