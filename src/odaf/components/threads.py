"""Fits side by side on a processor's cores, where one program alone leaves most of the second core idle."""

import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax

from odaf.components.critics import usable_cores
from odaf.components.fitting import Progress

Result = TypeVar("Result")


def parts_of(members: int) -> int:
    """How many parts of one size to make of members that know nothing of each other: one for each core, if it goes."""
    cores = usable_cores() if jax.default_backend() == "cpu" else 1
    return max(parts for parts in range(1, min(cores, members) + 1) if members % parts == 0)


def in_threads(fits: Sequence[Callable[[Progress], Result]], progress: Progress) -> list[Result]:
    """What each fit returns, each in a thread of its own; one alone in this thread.

    Args:
        fits: each called with where it says how far it is.
        progress: called in this thread with (steps that all have done, steps in all).

    Raises:
        Exception: what the first fit that failed raised; the others are stopped after their stretch.
    """
    if len(fits) == 1:
        return [fits[0](progress)]
    news: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    given_up = threading.Event()

    def work(place: int) -> None:
        def told(done: int, steps: int) -> None:
            if given_up.is_set():
                raise _GivenUp
            news.put((place, (done, steps)))

        try:
            news.put((place, _Ended(fits[place](told))))
        except BaseException as error:
            news.put((place, error))

    threads = [threading.Thread(target=work, args=(place,), daemon=True) for place in range(len(fits))]
    results: dict[int, Result] = {}
    done, told = [0] * len(fits), 0
    for thread in threads:
        thread.start()
    try:
        while len(results) < len(fits):
            place, heard = news.get()
            if isinstance(heard, BaseException):
                raise heard
            if isinstance(heard, _Ended):
                results[place] = heard.result
                continue
            done[place], steps = heard
            if min(done) > told:
                told = min(done)
                progress(told, steps)
    finally:
        given_up.set()
        for thread in threads:
            thread.join()
    return [results[place] for place in range(len(fits))]


class _Ended:
    def __init__(self, result: Any):
        self.result = result


class _GivenUp(BaseException):
    """Ends a fit whose result nobody waits for."""
