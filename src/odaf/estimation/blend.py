"""Several estimates of one value as one, weighed by what is known of their errors.

    x = sum_i w_i x_i,     w_i ~ 1 / ( spread_i^2 + miss_i^2 ),     besides^2 = sum_i w_i ( x_i - x )^2

x_i is how much an estimator puts the policy above the behaviour, spread_i that of its members, and miss_i how far it is
off the one value that is known, the behaviour's own. The spread of the members of x stands for the chance of the
episodes, and `besides` is a standard error of its own, for what the estimators differ by: both are of one log, so that
an error they share does not shrink with their number. With equal weights of two it is half their difference.
"""

from collections.abc import Sequence

import numpy as np

SMALLEST = 1e-12  # a share of the largest squared error


def weights_of(above: Sequence[np.ndarray], misses: Sequence[float]) -> np.ndarray:
    """w, one for each estimator.

    Args:
        above: x_i, each [1 + members].
        misses: miss_i.
    """
    squares = np.array([np.var(each[1:], ddof=1) + miss**2 for each, miss in zip(above, misses, strict=True)])
    if not squares.any():
        return np.full(len(squares), 1.0 / len(squares))
    precise = 1.0 / np.maximum(squares, SMALLEST * squares.max())
    return precise / precise.sum()


def blend(above: Sequence[np.ndarray], weights: np.ndarray) -> tuple[np.ndarray, float]:
    """x [1 + members], and `besides`."""
    mean = np.sum([weight * each for weight, each in zip(weights, above, strict=True)], axis=0)
    first = np.array([float(each[0]) for each in above])
    return mean, float(np.sqrt(np.sum(weights * np.square(first - mean[0]))))
