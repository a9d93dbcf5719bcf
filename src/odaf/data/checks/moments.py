"""Mean, spread and range of columns that come in pieces."""

import numpy as np


class Moments:
    """Running statistics of each column; NaN and infinity are left out of all of them.

    Attributes:
        count: rows that were finite in every column.
        mean: [columns] float64.
        low: [columns] smallest value.
        high: [columns] largest value.
    """

    def __init__(self):
        self.count = 0
        self.mean = np.zeros(0)
        self.low = np.zeros(0)
        self.high = np.zeros(0)
        self._squares = np.zeros(0)

    def add(self, values: np.ndarray) -> None:
        """Takes in [rows, columns]. Pieces are joined as in Chan, Golub and LeVeque 1979, which cancels no digits."""
        total = values.sum(dtype=np.float64) if values.dtype.kind == "f" else 0.0
        if not np.isfinite(total):
            values = values[np.isfinite(values).all(axis=1)]
        rows = len(values)
        if rows == 0:
            return
        # The first row stands in for the mean, so that squares are of differences and not of large numbers.
        shifted = values.astype(np.float64) - values[0].astype(np.float64)
        offset = shifted.mean(axis=0)
        mean = values[0].astype(np.float64) + offset
        with np.errstate(over="ignore", invalid="ignore"):  # numbers of 1e200 and more have no square
            squares = np.einsum("rc,rc->c", shifted, shifted) - rows * offset**2
        low, high = values.min(axis=0), values.max(axis=0)
        if self.count == 0:
            self.count, self.mean, self._squares, self.low, self.high = rows, mean, squares, low, high
            return
        total_rows = self.count + rows
        apart = mean - self.mean
        with np.errstate(over="ignore", invalid="ignore"):
            self._squares = self._squares + squares + apart**2 * (self.count * rows / total_rows)
        self.mean = self.mean + apart * (rows / total_rows)
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        self.count = total_rows

    @property
    def std(self) -> np.ndarray:
        """[columns] float64, divisor N."""
        return np.sqrt(np.maximum(self._squares, 0.0) / max(self.count, 1))
