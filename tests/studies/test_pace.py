"""How many lanes end in the time: by hand, on a clock that the test turns."""

import pytest

from odaf.studies import pace


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(pace, "clock", found)
    return found


def asked(clock: Clock, keeping: pace.Pace, *times: float) -> list[bool]:
    answers = []
    for clock.now in times:
        answers.append(keeping())
    return answers


def test_stops_are_multiples_of_every_interval_and_the_end() -> None:
    assert pace.stops(10, 4, 6) == [4, 6, 8, 10]
    assert pace.stops(3, 5) == [3]


def test_without_a_time_nothing_is_stopped_and_when_it_is_up_everything_is(clock: Clock) -> None:
    stops = pace.stops(100, 10)
    assert not any(asked(clock, pace.Pace(8, stops, None, True), 10.0, 2e3, 3e9))
    assert asked(clock, pace.Pace(8, stops, 50.0, False), 10.0, 30.0, 49.9, 50.0) == [False, False, False, True]


def test_as_many_lanes_as_end_in_the_time_are_named_after_the_third_stretch(clock: Clock) -> None:
    """Five seconds to compile, then a second an update: of ten stretches of ten, three end at 35."""
    stops, times = pace.stops(100, 10), (15.0, 25.0, 35.0)
    keeping = pace.Pace(8, stops, 105.0, True)
    assert asked(clock, keeping, *times) == [False] * 3 and keeping.fitting is None
    clock.now = 0.0
    keeping = pace.Pace(8, stops, 104.0, True)  # 69 are left; again 5 to compile, so 64 of 100 for all lanes
    assert asked(clock, keeping, *times) == [False, False, True] and keeping.fitting == 5


def test_where_not_even_one_would_end_or_fewer_is_no_answer_it_goes_on(clock: Clock) -> None:
    stops, times = pace.stops(100, 10), (15.0, 25.0, 35.0)
    for until, may_shrink in ((50.0, True), (104.0, False)):
        clock.now = 0.0
        keeping = pace.Pace(8, stops, until, may_shrink)
        assert not any(asked(clock, keeping, *times)) and keeping.fitting is None
