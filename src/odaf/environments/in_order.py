"""Episodes of several bodies that play side by side, in the order they were begun.

An episode's length must not decide whether it is recorded, or short episodes would be over-counted. So episodes are
numbered as they begin, and the record is the shortest run of episodes from the first that holds enough steps.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TypeVar, runtime_checkable


@runtime_checkable
class Played(Protocol):
    """An episode that is being played: how many steps it has, and whether it is over."""

    length: int
    finished: bool


Episode = TypeVar("Episode", bound=Played)


def play_in_order(
    slots: int,
    transitions: int,
    begin: Callable[[int], Episode],
    step: Callable[[Mapping[int, Episode]], None],
    advance: Callable[[int], None] = lambda steps: None,
) -> list[Episode]:
    """The episodes from the first that hold `transitions` steps or more together; the last may not be over.

    Args:
        slots: how many play side by side.
        transitions: steps wanted.
        begin: puts the body of a slot at the start of a new episode.
        step: plays one step in the slots it is given, and writes it into their episodes.
        advance: called after every step with the number of steps played.
    """
    episodes = [begin(slot) for slot in range(slots)]
    playing: list[int | None] = list(range(slots))
    played = 0
    while True:
        needed = _needed(episodes, transitions) if played >= transitions else None
        if needed is not None:
            # Later episodes will not be part of the record; once the earlier ones are over, it is complete.
            playing = [number if number is not None and number < needed else None for number in playing]
            if all(number is None or number == needed - 1 for number in playing):
                return episodes[:needed]
        now = {slot: episodes[number] for slot, number in enumerate(playing) if number is not None}
        step(now)
        for slot, episode in now.items():
            played += 1
            if episode.finished:
                playing[slot] = None
                if needed is None:
                    playing[slot] = len(episodes)
                    episodes.append(begin(slot))
        advance(min(played, transitions))


def _needed(episodes: Sequence[Played], transitions: int) -> int | None:
    """How many episodes from the first hold enough steps already; None if all of them do not."""
    total = 0
    for count, episode in enumerate(episodes, 1):
        total += episode.length
        if total >= transitions:
            return count
    return None
