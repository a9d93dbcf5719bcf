"""Which states a log knows, and what is left open where it does not."""

import dataclasses

import jax.random as jr
import numpy as np
import pytest

from estimation.grounds import HORIZON, SMALL, gliding
from odaf.estimation.evidence import Evidence
from odaf.estimation.outcomes import KnownOutcomes, Visited

GAMMA = 0.5


@pytest.fixture(scope="module")
def log() -> Evidence:
    return Evidence(gliding(60, ends=False), HORIZON, (1.0, GAMMA), SMALL, jr.key(0))


@pytest.fixture(scope="module")
def known(log: Evidence) -> KnownOutcomes:
    return KnownOutcomes(log)


def test_a_hundredth_of_what_follows_in_one_episode_is_unlike_the_other_episodes(log: Evidence, known: KnownOutcomes):
    own = log.episode % 5 == 2
    others = np.abs(log.next_observations[own] - log.observations[~own].T).min(axis=1)
    spread = np.sqrt(log.observations.var(ddof=1) + 1e-2)  # of one column, which whitening divides by
    assert np.mean(others / spread > known.bound) < 0.05
    assert known.bound < 0.2
    assert not known.unlike(log.observations).any()  # each is a logged state itself


def test_an_episode_is_no_witness_for_itself():
    dataset = gliding(10, ends=False)
    level = np.repeat(np.arange(10.0), HORIZON)[:, None].astype(np.float32)  # each episode stays where no other is
    still = Evidence(
        dataclasses.replace(dataset, observations=level, next_observations=level), HORIZON, (1.0,), SMALL, jr.key(0)
    )
    apart = np.diff(still.observations[[0, HORIZON], 0]).item() / np.sqrt(still.observations.var(ddof=1) + 1e-2)
    assert KnownOutcomes(still).bound == pytest.approx(apart, rel=1e-5)


def test_states_between_logged_ones_are_known_and_those_beyond_them_are_not(log: Evidence, known: KnownOutcomes):
    ends = np.sort(log.observations[:, 0])[[0, -1]]
    low, high = np.quantile(log.observations, [0.1, 0.9])
    inside = np.linspace(float(low), float(high), 50)[:, None]
    assert not known.unlike(inside).any()
    assert known.unlike(np.array([[ends[0] - 0.5], [ends[1] + 0.5]])).all()


def test_what_unlike_states_may_earn_by_hand(log: Evidence, known: KnownOutcomes):
    rates = log.dataset.rewards.astype(np.float64).reshape(60, HORIZON).mean(axis=1)
    low, high = np.quantile(rates, [0.025, 0.975])
    assert low < 0.0 < high
    here, away = 0.0, 99.0
    states = np.array([[here, here], [away, here], [away, away]])[..., None]  # two episodes of three steps
    running = np.array([[1.0, 1.0], [0.5, 1.0], [0.25, 1.0]])
    rewards = np.array([[0.0, 0.0], [0.1, 0.0], [high + 1.0, low - 1.0]])
    visited = Visited(states, running, rewards, np.zeros((3, 2, 1)))
    for discount, found in zip((1.0, GAMMA), known.unknown(visited), strict=True):
        assert found.share == pytest.approx((0.5 + 0.25 + 1.0) / 4.75)
        assert (found.low, found.high) == pytest.approx((low, high))
        less = 0.5 * discount * (0.1 - low) + 0.25 * discount**2 * (high + 1.0 - low)
        more = 0.5 * discount * (high - 0.1) + 1.0 * discount**2 * (high - low + 1.0)
        assert (found.below, found.above) == pytest.approx((less / 2, more / 2))


def test_where_no_one_ever_acted_so_nothing_is_known_though_a_model_leads_home():
    dataset = gliding(60, ends=False)
    narrow = dataclasses.replace(dataset, actions=0.2 * dataset.actions)
    known = KnownOutcomes(Evidence(narrow, HORIZON, (1.0,), SMALL, jr.key(0)))
    assert known.beyond(np.array([[0.0], [0.205], [0.25], [-0.25]])).tolist() == [False, False, True, True]
    home = np.zeros((2, 1, 1))
    (found,) = known.unknown(Visited(home, np.ones((2, 1)), np.zeros((2, 1)), np.array([[[0.1]], [[0.9]]])))
    assert found.share == 0.5 and found.below == pytest.approx(-found.low) and found.above == pytest.approx(found.high)


def test_an_episode_may_end_so_that_nothing_is_earned_lies_in_the_range():
    shifted = gliding(20, ends=False)
    shifted = dataclasses.replace(shifted, rewards=shifted.rewards + 10.0)
    found = KnownOutcomes(Evidence(shifted, HORIZON, (1.0,), SMALL, jr.key(0)))
    assert found.low == 0.0 and found.high > 9.0
