"""Training on data that are mixed per batch, and on data that are not: which rows are drawn."""

import dataclasses

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf import training
from odaf.data import Normaliser, training_columns
from odaf.data.mixing_batches import MixedColumns, sample_mixed
from odaf.data.mixture import Mixture
from odaf.errors import DatasetError
from odaf.training import loop

# Rows drawn by updates 1 to 3 of seed 0, and weights after 12 updates of it; both written down before there were
# mixtures. Whole numbers drawn from a key are the same on every machine, sums of products nearly so.
ROWS = [[59, 47, 31, 37, 13, 40, 38, 9], [8, 24, 43, 14, 52, 26, 45, 20], [44, 25, 39, 30, 27, 53, 23, 41]]
WEIGHTS = [[-0.45944685, -0.67266273], [0.10233614, -0.11439019], [-0.015639573, -0.00037110707]]


def drawn(tiny, columns, updates, seed=0):
    """[updates, batch] the rewards of the batch that each of the first updates saw."""

    class Recorder(tiny.TinyLearner):
        def update(self, state, batch, key):
            state, _ = super().update(state, batch, key)
            return state, {f"place/{place}": batch.rewards[place] for place in range(self.batch_size)}

    learner, found = Recorder(), []
    state = loop.donatable(learner.init(jr.key(0), tiny.tiny_dataset().spec(), jnp.zeros(2)))
    for step in range(updates):
        fixed = (learner, columns, loop.training_key(seed), jnp.asarray(step), jnp.asarray(step + 1))
        state, metrics = loop.train_stretch(*fixed, state)
        found.append([float(metrics[f"place/{place}"]) for place in range(learner.batch_size)])
    return np.array(found)


def numbered(tiny, mixture=None):
    """Sixty rows in four episodes; the reward of a row is its number."""
    return dataclasses.replace(tiny.tiny_dataset(), rewards=np.arange(60, dtype=np.float32), mixture=mixture)


def test_data_without_a_mixture_draw_the_rows_they_always_drew(tiny):
    columns = training_columns(numbered(tiny), Normaliser.identity(3))
    np.testing.assert_array_equal(drawn(tiny, columns, 3), ROWS)


def test_data_without_a_mixture_give_the_weights_they_always_gave(tiny, tmp_path):
    learner = tiny.TinyLearner(normaliser_epsilon=1e-3)  # as was added to all spreads then
    run = training.fit(learner, tiny.tiny_dataset(), steps=12, directory=tmp_path, stretch=2, progress=False)
    np.testing.assert_allclose(run.state(0).weights, WEIGHTS, rtol=2e-4)


def test_batches_of_a_mixture_are_drawn_by_part(tiny):
    columns = training_columns(numbered(tiny, Mixture(45, 0.8)), Normaliser.identity(3))
    assert isinstance(columns, MixedColumns)
    found = drawn(tiny, columns, 40)
    # 320 draws: five standard errors of the share are 0.11, and an even draw would take a quarter.
    assert abs((found >= 45).mean() - 0.8) < 0.11
    assert len(np.unique(found)) > 40, "rows of both parts are within reach"
    key, _ = jr.split(jr.fold_in(loop.training_key(0), 0))
    np.testing.assert_array_equal(found[0], sample_mixed(columns.columns, 45, 0.8, key, 8).rewards)


def test_a_cut_run_on_a_mixture_goes_on_to_the_bits_of_the_whole_one(tiny, tmp_path):
    mixed = numbered(tiny, Mixture(45, 0.8))
    mixed.save(tmp_path / "mixed.h5")
    options = {"data_path": tmp_path / "mixed.h5", "checkpoint_every": 4, "stretch": 2, "progress": False}
    whole = training.fit(tiny.TinyLearner(), mixed, steps=8, directory=tmp_path / "whole", **options)
    training.fit(tiny.TinyLearner(), mixed, steps=4, directory=tmp_path / "cut", **options)
    cut = training.resume(tmp_path / "cut", 8, progress=False)  # reads the mixture from the file
    assert tiny.arrays_of(cut.path) == tiny.arrays_of(whole.path)
    assert whole.data["summary"]["mixture"] == {"border": 45, "ratio": 0.8}
    plain = training.fit(tiny.TinyLearner(), numbered(tiny), steps=8, directory=tmp_path / "plain", **options)
    assert not np.array_equal(plain.state(0).weights, whole.state(0).weights)
    with pytest.raises(DatasetError, match="fingerprint"):
        training.resume(tmp_path / "cut", 9, dataset=numbered(tiny), progress=False)
