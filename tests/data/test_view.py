"""A learner's view of a log, against a loop over every episode."""

from typing import get_args

import numpy as np
import pytest

from odaf.data import Dataset, Normaliser
from odaf.data.sampling import device_columns, training_column_shapes, training_columns
from odaf.data.transitions import Transitions
from odaf.data.view import Extra, View
from odaf.errors import ConfigError

DISCOUNT = 0.9
EXTRAS: tuple[Extra, ...] = get_args(Extra)


def _log() -> Dataset:
    """Three episodes of 3, 2 and 4 rows: a true end with a logged successor, one without, a cut."""
    rng = np.random.default_rng(0)
    lengths = (3, 2, 4)
    rows = sum(lengths)
    ends = np.cumsum(lengths) - 1
    observations = rng.normal(size=(rows, 2)).astype(np.float32)
    after = observations + 1.0
    after[ends[1]] = observations[ends[1]]  # a placeholder
    terminated = np.isin(np.arange(rows), ends[:2])
    return Dataset.from_arrays(
        observations,
        rng.uniform(-2.0, 2.0, (rows, 1)),
        rng.normal(size=rows),
        next_observations=after,
        terminated=terminated,
        truncated=np.arange(rows) == ends[2],
        action_bounds=(-2.0, 2.0),
    )


def _expected(log: Dataset, steps: int) -> dict[str, list]:
    found: dict[str, list] = {name: [] for name in EXTRAS}
    for episode in range(log.num_episodes):
        rows = list(range(*log.episode(episode).indices(len(log))))
        ends = bool(log.terminated[rows[-1]])
        for place, row in enumerate(rows):
            last = min(place + steps, len(rows)) - 1
            if last - place + 1 < steps and not ends:
                continue
            follows = last + 1 < len(rows)
            found["next_actions"].append([log.actions[rows[last + 1], 0] / 2.0] if follows else [0.0])
            found["followed"].append(float(follows))
            repeats = np.array_equal(log.observations[rows[last]], log.next_observations[rows[last]])
            found["successor_known"].append(float(not (log.terminated[rows[last]] and repeats)))
            found["episode_steps"].append(float(place))
            mean = np.mean(2.0 * (log.rewards[rows] - 1.0))
            rest = sum(DISCOUNT ** (r - row) * 2.0 * (log.rewards[r] - 1.0) for r in rows[place:])
            found["returns_to_go"].append(
                rest + (0.0 if ends else DISCOUNT ** (len(rows) - place) * mean / (1.0 - DISCOUNT))
            )
    return found


@pytest.mark.parametrize("steps", [1, 2])
def test_extras_match_a_loop_over_episodes(steps):
    log = _log()
    view = View(steps, DISCOUNT, reward_scale=2.0, reward_shift=-1.0, extras=EXTRAS)
    columns, shapes = training_columns(log, Normaliser.identity(2), view), training_column_shapes(log, view)
    assert isinstance(columns, Transitions) and isinstance(shapes, Transitions)
    expected = _expected(log, steps)
    assert set(columns.extras) == set(EXTRAS) == set(shapes.extras)
    for name in EXTRAS:
        np.testing.assert_allclose(columns.extras[name], expected[name], rtol=1e-5, atol=1e-6, err_msg=name)
        assert shapes.extras[name].shape == columns.extras[name].shape


def test_rewards_are_shifted_and_then_scaled():
    log = _log()
    columns = device_columns(log, Normaliser.identity(2), View(reward_scale=0.5, reward_shift=-1.0))
    np.testing.assert_allclose(columns.rewards, 0.5 * (log.rewards - 1.0), rtol=1e-6)
    plain = device_columns(log, Normaliser.identity(2))
    np.testing.assert_array_equal(plain.rewards, log.rewards)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"return_steps": 0}, "return_steps=0 must be at least 1"),
        ({"return_steps": 2}, "need a discount"),
        ({"extras": ("returns_to_go",)}, "need a discount"),
    ],
)
def test_views_that_make_no_sense_are_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        View(**fields)
