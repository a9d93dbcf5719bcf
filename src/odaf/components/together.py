"""Fits of many trainings in one compiled program: each thinks it is alone, and they meet at every stretch.

`run_together` runs functions in threads. Where one of them asks `fit` for a stretch of steps, it waits until all others
ask too or have ended; the stretches that are alike but for their arrays then become lanes of one call. So whatever a
learner does before its first update needs no second form for many seeds, and side models of many seeds cost a device
what one costs where one leaves it idle.
"""

import contextvars
import functools
import threading
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import jax.random as jr

Result = TypeVar("Result")

_meeting: contextvars.ContextVar["_Meeting | None"] = contextvars.ContextVar("meeting", default=None)


def call(function: Callable[..., Any], static: Hashable, shared: tuple[Any, ...], *arguments: Any) -> Any:
    """`function(static, shared, *arguments)`, in one program with the calls of other threads that are like it.

    Args:
        function: pure, and a function of a module, so that it is compiled once.
        static: what the program is made for, equal for calls that may share it.
        shared: whole numbers, equal for calls that may share it; handed over as arrays.
        *arguments: trees of arrays, of which each call has its own.
    """
    meeting = _meeting.get()
    if meeting is None:
        return _alone(function, static, _numbers(shared), *arguments)
    return meeting.join(function, static, shared, arguments)


def run_together(functions: Sequence[Callable[[], Result]], lanes: int) -> list[Result | Exception]:
    """What each function returns or raises; what they `call` on the way is done together.

    Random keys, data and numbers are each one's own, so a function's result is the one it has alone, up to rounding.
    Its bits belong to the number of lanes, not to who else is there.

    Args:
        functions: at most as many as there are lanes.
        lanes: of the programs.

    Raises:
        KeyboardInterrupt: somebody pressed Ctrl-C; the functions are left where they are.
    """
    if lanes == 1:
        return [_outcome(function) for function in functions]
    meeting = _Meeting(len(functions), lanes)
    results: list[Any] = [None] * len(functions)

    def work(place: int) -> None:
        _meeting.set(meeting)
        try:
            results[place] = _outcome(functions[place])
        except _LeftBehind:
            pass
        finally:
            meeting.leave()

    threads = [threading.Thread(target=work, args=(place,), daemon=True) for place in range(len(functions))]
    for thread in threads:
        thread.start()
    try:
        meeting.serve()
    except BaseException:
        meeting.abandon()
        raise
    for thread in threads:
        thread.join()
    return results


def _outcome(function: Callable[[], Result]) -> Result | Exception:
    try:
        return function()
    except Exception as error:  # the caller decides whether the others matter without it
        return error


class _LeftBehind(BaseException):
    """Ends a thread whose meeting was given up."""


class _Request:
    def __init__(self, key: Hashable, function: Callable[..., Any], static: Any, shared: tuple, arguments: tuple):
        self.key, self.function, self.static, self.shared, self.arguments = key, function, static, shared, arguments
        self.result: Any = None
        self.error: BaseException | None = None
        self.done = False


class _Meeting:
    def __init__(self, members: int, lanes: int):
        self._present, self._lanes = members, lanes
        self._changed = threading.Condition()
        self._waiting: list[_Request] = []
        self._given_up = False

    def join(self, function: Callable[..., Any], static: Hashable, shared: tuple, arguments: tuple) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        request = _Request((function, static, shared, structure, shapes), function, static, shared, arguments)
        with self._changed:
            self._waiting.append(request)
            self._changed.notify_all()
            self._changed.wait_for(lambda: request.done or self._given_up)
        if not request.done:
            raise _LeftBehind
        if request.error is not None:
            raise request.error
        return request.result

    def leave(self) -> None:
        with self._changed:
            self._present -= 1
            self._changed.notify_all()

    def abandon(self) -> None:
        with self._changed:
            self._given_up = True
            self._changed.notify_all()

    def serve(self) -> None:
        """In the calling thread: answers requests until all members have left."""
        while True:
            with self._changed:
                while len(self._waiting) < self._present:
                    self._changed.wait(0.1)  # not for ever, so that Ctrl-C is heard
                if not self._present:
                    return
                requests, self._waiting = self._waiting, []
            groups: dict[Hashable, list[_Request]] = {}
            for request in requests:
                groups.setdefault(request.key, []).append(request)
            for group in groups.values():
                self._answer(group)
            with self._changed:
                for request in requests:
                    request.done = True
                self._changed.notify_all()

    def _answer(self, group: list[_Request]) -> None:
        first = group[0]
        filled = [*group, *[first] * (self._lanes - len(group))]
        try:
            stacked = jax.tree.map(_stack, *(request.arguments for request in filled))
            results = _lanes(first.function, first.static, _numbers(first.shared), *stacked)
            for place, request in enumerate(group):
                request.result = jax.tree.map(lambda leaf, place=place: leaf[place], results)
        except Exception as error:
            for request in group:
                request.error = error


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def _alone(function: Callable[..., Any], static: Any, shared: Any, *arguments: Any) -> Any:
    return function(static, shared, *arguments)


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def _lanes(function: Callable[..., Any], static: Any, shared: Any, *arguments: Any) -> Any:
    return jax.vmap(lambda *own: function(static, shared, *own))(*arguments)


def _numbers(values: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(jnp.asarray(value, jnp.int32) for value in values)


def _stack(*leaves: Any) -> Any:
    if jnp.issubdtype(leaves[0].dtype, jax.dtypes.prng_key):
        return jr.wrap_key_data(jnp.stack([jr.key_data(leaf) for leaf in leaves]), impl=jr.key_impl(leaves[0]))
    return jnp.stack(leaves)
