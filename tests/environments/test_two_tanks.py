"""The plant of the examples, its log, and three policies whose true values lie far apart."""

import sys
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf.environments.two_tanks import (
    HIGHEST_LEVEL,
    OBSERVATIONS,
    OPERATORS,
    SHIFT_STEPS,
    TRIP_COST,
    TwoTanks,
    read_log,
    write_log,
)

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
import two_tanks as example  # pyright: ignore[reportMissingImports]


def played(feed, seed: int = 0) -> tuple[list[np.ndarray], list[float], bool]:
    plant = TwoTanks()
    seen, _ = plant.reset(seed=seed)
    rows, rewards = [seen], []
    while True:
        seen, reward, tripped, cut, info = plant.step(np.array([feed(seen)], np.float32))
        rows.append(seen)
        rewards.append(reward)
        assert info == {"tripped": tripped} and not (tripped and cut)
        if tripped or cut:
            return rows, rewards, tripped


def test_a_step_is_its_formulas():
    plant = TwoTanks()
    first, _ = plant.reset(seed=3)
    after, profit, *_ = plant.step([70.0])
    h1, h2, setpoint, demand, before = map(float, first)
    assert (demand, before) == (60.0, 50.0)
    q1, q2 = 0.016 * h1**0.5, 0.022 * h2**0.5 * demand / 100.0
    wanted = h1 + 10.0 * (0.04 * 0.7 - q1), h2 + 10.0 * (q1 - q2)
    np.testing.assert_allclose(after[:2], wanted, rtol=1e-5)
    assert after[4] == 70.0
    assert profit == pytest.approx(3.0 - 10.0 * abs(wanted[1] - setpoint) - 0.02 * 20.0, abs=1e-5)


def test_equal_seeds_give_equal_shifts_and_overflow_trips():
    for one, other in zip(played(lambda _: 45.0, 7)[0], played(lambda _: 45.0, 7)[0], strict=True):
        np.testing.assert_array_equal(one, other)
    rows, rewards, tripped = played(lambda _: 100.0)
    assert tripped and rows[-1][:2].max() >= HIGHEST_LEVEL and rewards[-1] < -TRIP_COST + 3.0
    rows, _, tripped = played(lambda _: 0.0)
    assert not tripped and len(rows) == SHIFT_STEPS + 1 and min(row[:2].min() for row in rows) >= 0.0


def test_the_log_reads_as_its_page_says_and_repeats(tmp_path: Path):
    write_log(tmp_path / "plant.csv", 12)
    write_log(tmp_path / "again.csv", 12)
    assert (tmp_path / "plant.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()
    write_log(tmp_path / "other.csv", 12, seed=1)
    assert (tmp_path / "plant.csv").read_bytes() != (tmp_path / "other.csv").read_bytes()
    log = read_log(tmp_path / "plant.csv")
    assert log.num_episodes == 12 and log.observation_names == OBSERVATIONS
    assert log.observation_units == ("m", "m", "m", "%", "%") and log.action_units == ("%",)
    assert log.episode_lengths().max() == SHIFT_STEPS - 1  # of the last row nobody knows what followed
    assert len(OPERATORS) == 5 and np.unique(log.actions % 5.0).tolist() == [0.0]
    assert "wrong" not in str(log.check())


@pytest.mark.slow
def test_the_three_policies_are_what_they_are_called(tmp_path: Path):
    values = example.main(tmp_path / "out")
    operators = odaf.Dataset.load(tmp_path / "out" / "holdout.h5").episode_returns().mean()
    assert values["good"][0] > operators + 200.0 > values["cloned"][0] + 200.0
    assert values["cloned"][0] > values["undertrained"][0] + 200.0
