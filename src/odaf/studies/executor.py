"""Where jobs are done: on this machine, in this process or in several."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

from odaf.runs.workers import run_jobs

Item = TypeVar("Item")


@runtime_checkable
class Executor(Protocol):
    """What the schedule needs of a place to do jobs in; a cluster offers the same two.

    Functions are importable by name and jobs picklable, so that another process, or another machine, can do them.
    """

    @property
    def width(self) -> int:
        """How many jobs may be under way at once."""
        ...

    def run(
        self,
        function: Callable[[Item], Any],
        first: Sequence[Item],
        *,
        then: Callable[[Item, Any], Sequence[Item]],
        receive: Callable[[Any], object],
        until: float | None,
    ) -> Generator[tuple[Item, Any], None, None]:
        """Calls `function` on every job and yields each with its result as they finish; closing it stops what runs.

        Args:
            function: what to call.
            first: the jobs to begin with.
            then: takes each finished job and its result, and says which begin next.
            receive: takes whatever a job tells (`odaf.runs.workers.send`).
            until: a time of `time.monotonic` when jobs that still run are stopped; None waits for all.
        """
        ...


@dataclass(frozen=True)
class Here:
    """This machine: one job after another in this process, or several in processes on cores of their own.

    Attributes:
        width: jobs at the same time.
    """

    width: int = 1

    def run(
        self,
        function: Callable[[Item], Any],
        first: Sequence[Item],
        *,
        then: Callable[[Item, Any], Sequence[Item]],
        receive: Callable[[Any], object],
        until: float | None,
    ) -> Generator[tuple[Item, Any], None, None]:
        """See `Executor.run`."""
        yield from run_jobs(function, first, self.width, then=then, receive=receive, until=until)
