"""How far a long piece of work on rows has come."""

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (done, all there is to do), in one unit such as rows or bytes."""


class Counter:
    """Adds up what is done and tells a listener, if there is one."""

    def __init__(self, total: int, listener: Progress | None):
        self._total, self._listener, self._done = total, listener, 0

    def add(self, amount: int) -> None:
        """So much more is done."""
        self._done += amount
        if self._listener is not None:
            self._listener(self._done, self._total)
