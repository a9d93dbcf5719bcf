"""Problems small enough to know every value by hand: the critics must find them.

Thresholds: the largest error of 12 seeds was measured for each state; the tests allow about three times as much.
"""

import functools

import numpy as np
import pytest

from odaf.algorithms.ensemble_sac import EnsembleSAC
from probes import grounds

DISCOUNT = 0.9
# name: (reward, successor, truly over, value)
STATES = {
    "one step, reward 1, the end": (1.0, None, True, 1.0),
    "no reward yet, then the next state": (0.0, "reward 1, the end", False, DISCOUNT),
    "reward 1, the end": (1.0, None, True, 1.0),
    "reward 1 for ever": (1.0, "reward 1 for ever", False, 1.0 / (1.0 - DISCOUNT)),
    "nothing for ever": (0.0, "nothing for ever", False, 0.0),
    "a time-out before reward for ever": (0.0, "reward 1 for ever", False, DISCOUNT / (1.0 - DISCOUNT)),
    "the end before reward for ever": (0.0, "reward 1 for ever", True, 0.0),
}
NAMES = list(STATES)
ACTIONS = np.linspace(-1.0, 1.0, 16)[:, None]


def _one_hot(name: str | None) -> np.ndarray:
    return np.eye(len(NAMES), dtype=np.float32)[NAMES.index(name)] if name else np.zeros(len(NAMES), np.float32)


def _log(names=NAMES):
    """Sixteen actions in every state; no action matters."""
    columns = [(_one_hot(n), a, STATES[n][0], _one_hot(STATES[n][1]), STATES[n][2]) for n in names for a in ACTIONS]
    return grounds.rows(*zip(*columns, strict=True))


def _learner(**fields) -> EnsembleSAC:
    rates = {"critic_learning_rate": 3e-3, "actor_learning_rate": 3e-3, "target_rate": 0.05}
    return EnsembleSAC(**{**grounds.FAST, **rates, "num_critics": 2, "discount": DISCOUNT, **fields})


@functools.cache
def _states(seeds: int = 3):
    return grounds.trained(_learner(), _log(), updates=1500, seeds=seeds)


@pytest.mark.parametrize("name", NAMES)
def test_the_value_is_found(name):
    values = grounds.values_at(_states(), _one_hot(name), ACTIONS)
    assert np.all(np.abs(values - STATES[name][3]) < 0.1), values


def test_the_value_range_holds_what_entropy_would_inflate():
    """A constant temperature of 1 adds up to log 2 a step: an endless reward of 1 looks worth more than 10."""
    learner = _learner(entropy_in_backup=True, temperature_learning_rate=0.0)
    ground = _log(["reward 1 for ever", "nothing for ever"])
    states = grounds.trained(learner, ground, updates=1500, seeds=2, value_bounds=[(0.0, 10.0), (-np.inf, np.inf)])
    bounded, free = grounds.values_at(states, _one_hot("reward 1 for ever"), ACTIONS)
    assert abs(bounded - 10.0) < 0.2 and free > 12.0
