"""How messages name rows."""

from collections.abc import Sequence

import numpy as np

# What messages call each row.
RowNumbers = Sequence[int] | np.ndarray


def name_rows(mask: np.ndarray, row_numbers: RowNumbers | None = None, limit: int = 5) -> str:
    """`3 of 40 rows, the first of them 0, 7, 12`.

    Args:
        mask: [rows] marks the offending ones.
        row_numbers: [rows] what the source calls each; None counts from 0, as is done where the number of rows differs
            from that of the mask, which is then of a column that does not fit the others.
        limit: how many to name.
    """
    rows = np.flatnonzero(mask)
    shown = ", ".join(str(number_of(int(row), len(mask), row_numbers)) for row in rows[:limit])
    if len(rows) > 1:
        return f"{len(rows):,} of {len(mask):,} rows, the first of them {shown}"
    return f"row {shown} of {len(mask):,}" if row_numbers is None else f"row {shown}"


def number_of(row: int, rows: int, row_numbers: RowNumbers | None) -> int:
    """What the source calls a row; `row` itself where it has no numbers for that many rows."""
    return row if row_numbers is None or len(row_numbers) != rows else int(row_numbers[row])


def any_in_row(mask: np.ndarray) -> np.ndarray:
    """[rows] bool: whether any entry of the row is marked; `mask` is [rows] or [rows, columns]."""
    return np.asarray(mask.reshape(len(mask), -1).any(axis=1))
