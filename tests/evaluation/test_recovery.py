"""Coming back to logged ground, on a line where distances can be read off."""

import numpy as np
import pytest

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError
from odaf.evaluation.recovery import KnownGround

UNITS = Normaliser(np.array([10.0]), np.array([2.0]), epsilon=0.0)  # normalised = (x - 10) / 2


def _dataset(*episodes) -> Dataset:
    states = np.concatenate([np.asarray(episode, np.float32) for episode in episodes])[:, None]
    ends = np.cumsum([len(episode) for episode in episodes]) - 1
    truncated = np.isin(np.arange(len(states)), ends)
    return Dataset.from_arrays(
        states, np.zeros((len(states), 1)), np.zeros(len(states)), states + 1, truncated=truncated,
        action_bounds=(-1.0, 1.0),
    )  # fmt: skip


def _ground(**options) -> KnownGround:
    # Either episode may be held back: 0, 2, 4, 6 against 0.5, 2.5, 4.5, 6.5 are 0.5 apart, 0.25 in normalised units.
    return KnownGround.of(_dataset([0, 2, 4, 6], [0.5, 2.5, 4.5, 6.5]), UNITS, **options)


def test_the_threshold_comes_from_episodes_that_are_not_in_the_sample():
    ground = _ground()
    assert ground.rows == 4 and ground.threshold == pytest.approx(0.25)
    assert _ground(rows=2).rows == 2


def test_the_threshold_is_the_95th_percentile():
    rng = np.random.default_rng(0)
    episodes = [rng.normal(size=50) for _ in range(20)]
    ground = KnownGround.of(_dataset(*episodes), UNITS, rows=10_000, checked=10_000)
    sample = ground.tree.data[:, 0]
    logged = np.concatenate(episodes).astype(np.float32)
    held = logged[~np.isin((logged - 10.0) / 2.0, sample.astype(np.float32))]
    assert len(held) == 100 and ground.rows == 900
    nearest = np.sort([np.abs((x - 10.0) / 2.0 - sample).min() for x in held])
    # The 95th percentile of 100 numbers lies between the 95th and the 96th of them, at 0.05 of the way.
    assert ground.threshold == pytest.approx(nearest[94] + 0.05 * (nearest[95] - nearest[94]), rel=1e-3)


def test_recovery_counts_steps_until_the_first_near_state():
    ground = _ground()
    edge = float(ground.tree.data.max()) * 2.0 + 10.0  # the largest state in the sample
    paths = np.array(
        [
            [edge, 50, 50, 50],  # never away
            [edge + 9, edge + 2, edge + 0.4, 50],  # 0.4 is 0.2 in normalised units, nearer than 0.25
            [edge + 9, edge + 0.6, edge + 0.6, edge + 0.6],  # 0.3: too far
            [edge + 9, edge + 9, np.nan, np.nan],  # ended before it was back
            [edge + 9, edge + 0.4, edge + 0.4, 50],  # the first time counts
        ]
    )[:, :, None]
    np.testing.assert_array_equal(ground.recovery(paths), [0, 2, np.inf, np.inf, 1])
    assert ground.recovery(np.empty((0, 5, 1))).shape == (0,)


def test_one_episode_gives_no_ground():
    with pytest.raises(DatasetError, match="one episode"):
        KnownGround.of(_dataset([0, 1, 2]), UNITS)
