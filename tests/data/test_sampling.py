"""Columns on the device and batches drawn from them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from scipy import stats

from odaf.data import Dataset, Normaliser, Transitions, device_columns, sample


def numbered(rows=50):
    """Every column of row i says i, so that a mixed-up row shows."""
    count = np.arange(rows, dtype=np.float32)
    return Dataset.from_arrays(
        np.stack([count, -count], axis=1),
        count[:, None] * 2,
        count,
        np.stack([count + 0.5, -count], axis=1),
        terminated=np.arange(rows) % 10 == 9,
        action_bounds=(0.0, 2.0 * (rows - 1)),
    )


def test_columns_are_normalised_and_scaled():
    dataset = numbered()
    normaliser = Normaliser.fit(dataset.observations)
    columns = device_columns(dataset, normaliser)
    np.testing.assert_allclose(columns.observations.mean(axis=0), [0, 0], atol=1e-5)
    np.testing.assert_allclose(columns.observations.std(axis=0), [1, 1], atol=1e-3)
    np.testing.assert_allclose(normaliser.denormalise(columns.next_observations)[:, 0], np.arange(50) + 0.5, atol=1e-4)
    np.testing.assert_allclose(columns.actions[:, 0], np.linspace(-1, 1, 50), atol=1e-6)
    np.testing.assert_array_equal(columns.rewards, dataset.rewards)
    np.testing.assert_array_equal(columns.terminated, np.arange(50) % 10 == 9)
    assert {column.dtype for column in jax.tree.leaves(columns)} == {jnp.dtype(jnp.float32)}


def test_a_batch_holds_whole_rows():
    dataset = numbered()
    batch = sample(device_columns(dataset, Normaliser.identity(2)), jr.key(0), 64)
    assert isinstance(batch, Transitions)
    row = np.asarray(batch.rewards)
    np.testing.assert_array_equal(batch.observations, np.stack([row, -row], axis=1))
    np.testing.assert_array_equal(batch.next_observations, np.stack([row + 0.5, -row], axis=1))
    np.testing.assert_array_equal(batch.terminated, row % 10 == 9)
    np.testing.assert_allclose(batch.actions[:, 0], row / 24.5 - 1, atol=1e-6)


def test_draws_depend_on_the_key_alone_and_compile():
    columns = device_columns(numbered(), Normaliser.identity(2))
    draw = eqx.filter_jit(lambda key: sample(columns, key, 16).rewards)
    np.testing.assert_array_equal(draw(jr.key(3)), sample(columns, jr.key(3), 16).rewards)
    assert (draw(jr.key(3)) != draw(jr.key(4))).any()
    many = jax.vmap(lambda key: sample(columns, key, 16).rewards)(jr.split(jr.key(5), 4))
    np.testing.assert_array_equal(many[2], draw(jr.split(jr.key(5), 4)[2]))


def test_rows_are_drawn_uniformly_with_replacement():
    """Chi-square over 50 rows and 20,000 draws; the limit is the 1e-6 quantile, the false-alarm rate of a new seed."""
    rewards = sample(device_columns(numbered(), Normaliser.identity(2)), jr.key(1), 20_000).rewards
    counts = np.bincount(np.asarray(rewards, int), minlength=50)
    assert len(counts) == 50
    statistic = float(((counts - 400) ** 2 / 400).sum())
    assert stats.chi2.sf(statistic, 49) > 1e-6
    # Without replacement the counts would be far too even.
    assert stats.chi2.cdf(statistic, 49) > 1e-6
