"""Batches mixed at every draw: shares, reach, and that no row is taken from the wrong side."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf.data.mixing_batches import sample_mixed
from odaf.data.transitions import Transitions


def rows(values, width: int = 3) -> Transitions:
    """Rows whose every number says which row they are."""
    column = jnp.asarray(values, jnp.float32)
    matrix = jnp.tile(column[:, None], (1, width))
    return Transitions(matrix, matrix[:, :2], column, matrix, jnp.zeros_like(column))


BORDER = 40
COLUMNS = rows([*range(BORDER), *range(1000, 1010)])


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.9, 1.0])
def test_a_batch_holds_the_poorer_part_in_the_asked_share(ratio):
    batch = jax.jit(lambda key: sample_mixed(COLUMNS, BORDER, ratio, key, 20_000))(jr.key(0))
    poorer = np.asarray(batch.rewards) >= 1000
    # Five standard errors of a share over 20,000 draws: a false alarm in two million keys.
    assert abs(poorer.mean() - ratio) <= 5 * np.sqrt(ratio * (1 - ratio) / 20_000)
    reached = set(np.asarray(batch.rewards).tolist())
    expected = (set(range(40)) if ratio < 1 else set()) | (set(range(1000, 1010)) if ratio > 0 else set())
    assert reached == expected, "every row of both parts may be drawn"
    np.testing.assert_array_equal(batch.observations[:, 0], batch.rewards)
    np.testing.assert_array_equal(batch.actions[:, 1], batch.rewards)


def test_one_key_draws_the_same_rows_and_another_does_not():
    first, again, other = (sample_mixed(COLUMNS, BORDER, 0.5, jr.key(seed), 64).rewards for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (np.asarray(first) != np.asarray(other)).any()
