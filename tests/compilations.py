"""How many programs JAX had to get from its compiler, or from the folder of compiled programs, in a block of code."""

import contextlib
from collections.abc import Iterator

import jax

_EVENT = "/jax/core/compile/backend_compile_duration"


@contextlib.contextmanager
def counted() -> Iterator[list[str]]:
    """Yields a list that grows by the name of each program that was not ready in this process."""
    programs: list[str] = []

    def listener(event: str, duration_secs: float, **about: str | int) -> None:
        del duration_secs
        if event == _EVENT:
            programs.append(str(about.get("fun_name", event)))

    jax.monitoring.register_event_duration_secs_listener(listener)
    try:
        yield programs
    finally:
        jax.monitoring.unregister_event_duration_listener(listener)
