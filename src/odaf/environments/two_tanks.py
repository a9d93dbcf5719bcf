"""Two tanks, one draining into the other: a plant small enough to try everything on, and its operators, no experts.

    dh1 = ( pump feed / 100 - c1 sqrt(h1) ) dt,      dh2 = ( c1 sqrt(h1) - c2 sqrt(h2) demand / 100 ) dt
    profit = 3 - 10 |h2 - setpoint| - 0.02 |feed - feed before|

Levels in metres over a square metre, dt = 10 s, so flows are in m3/s. The feed works on the second level through the
first one, some steps later. A level of 3 m trips the plant: the shift ends, and costs 1,000. A shift is cut after 240
steps.

The five operators of `write_log` look at the plant once a minute, some of them late, and set the feed in steps of 5 %:
each by a rule of his own, too timid, too nervous or aiming beside the set point. What comes in reaches them as it does
a policy.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from odaf.data.dataset import Dataset

OBSERVATIONS = ("level1", "level2", "setpoint", "demand", "feed_before")
UNITS = {"level1": "m", "level2": "m", "setpoint": "m", "demand": "%", "feed_before": "%", "feed": "%", "profit": "EUR"}
SHIFT_STEPS = 240
STEP_SECONDS = 10.0
HIGHEST_LEVEL = 3.0
TRIP_COST = 1_000.0

_PUMP, _DRAIN1, _DRAIN2 = 0.04, 0.016, 0.022  # m3/s at 100 %, and m2.5/s
_SETPOINTS = (0.8, 1.0, 1.2, 1.5)
_SETPOINT_STEPS = 60  # that a set point holds
_LOOKS_EVERY = 6  # steps between two looks of an operator


@dataclass(frozen=True)
class Operator:
    """How one shift's operator sets the feed: `rate + gain (setpoint + offset - level2)`, clipped and rounded.

    Attributes:
        gain: percent of feed a metre.
        offset: metres that he aims beside the set point.
        rate: percent of feed at the level that he aims for.
        scatter: standard deviation of what he turns it to by whim, in percent.
    """

    gain: float
    offset: float
    rate: float
    scatter: float

    def feed(self, level: float, setpoint: float, rng: np.random.Generator) -> float:
        """Percent, in steps of 5."""
        wanted = self.rate + self.gain * (setpoint + self.offset - level) + self.scatter * rng.standard_normal()
        return float(np.clip(5.0 * np.round(wanted / 5.0), 0.0, 100.0))


OPERATORS = (
    Operator(gain=25.0, offset=0.0, rate=45.0, scatter=8.0),
    Operator(gain=70.0, offset=0.1, rate=50.0, scatter=12.0),
    Operator(gain=15.0, offset=-0.1, rate=55.0, scatter=15.0),
    Operator(gain=120.0, offset=0.0, rate=40.0, scatter=20.0),
    Operator(gain=40.0, offset=-0.05, rate=60.0, scatter=10.0),
)


class TwoTanks:
    """The simulator, with gymnasium's `reset`, `step` and `close`; everything but the start and the demand is certain.

    Observations are those of `OBSERVATIONS`, an action is [feed in percent], a reward the profit of the step.
    """

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts a shift; equal seeds give equal shifts under equal actions."""
        self._random = np.random.default_rng(seed)
        self._levels = self._random.uniform(0.7, 1.3, 2)
        self._demand, self._feed, self._steps = 60.0, 50.0, 0
        self._setpoints = self._random.choice(_SETPOINTS, -(-SHIFT_STEPS // _SETPOINT_STEPS) + 1)
        return self._observation(), {}

    def step(self, action: Any, /) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Ten seconds."""
        feed = float(np.clip(np.ravel(action)[0], 0.0, 100.0))
        between, out = _DRAIN1 * self._levels[0] ** 0.5, _DRAIN2 * self._levels[1] ** 0.5 * self._demand / 100.0
        change = np.array([_PUMP * feed / 100.0 - between, between - out])
        self._levels = np.maximum(self._levels + STEP_SECONDS * change, 0.0)
        moved, self._feed = abs(feed - self._feed), feed
        self._demand = float(
            np.clip(60.0 + 0.97 * (self._demand - 60.0) + 2.0 * self._random.standard_normal(), 30, 90)
        )
        reward = 3.0 - 10.0 * abs(float(self._levels[1]) - self._setpoint) - 0.02 * moved
        self._steps += 1
        tripped = bool(self._levels.max() >= HIGHEST_LEVEL)
        cut = self._steps >= SHIFT_STEPS
        return self._observation(), reward - TRIP_COST * tripped, tripped, cut and not tripped, {"tripped": tripped}

    def close(self) -> None:
        """Nothing is open."""

    @property
    def _setpoint(self) -> float:
        return float(self._setpoints[self._steps // _SETPOINT_STEPS])

    def _observation(self) -> np.ndarray:
        return np.array([*self._levels, self._setpoint, self._demand, self._feed], np.float32)


def write_log(path: Path, shifts: int = 120, seed: int = 0, progress: Callable[[int, int], None] | None = None) -> None:
    """Writes what a historian would keep: a CSV file with a row of units under its headings, a row every ten seconds.

    Columns are `shift`, `time` in seconds, the observations, `feed`, `profit` and `tripped` (0 or 1). Read it with
    `odaf data import FILE --units-row --episode shift --time time --terminated tripped --actions feed --reward profit`.

    Args:
        path: the file.
        shifts: of one operator each, in turn.
        seed: chooses starts, demands and the operators' whims.
        progress: called with (shifts done, shifts in all).
    """
    rng = np.random.default_rng(seed)
    plant = TwoTanks()
    columns = ("shift", "time", *OBSERVATIONS, "feed", "profit", "tripped")
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerow(["-", "s", *(UNITS.get(name, "-") for name in columns[2:])])
        for shift in range(shifts):
            operator = OPERATORS[shift % len(OPERATORS)]
            seen, _ = plant.reset(seed=int(rng.integers(2**31)))
            feed, waits, ended, step = 50.0, int(rng.integers(_LOOKS_EVERY)), False, 0
            while not ended:
                if step % _LOOKS_EVERY == waits:
                    feed = operator.feed(float(seen[1]), float(seen[2]), rng)
                after, profit, tripped, cut, _ = plant.step([feed])
                cells = [*(f"{value:.5g}" for value in seen.tolist()), f"{feed:g}", f"{profit:.5g}", int(tripped)]
                table.writerow([f"S{shift + 1:03}", f"{STEP_SECONDS * step:g}", *cells])
                seen, ended, step = after, tripped or cut, step + 1
            if progress is not None:
                progress(shift + 1, shifts)


def read_log(path: Path) -> Dataset:
    """The log of `write_log`, feed in percent of what the valve can do."""
    return Dataset.load(
        path,
        units_row=True,
        episode="shift",
        time="time",
        terminated="tripped",
        observations=list(OBSERVATIONS),
        actions=["feed"],
        action_bounds={"feed": (0.0, 100.0)},
        reward="profit",
    )
