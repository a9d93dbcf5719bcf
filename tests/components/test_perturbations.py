"""Draws in a box, and the ascent that looks for its worst corner."""

import functools

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odaf.components.perturbations import draw_offsets, signed_ascent, worst_offsets

draw = jax.jit(draw_offsets, static_argnames=("draws", "rows", "obs_dim", "radius", "shared", "include_centre"))


def _draw(draws: int, rows: int, obs_dim: int, *, shared: bool = False, include_centre: bool = False) -> np.ndarray:
    settings = {"draws": draws, "rows": rows, "obs_dim": obs_dim, "radius": 0.2}
    return np.asarray(draw(jr.key(0), **settings, shared=shared, include_centre=include_centre))


def test_offsets_fill_the_box_uniformly():
    offsets = _draw(50, 40, 3, shared=False, include_centre=False)
    assert offsets.shape == (50, 40, 3)
    assert np.abs(offsets).max() <= 0.2 and np.abs(offsets).max() > 0.199
    # 6,000 uniform numbers: the mean's deviation is 0.0015, the standard deviation's 0.0007
    assert abs(offsets.mean()) < 0.007 and abs(offsets.std() - 0.2 / np.sqrt(3)) < 0.004


def test_offsets_are_a_states_own_unless_shared():
    own = _draw(2, 4, 3, shared=False, include_centre=False)
    shared = _draw(2, 4, 3, shared=True, include_centre=False)
    assert len(np.unique(own[0], axis=0)) == 4
    assert len(np.unique(shared[0], axis=0)) == 1
    assert not np.array_equal(shared[0], shared[1])


@pytest.mark.parametrize("shared", [False, True])
def test_the_centre_can_be_one_of_the_draws(shared):
    offsets = _draw(3, 4, 2, shared=shared, include_centre=True)
    np.testing.assert_array_equal(offsets[0], np.zeros((4, 2)))
    assert np.all(offsets[1:] != 0.0)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_the_maximum_of_a_linear_objective_is_exact(steps):
    slopes = jnp.asarray(np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32))
    found = jax.jit(lambda s: signed_ascent(lambda o: jnp.sum(s * o, axis=1), jnp.zeros((20, 3)), 0.05, steps))(slopes)
    np.testing.assert_allclose(found, 0.05 * np.sign(np.asarray(slopes)), rtol=1e-6)


@functools.partial(jax.jit, static_argnums=(1, 2))
def _climb(middle, radius, steps):
    return signed_ascent(lambda o: jnp.sum(jnp.sin(7.0 * (o - middle)), axis=1), jnp.zeros((4, 2)), radius, steps)


@settings(max_examples=40)
@given(st.sampled_from([(0.0, 1), (0.3, 1), (0.3, 5), (4.0, 2)]), st.integers(0, 2**31 - 1))
def test_ascent_stays_in_the_box_whatever_the_objective(box, seed):
    middle = np.random.default_rng(seed).normal(size=(4, 2)).astype(np.float32)
    assert np.all(np.abs(np.asarray(_climb(middle, *box))) <= np.float32(box[0]))


def test_more_steps_find_a_maximum_inside_the_box():
    def objective(offsets):
        return -jnp.sum(jnp.square(offsets - 0.02), axis=1)

    @jax.jit
    def climb():
        return [objective(signed_ascent(objective, jnp.zeros((1, 2)), 0.1, steps))[0] for steps in (1, 20)]

    reached = [float(value) for value in climb()]
    assert reached[1] > -(2 * 0.01**2) > reached[0], "one long step overshoots; twenty end within a step of the top"


def test_each_row_gets_the_first_of_its_best_draws():
    offsets = jnp.asarray(np.array([[[1.0], [5.0], [2.0]], [[3.0], [-1.0], [2.0]], [[2.0], [0.0], [-2.0]]]))
    found, slope = jax.value_and_grad(lambda o: jnp.sum(worst_offsets(lambda row: row[:, 0] + 0.0, o) ** 2))(offsets)
    assert float(found) == 9.0 + 25.0 + 4.0
    assert not np.any(slope), "a choice has no gradient"
