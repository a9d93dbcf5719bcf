"""The threshold of an alarm: exact on known values, and its promise kept in simulated worlds."""

import numpy as np
import pytest

from odaf.deployment.conformal import calibrate, episodes_for, pieces
from odaf.errors import ConfigError, DatasetError

LENGTHS = np.full(19, 10)


@pytest.mark.parametrize(
    ("episodes", "rate", "rank"),
    # ceil((n + 1)(1 - alpha)), by hand; 20 * 0.95 and 100 * 0.9 are whole though 0.95 and 0.9 have no binary form
    [(19, 0.05, 19), (19, 0.1, 18), (20, 0.1, 19), (99, 0.01, 99), (199, 0.01, 198), (99, 0.1, 90), (4, 0.5, 3)],
)
def test_the_threshold_is_the_value_of_that_rank(episodes: int, rate: float, rank: int):
    maxima = np.random.default_rng(0).permutation(np.arange(1.0, episodes + 1.0))
    found = calibrate(maxima, rate, np.full(episodes, 10))
    assert found.threshold == rank
    assert found.promised == pytest.approx(1.0 - rank / (episodes + 1))
    assert found.promised <= rate + 1e-12
    assert (found.episodes, found.median_length, found.episode_steps) == (episodes, 10, None)


def test_too_few_episodes_are_refused_with_the_number_that_it_takes():
    for rate, needed in ((0.01, 99), (0.05, 19), (0.5, 1), (0.03, 33)):
        assert episodes_for(rate) == needed
        calibrate(np.zeros(needed), rate, LENGTHS)
        if needed > 1:
            with pytest.raises(
                DatasetError, match=rf"needs {needed} episodes set aside, and there are {needed - 1}.*split"
            ):
                calibrate(np.zeros(needed - 1), rate, LENGTHS)
    for rate in (0.0, 1.0, -0.1, float("nan")):
        with pytest.raises(ConfigError, match="must lie between 0 and 1"):
            calibrate(np.zeros(19), rate, LENGTHS)


def test_the_rate_holds_whatever_the_scores_are():
    """20,000 worlds of 49 episodes each: the mean rate of alarms in a fresh episode is (n + 1 - k) / (n + 1) = 0.1.

    Its standard error is sqrt(0.1 * 0.9 / 20,000) = 0.0021; bounds are 4 of these, which a right threshold passes in
    all but one of 15,000 trials. A rank off by one would give 0.08 or 0.12.
    """
    rng = np.random.default_rng(1)
    scores = rng.standard_t(2, (20_000, 50)) ** 3  # heavy tails, of which nobody knows anything
    alarms = [each[49] > calibrate(each[:49], 0.1, LENGTHS).threshold for each in scores]
    assert 0.0915 < np.mean(alarms) < 0.1085


def test_long_recordings_are_cut_and_no_piece_is_short():
    assert pieces(np.array([0, 25]), 60, None).tolist() == [0, 25]
    assert pieces(np.array([0, 25]), 60, 10).tolist() == [0, 10, 25, 35, 45]
    assert pieces(np.array([0, 7]), 27, 10).tolist() == [0, 7, 17]
    with pytest.raises(ConfigError, match="episode_steps=0"):
        pieces(np.array([0]), 5, 0)
