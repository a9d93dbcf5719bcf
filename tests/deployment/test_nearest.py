"""Reference rows and whitening."""

import numpy as np

from golden.tiny import linear_dataset
from odaf.deployment.nearest import LoggedRows, references, whitening


def test_whitened_rows_have_no_preferred_direction():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(5_000, 3)) @ np.array([[2.0, 0.0, 0.0], [1.9, 0.3, 0.0], [0.0, 0.0, 0.5]])
    white = whitening(rows, floor=0.0)
    np.testing.assert_allclose(np.cov(rows @ white, rowvar=False), np.eye(3), atol=1e-8)
    np.testing.assert_allclose(white, white.T)
    # against an independent derivation: the distance is Mahalanobis'
    gap = rows[0] - rows[1]
    wanted = gap @ np.linalg.inv(np.cov(rows, rowvar=False)) @ gap
    np.testing.assert_allclose(np.sum(np.square(gap @ white)), wanted)
    # a column that never varies counts no more than the floor lets it
    assert np.isfinite(whitening(np.ones((10, 2)), floor=0.01)).all()


def test_references_reach_the_rim_that_chance_would_miss():
    rng = np.random.default_rng(0)
    rows = np.concatenate([rng.normal(size=(3_000, 2)), [[30.0, 0.0]]]).astype(np.float32)
    chosen = references(rows, 20, np.random.default_rng(0))
    assert 3_000 in chosen and len(chosen) == 20 and (np.diff(chosen) > 0).all()
    assert references(rows[:5], 20, rng).tolist() == [0, 1, 2, 3, 4]
    everywhere = np.linalg.norm(rows[:, None] - rows[chosen][None], axis=-1).min(axis=1)
    at_random = np.linalg.norm(rows[:, None] - rows[:20][None], axis=-1).min(axis=1)
    assert everywhere.max() < 0.5 * at_random.max()


def test_neighbours_say_what_was_done_and_what_followed():
    log = linear_dataset(episodes=4, length=5)
    points = np.arange(20.0)[:, None]
    first, second = LoggedRows(log, points).nearest(np.array([7.2]), 2)
    assert (first.row, first.episode, first.step) == (7, 1, 2) and first.distance == np.float64(7.2) - 7.0
    assert second.row == 8 and not first.ended
    np.testing.assert_array_equal(first.action, log.actions[7])
    np.testing.assert_array_equal(first.next_observation, log.next_observations[7])
    np.testing.assert_allclose(first.rest, log.rewards[7:10].sum(), rtol=1e-6)
    assert len(LoggedRows(log, points).nearest(np.array([0.0]), 50)) == 20
