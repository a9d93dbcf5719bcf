"""Our learners against d3rlpy's: one update each, from the weights, on the batch and with the noise of its export."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.parity import losses, ours


@pytest.mark.parametrize("name", list(ours.COMPARISONS))
def test_losses_gradients_and_slow_copies_are_those_of_d3rlpy(name):
    found = losses.compare(name)
    assert max(found["largest_difference"].values()) < losses.TOLERANCE, found["largest_difference"]
    assert {part.partition(" ")[0] for part in found["largest_difference"]} >= {"loss", "gradient"}


def test_a_difference_is_seen():
    array = np.array([1.0, 100.0])
    assert losses.difference(array, array) == 0.0
    assert losses.difference(array + [0.0, 0.01], array) == pytest.approx(1e-4)
    assert losses.difference(np.array([2e-3]), np.array([1e-3])) == pytest.approx(1.0)
    assert losses.difference(np.array([1e-3]), np.array([0.0])) == pytest.approx(1e-3)
