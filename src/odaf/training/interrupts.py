"""Ctrl-C while a seed is trained: kept until the stretch is done and saved, because its state is nowhere else."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax


class Interrupt:
    """Whether Ctrl-C came while it was held back."""

    def __init__(self, heard: bool):
        self.came, self._heard = False, heard

    @contextlib.contextmanager
    def passing(self) -> Iterator[None]:
        """Lets Ctrl-C through at once inside the block, where all that counts is saved.

        Raises:
            KeyboardInterrupt: it came before.
        """
        if not self._heard:
            yield
            return
        if self.came:
            raise KeyboardInterrupt
        holding = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, holding)

    def wait_for(self, arrays: Any) -> None:
        """Returns when `arrays` are computed. Python hears no signal inside such a wait, so another thread does it."""
        if not self._heard:
            jax.block_until_ready(arrays)
            return
        waiting = threading.Thread(target=jax.block_until_ready, args=(arrays,), daemon=True)
        waiting.start()
        waiting.join()


@contextlib.contextmanager
def held_back(told: Callable[[], object]) -> Iterator[Interrupt]:
    """Notes the first Ctrl-C inside the block instead of raising it; a second one raises at once.

    Outside the main thread, which alone hears signals, and where somebody else handles them, nothing is changed.

    Args:
        told: called when the first comes, so that the user knows what is waited for.
    """
    heard = threading.current_thread() is threading.main_thread()
    if not heard or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield Interrupt(heard=False)
        return
    interrupt = Interrupt(heard=True)

    def first(number: int, frame: object) -> None:
        interrupt.came = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        told()

    signal.signal(signal.SIGINT, first)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
