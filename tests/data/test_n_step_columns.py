"""n-step rows of the device columns, against a loop over every episode."""

import dataclasses

import jax
import numpy as np
import pytest

from odaf.data import Dataset, Normaliser, device_columns, training_columns
from odaf.data.mixing_batches import MixedColumns
from odaf.data.mixture import Mixture
from odaf.data.sampling import training_column_shapes
from odaf.data.view import View
from odaf.errors import DatasetError

DISCOUNT = 0.9


def _log(terminates: bool) -> Dataset:
    """Two episodes of 4 and 3 steps; observations count rows, rewards are powers of two."""
    rows = 7
    observations = np.arange(rows, dtype=np.float32)[:, None]
    ends = np.isin(np.arange(rows), (3, 6))
    return Dataset.from_arrays(
        observations,
        np.zeros((rows, 1), np.float32),
        2.0 ** np.arange(rows, dtype=np.float32),
        next_observations=observations + 1.0,
        terminated=ends if terminates else np.zeros(rows, bool),
        truncated=np.zeros(rows, bool) if terminates else ends,
        action_bounds=(np.array([-1.0]), np.array([1.0])),
    )


def _columns(log: Dataset, steps: int):
    return device_columns(log, Normaliser.identity(1), View(steps, DISCOUNT))


@pytest.mark.parametrize("terminates", [True, False])
@pytest.mark.parametrize("steps", [1, 2, 3, 4])
def test_rows_match_a_loop_over_episodes(steps: int, terminates: bool) -> None:
    log = _log(terminates)
    expected = []
    for episode in range(log.num_episodes):
        rows = range(*log.episode(episode).indices(len(log)))
        for row in rows:
            span = [r for r in range(row, row + steps) if r in rows]
            if len(span) < steps and not terminates:
                continue  # cut by the recording: no n-step successor is known
            total = sum(DISCOUNT**ahead * float(log.rewards[r]) for ahead, r in enumerate(span))
            expected.append((row, total, span[-1] + 1.0, terminates and span[-1] == rows[-1]))
    columns = _columns(log, steps)
    found = zip(
        np.asarray(columns.observations)[:, 0],
        np.asarray(columns.rewards),
        np.asarray(columns.next_observations)[:, 0],
        np.asarray(columns.terminated),
        strict=True,
    )
    np.testing.assert_allclose([list(map(float, row)) for row in found], [list(map(float, e)) for e in expected])


def test_one_step_keeps_every_row_and_every_bit_of_the_rewards() -> None:
    log = _log(False)
    columns = _columns(log, 1)
    np.testing.assert_array_equal(columns.rewards, log.rewards)
    np.testing.assert_array_equal(columns.next_observations, log.next_observations)


def test_more_steps_than_any_episode_has_is_refused() -> None:
    with pytest.raises(DatasetError, match="return_steps=5: no episode has so many steps"):
        _columns(_log(False), 5)


@pytest.mark.parametrize("mixture", [None, Mixture(4, 0.5)])
@pytest.mark.parametrize("steps", [1, 2, 3])
@pytest.mark.parametrize("terminated", [False, True])
def test_shapes_are_known_before_the_columns_are_there(steps: int, mixture: Mixture | None, terminated: bool) -> None:
    log = dataclasses.replace(_log(terminated), mixture=mixture)
    shapes = training_column_shapes(log, View(steps, DISCOUNT))
    columns = training_columns(log, Normaliser.identity(1), View(steps, DISCOUNT))
    assert jax.tree.structure(shapes) == jax.tree.structure(columns)
    for shape, column in zip(jax.tree.leaves(shapes), jax.tree.leaves(columns), strict=True):
        assert (shape.shape, shape.dtype) == (column.shape, column.dtype)


@pytest.mark.parametrize(("steps", "border"), [(1, 4), (2, 3), (3, 2)])
def test_the_border_of_a_mixture_moves_with_the_rows_that_are_left_out(steps: int, border: int) -> None:
    mixed = dataclasses.replace(_log(False), mixture=Mixture(4, 0.5))
    columns = training_columns(mixed, Normaliser.identity(1), View(steps, DISCOUNT))
    assert isinstance(columns, MixedColumns)
    assert (columns.border, columns.ratio) == (border, 0.5)
    first = np.asarray(columns.columns.observations)[:, 0] < 4
    assert first.tolist() == [True] * border + [False] * (len(first) - border)


def test_a_part_of_a_mixture_without_so_many_steps_is_refused() -> None:
    mixed = dataclasses.replace(_log(False), mixture=Mixture(4, 0.5))  # its second part is three steps long
    with pytest.raises(DatasetError, match="return_steps=4: no episode of the second part of the mixture"):
        training_columns(mixed, Normaliser.identity(1), View(4, DISCOUNT))
