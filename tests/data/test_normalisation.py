"""Observation and action maps against hand-worked numbers, and their inverses."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from odaf.data import Normaliser
from odaf.data.normalisation import scale_actions, unscale_actions
from odaf.errors import DatasetError

# Columns: mean 3, std sqrt((4 + 0 + 4) / 3); constant 7; mean 0, std 10.
ROWS = np.array([[1.0, 7.0, -10.0], [3.0, 7.0, 10.0], [5.0, 7.0, 0.0]], np.float32)
STD = np.array([np.sqrt(8 / 3), 0.0, np.sqrt(200 / 3)])


def test_fit_by_hand():
    normaliser = Normaliser.fit(ROWS)
    np.testing.assert_allclose(normaliser.mean, [3, 7, 0])
    np.testing.assert_allclose(normaliser.std, STD, rtol=1e-6)
    assert normaliser.constant == (1,)
    expected = (ROWS[:, [0, 2]] - [3, 0]) / STD[[0, 2]]
    np.testing.assert_allclose(normaliser.normalise(ROWS)[:, [0, 2]], expected, rtol=1e-5)
    assert not normaliser.normalise(ROWS)[:, 1].any()


def test_an_epsilon_is_added_where_it_is_asked_for():
    normaliser = Normaliser.fit(ROWS, epsilon=1e-3)
    np.testing.assert_allclose(normaliser.scale[[0, 2]], STD[[0, 2]] + 1e-3, rtol=1e-6)
    assert not normaliser.normalise(ROWS)[:, 1].any()


def test_one_that_is_not_applied_leaves_what_varies_to_the_bit_and_still_hides_what_does_not():
    normaliser = Normaliser.fit(ROWS, epsilon=1e-3, applied=False)
    later = np.array([[0.1, 7.0, -3.3], [2.5, 8.0, 1e9]], np.float32)
    np.testing.assert_array_equal(normaliser.normalise(later), later * [1, 0, 1])
    np.testing.assert_array_equal(
        normaliser.denormalise(later), [[np.float32(0.1), 7.0, np.float32(-3.3)], [2.5, 7.0, 1e9]]
    )
    np.testing.assert_allclose(normaliser.std, STD, rtol=1e-6)  # what is measured in spreads of the log still can be
    stored = json.loads(json.dumps(normaliser.to_dict()))
    np.testing.assert_array_equal(Normaliser.from_dict(stored).normalise(later), normaliser.normalise(later))


@given(st.integers(-12, 12), st.floats(1, 10), st.integers(0, 2**32 - 1))
def test_units_do_not_matter(power, digits, seed):
    """The same rows in another unit are the same to the learner; so are rows of a sensor that hardly or never moves."""
    rows = np.random.default_rng(seed).normal(size=(40, 4)) * [1.0, 1e-3, 0.0, 0.0] + [5.0, 1.0, 0.0, 3.3]
    unit = float(f"{digits:.3f}e{power}")
    plain, scaled = (values.astype(np.float32) for values in (rows, unit * rows))
    expected = Normaliser.fit(plain).normalise(plain)
    # A value of 1 with spread 1e-3 is rounded to 1e-7, so its normalised value to 1e-4.
    np.testing.assert_allclose(Normaliser.fit(scaled).normalise(scaled), expected, atol=1e-3)
    assert np.abs(expected[:, :2]).max() > 1 and not expected[:, 2:].any()


@pytest.mark.parametrize("value", [0.0, 0.1, 7.0, -1e9, 1e-30])
@pytest.mark.parametrize("epsilon", [0.0, 1e-3])
def test_what_never_varied_stays_harmless_when_it_does(value, epsilon):
    rows = np.full((70_000, 1), value, np.float32)
    normaliser = Normaliser.fit(rows, epsilon)
    later = np.array([[value], [1.0], [-1e9], [3e38]], np.float32)
    for array in (later, jnp.asarray(later)):
        assert not np.asarray(normaliser.normalise(array)).any()
    np.testing.assert_array_equal(normaliser.denormalise(np.array([[0.0], [2.5]], np.float32)), later[[0, 0]])
    # A sensor that fails is not to be hidden.
    assert np.isnan(normaliser.normalise(np.array([[np.nan]], np.float32))).all()


def test_noise_that_single_precision_cannot_hold_is_a_constant():
    noise = np.random.default_rng(0).normal(size=(5000, 1))
    lost = (1e9 + 10 * noise).astype(np.float32)  # neighbours are 64 apart
    assert lost.std() > 0 and Normaliser.fit(lost).constant == (0,)
    coarse = (1e9 + 1000 * noise).astype(np.float32)
    normalised = Normaliser.fit(coarse).normalise(coarse)
    np.testing.assert_allclose(normalised, noise, atol=0.1)


def test_a_dictionary_from_before_constants_were_told_scales_as_it_did():
    normaliser = Normaliser.from_dict({"mean": [7.0, 1.0], "std": [0.0, 2.0], "epsilon": 1e-3})
    np.testing.assert_allclose(normaliser.normalise(np.array([8.0, 5.0], np.float32)), [1000, 4 / 2.001], rtol=1e-5)


def test_one_row_a_batch_and_a_stack_in_numpy_and_jax():
    normaliser = Normaliser.fit(ROWS)
    batch = normaliser.normalise(ROWS)
    assert isinstance(batch, np.ndarray) and batch.dtype == np.float32
    np.testing.assert_array_equal(normaliser.normalise(ROWS[1]), batch[1])
    np.testing.assert_array_equal(normaliser.normalise(ROWS[None, None]), batch[None, None])
    on_device = normaliser.normalise(jnp.asarray(ROWS))
    assert isinstance(on_device, jnp.ndarray) and on_device.dtype == jnp.float32
    np.testing.assert_allclose(on_device, batch, rtol=1e-6)


@given(hnp.arrays(np.float32, (4, 2), elements=st.floats(-1000, 1000, width=32)))
def test_denormalise_inverts(rows):
    normaliser = Normaliser.fit(rows)
    back = normaliser.denormalise(normaliser.normalise(rows))
    np.testing.assert_allclose(back, rows, atol=1e-3, rtol=1e-5)


def test_a_long_offset_column_keeps_its_precision():
    """Single-precision sums over a million rows near 1000 would be off by more than the spread."""
    rows = (1000 + np.tile([-0.125, 0.125], 500_000)).astype(np.float32)[:, None]
    normaliser = Normaliser.fit(rows)
    np.testing.assert_allclose([normaliser.mean[0], normaliser.std[0]], [1000, 0.125], rtol=1e-6)


def test_dictionary_restores_the_same_bits():
    rows = np.random.default_rng(0).normal(size=(50, 4))
    rows[:, 2] = 3.0
    normaliser = Normaliser.fit(rows, epsilon=0.05)
    again = Normaliser.from_dict(json.loads(json.dumps(normaliser.to_dict())))
    np.testing.assert_array_equal(again.mean, normaliser.mean)
    np.testing.assert_array_equal(again.scale, normaliser.scale)


def test_identity_changes_nothing():
    np.testing.assert_array_equal(Normaliser.identity(3).normalise(ROWS), ROWS)


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        Normaliser.fit(ROWS).mean[0] = 1


@pytest.mark.parametrize(
    "build",
    [
        lambda: Normaliser(np.zeros(2), np.ones(3)),
        lambda: Normaliser(np.zeros((1, 2)), np.ones((1, 2))),
        lambda: Normaliser(np.zeros(2), np.ones(2), constant=(2,)),
        lambda: Normaliser(np.array([np.nan]), np.ones(1)),
        lambda: Normaliser(np.zeros(1), np.zeros(1), epsilon=0.0),
        lambda: Normaliser.fit(np.zeros((0, 2))),
        lambda: Normaliser.fit(np.zeros(3)),
    ],
)
def test_nonsense_is_refused(build):
    with pytest.raises(DatasetError, match=r"^normaliser: "):
        build()


def test_action_scaling_by_hand():
    low, high = [0.0, -1.0], [100.0, 1.0]
    actions = np.array([[0.0, -1.0], [100.0, 1.0], [25.0, 0.3]], np.float32)
    np.testing.assert_allclose(scale_actions(actions, low, high), [[-1, -1], [1, 1], [-0.5, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(unscale_actions(scale_actions(actions, low, high), low, high), actions, atol=1e-5)


@given(hnp.arrays(np.float32, (5, 2), elements=st.floats(-1, 1, width=32)))
def test_unit_bounds_change_no_bit(actions):
    np.testing.assert_array_equal(scale_actions(actions, [-1, -1], [1, 1]), actions)
    np.testing.assert_array_equal(unscale_actions(actions, [-1, -1], [1, 1]), actions)
