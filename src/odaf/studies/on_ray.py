"""Where jobs are done: on the machines of a Ray cluster, each job on one core. Ray is an extra, imported when used."""

import contextlib
import importlib
import os
import socket
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from odaf import __version__
from odaf.errors import ConfigError
from odaf.runs.workers import cores, take_one_core, telling

Item = TypeVar("Item")

# How long news of a worker may wait to be heard.
_SECONDS_BETWEEN_NEWS = 0.5
_SECONDS_TO_ANSWER = 10.0
# How often a job begins again because its worker died: one that kills its worker would do so for ever.
_RETRIES = 3
# Bytes of memory that a cluster of this machine sets aside for what jobs hand on; records have a few thousand.
_STORE = 2**27


@dataclass(frozen=True)
class OnRay:
    """The cluster that this process has joined, see `joined`; an `Executor`.

    A job whose worker dies, alone or with its machine, begins again on another, at most three times. What it finds of
    its first try is what it left in the work directory, if the machines share that.

    Attributes:
        width: cores of the cluster, each for a job.
    """

    width: int

    def run(
        self,
        function: Callable[[Item], Any],
        first: Sequence[Item],
        *,
        then: Callable[[Item, Any], Sequence[Item]],
        receive: Callable[[Any], object],
        until: float | None,
    ) -> Generator[tuple[Item, Any], None, None]:
        """See `Executor.run`.

        Raises:
            ConfigError: a machine has another odaf or none, or workers die of the same job again and again.
            Whatever a job raises; the others are stopped.
        """
        ray = _ray()
        news = ray.remote(_News).options(num_cpus=0, max_restarts=-1).remote()
        do = ray.remote(_done).options(num_cpus=1, max_retries=_RETRIES)
        under_way: dict[Any, Item] = {}

        def begin(jobs: Sequence[Item]) -> None:
            under_way.update((do.remote(function, job, news, __version__), job) for job in jobs)

        try:
            begin(first)
            while under_way:
                done, _ = ray.wait([*under_way], timeout=_SECONDS_BETWEEN_NEWS)
                _hear(ray, news, receive)
                for one in done:
                    job = under_way.pop(one)
                    result = _result(ray, one, job)
                    begin(then(job, result))
                    yield job, result
                if until is not None and time.monotonic() >= until:
                    return
        finally:
            for one in under_way:
                ray.cancel(one, force=True)
            ray.kill(news)


@contextlib.contextmanager
def joined(address: str) -> Iterator[OnRay]:
    """A block in which this process is part of a cluster.

    Args:
        address: as Ray has it: "auto" finds the cluster that was started on this machine, `HOST:PORT` is the address of
            a head, and "local" starts one on the cores of this machine, which ends with the block.

    Raises:
        ConfigError: Ray is not installed, there is no such cluster, or it has no core.
    """
    ray = _ray()
    start: dict[str, Any] = {}
    if address == "local":
        start = {"num_cpus": cores(), "include_dashboard": False, "object_store_memory": _STORE}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # whoever wants to report to Ray's makers says so
    try:
        _answers(address)
        ray.init(address, log_to_driver=False, logging_level="error", **start)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"--ray {address}: no cluster could be joined ({_first_line(error)}); start one with `ray start --head`, "
            "join it on the other machines with `ray start --address HOST:PORT`, and give auto or HOST:PORT here; or "
            "give local for the cores of this machine"
        ) from error
    try:
        width = int(ray.cluster_resources().get("CPU", 0))
        if width < 1:
            raise ConfigError(f"--ray {address}: the cluster has no cores; start its nodes with --num-cpus above 0")
        yield OnRay(width)
    finally:
        ray.shutdown()


def _answers(address: str) -> None:
    """Knocks at `HOST:PORT`, where Ray would try for minutes.

    Raises:
        OSError: nobody listens there.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_SECONDS_TO_ANSWER).close()


class _News:
    """An actor: what jobs have told since it was last asked."""

    def __init__(self) -> None:
        self._told: list[Any] = []

    def put(self, news: Any) -> None:
        self._told.append(news)

    def take(self) -> list[Any]:
        told, self._told = self._told, []
        return told


def _done(function: Callable[[Any], Any], job: Any, news: Any, version: str) -> Any:
    """In a worker of the cluster: one job."""
    if version != __version__:
        raise ConfigError(
            f"{_named(job)}: a machine of the cluster has odaf {__version__}, the one that asks has {version}; "
            "install the same on all"
        )
    take_one_core()
    ray, last = _ray(), list[Any]()

    def tell(one: Any) -> None:
        last[:] = [news.put.remote(one)]

    with telling(tell):
        result = function(job)
    with contextlib.suppress(ray.exceptions.RayError):  # whoever listened is lost: the result is worth more
        ray.get(last)  # news comes in order, so all of it is there before the result
    return result


def _hear(ray: Any, news: Any, receive: Callable[[Any], object]) -> None:
    with contextlib.suppress(ray.exceptions.RayError):  # news of a machine that is lost is lost too
        for one in ray.get(news.take.remote()):
            receive(one)


def _result(ray: Any, reference: Any, job: Any) -> Any:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if not isinstance(error.cause, ray.exceptions.RaySystemError):
            raise error.cause from None
        raise ConfigError(
            f"{_named(job)}: a machine of the cluster cannot read what is to be done ({_first_line(error.cause)}); "
            "install the same odaf, and what a study of your own imports, in the Python that Ray runs in there"
        ) from error
    except ray.exceptions.RayError as error:
        raise ConfigError(
            f"{_named(job)}: begun {_RETRIES + 1} times, and its worker was lost each time ({_first_line(error)}); "
            "Ray's log says why, often because memory ran out"
        ) from error


def _named(job: Any) -> str:
    return getattr(job, "name", repr(job))


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise ConfigError(f'--ray: needs ray ({error}); pip install "odaf[ray]" on every machine') from error
