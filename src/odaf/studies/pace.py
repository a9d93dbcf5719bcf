"""How many trainings of a program fit into the time: judged by its first stretches, before more is spent on it."""

import time
from collections.abc import Sequence

# Stretches after which it is judged; the first is not counted, for it may hold what is done once.
_WATCHED = 3


class Pace:
    """Asked after every stretch of lanes whether to stop.

    It says so when the time is up, and once early on: when so many lanes would not come to their ends in time, and
    fewer would. It takes the time of a stretch to grow with the lanes, as it does on a device that is filled; where
    that is too hopeful, the smaller program is judged in its turn.

    Args:
        lanes: trainings that are under way.
        stops: updates after each stretch, the last one at the end.
        until: when the time is up, in seconds of `clock`; None never.
        may_shrink: whether fewer lanes are an answer.

    Attributes:
        fitting: how many lanes would come to their ends; None unless that is why it said so.
    """

    def __init__(self, lanes: int, stops: Sequence[int], until: float | None, may_shrink: bool):
        self.fitting: int | None = None
        self._lanes, self._stops, self._until, self._may_shrink = lanes, stops, until, may_shrink
        self._begun, self._ends = clock(), list[float]()

    def __call__(self) -> bool:
        """Whether to stop here."""
        if self._until is None:
            return False
        now = clock()
        if now >= self._until:
            return True
        self._ends.append(now)
        if self._may_shrink and len(self._ends) == _WATCHED < len(self._stops):
            self.fitting = self._judged(self._until - now)
        return self.fitting is not None

    def _judged(self, left: float) -> int | None:
        """Lanes of a smaller program that ends in the seconds that are left; None for all of them, or for none."""
        first, *_, last = self._ends
        of_update = (last - first) / (self._stops[_WATCHED - 1] - self._stops[0])
        if of_update * (self._stops[-1] - self._stops[_WATCHED - 1]) <= left:
            return None
        again = max(0.0, first - self._begun - of_update * self._stops[0])  # to compile, and what is fitted beforehand
        whole = of_update * self._stops[-1]
        fitting = int(self._lanes * max(0.0, left - again) / whole)
        return fitting if 1 <= fitting < self._lanes else None


def clock() -> float:
    """Seconds, as `time.monotonic` counts them."""
    return time.monotonic()


def stops(steps: int, *intervals: int) -> list[int]:
    """Updates after which a training comes to a stop: multiples of each interval, and the end."""
    return sorted({steps}.union(*(range(each, steps, each) for each in intervals)))
