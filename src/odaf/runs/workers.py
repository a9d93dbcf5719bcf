"""Jobs side by side on one machine, each process on a core of its own."""

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from typing import Any, TypeVar

Job = TypeVar("Job")

# How long news of a worker may wait to be heard.
_SECONDS_BETWEEN_NEWS = 0.2

# Where jobs are done: what `send` hands its news to, and the event that asks a worker process to stop.
_tell: Callable[[Any], object] | None = None
_stop: Any = None


def run_jobs(
    function: Callable[[Job], Any],
    jobs: Sequence[Job],
    workers: int,
    *,
    prepare: Callable[[], object] | None = None,
    receive: Callable[[Any], object] | None = None,
    always_apart: bool = False,
    then: Callable[[Job, Any], Iterable[Job]] | None = None,
    until: float | None = None,
    cores: int | None = None,
    asked_to_stop: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Job, Any]]:
    """Call `function` on every job and yield (job, result) as they finish.

    With one worker everything happens in this process. With more, each worker process is bound to its share of the
    cores before it loads an array library, so that workers do not fight over threads; jobs start in the given order.
    Workers end with this process, however it ends, and at once when the caller gives up or is interrupted.

    Args:
        function: importable by name, so that a fresh process finds it.
        jobs: picklable descriptions.
        workers: processes at the same time.
        prepare: picklable; called once in each process before its first job.
        receive: called in this process with whatever jobs `send`, in the order told by each.
        always_apart: a single job, or a single worker, runs in a process of its own too.
        then: called in this process with each finished job and its result; the jobs that it returns are done as well.
        until: a time of `time.monotonic` when jobs that still run are stopped; neither they nor those that wait have a
            result. Only a process can be stopped, so a single worker is one of its own then.
        cores: cores that an array library in a worker is to count on, whether there are so many or not; None gives each
            worker its share of those there are.
        asked_to_stop: once it says so, jobs that have not started are dropped, those that have hear of it by
            `stopping`, and the last result comes when they are done.

    Raises:
        Whatever a job raises; jobs that have not started are then dropped, and those that have are waited for.
    """
    apart = always_apart or (workers > 1 and (then is not None or len(jobs) > 1))
    if not apart and until is None:
        yield from _one_by_one(function, jobs, prepare, receive, then)
        return
    workers = max(1, workers)
    context = multiprocessing.get_context("spawn")
    numbers, news = context.Queue(), context.SimpleQueue()
    for number in range(workers):
        numbers.put(number)
    leave, stay = context.Pipe(duplex=False)
    stop = context.Event()
    begin = (leave, numbers, workers, cores, news, stop, pickle.dumps(prepare))
    with leave, stay, ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=begin) as pool:
        waiting = {pool.submit(function, job): job for job in jobs}
        try:
            while waiting:
                done, _ = wait(waiting, timeout=_SECONDS_BETWEEN_NEWS, return_when=FIRST_COMPLETED)
                while not news.empty():
                    _receive(news.get(), receive)
                if not stop.is_set() and asked_to_stop():
                    stop.set()
                    for future in waiting:
                        future.cancel()
                for future in done:
                    job = waiting.pop(future)
                    if future.cancelled():
                        continue
                    result = future.result()
                    for further in () if then is None or stop.is_set() else then(job, result):
                        waiting[pool.submit(function, further)] = further
                    yield job, result
                if until is not None and time.monotonic() >= until:
                    stay.close()  # nobody waits for what is still running
                    pool.shutdown(wait=False, cancel_futures=True)
                    return
        except Exception:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        except BaseException:  # nobody waits for what is still running
            stay.close()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def send(news: Any) -> None:
    """From inside a job: hand something picklable and small to the `receive` of whoever runs the jobs."""
    if _tell is not None:
        _tell(news)


def stopping() -> bool:
    """From inside a job: whether whoever runs the jobs wants them to come to an end."""
    return _stop is not None and _stop.is_set()


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def telling(receive: Callable[[Any], object]) -> Iterator[None]:
    """A block whose jobs hand to `receive` what they `send`."""
    global _tell
    before, _tell = _tell, receive
    try:
        yield
    finally:
        _tell = before


def _one_by_one(function: Any, jobs: Any, prepare: Any, receive: Any, then: Any) -> Iterator[tuple[Any, Any]]:
    with telling(lambda news: _receive(news, receive)):
        if prepare is not None:
            prepare()
        waiting = deque(jobs)
        while waiting:
            job = waiting.popleft()
            result = function(job)
            waiting.extend(() if then is None else then(job, result))
            yield job, result


def _receive(news: Any, receive: Callable[[Any], object] | None) -> None:
    if receive is not None:
        receive(news)


def _begin(leave: Any, numbers: Any, workers: int, cores: int | None, news: Any, stop: Any, pickled: bytes) -> None:
    global _tell, _stop
    # Ctrl-C on a terminal reaches every process; the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _bind(numbers, workers, cores)
    threading.Thread(target=_leave_with_parent, args=(leave,), daemon=True).start()
    _tell, _stop = news.put, stop
    prepare = pickle.loads(pickled)  # our parent's own; what it imports starts its threads on our cores
    if prepare is not None:
        prepare()


def begin_beside(leave: Any) -> None:
    """First in a process that works beside a training: one core for its array library, and no accelerator.

    Must come before an array library is loaded. The process ends with its parent, as those of `run_jobs` do.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    take_one_core()
    threading.Thread(target=_leave_with_parent, args=(leave,), daemon=True).start()


def take_one_core() -> None:
    """First in a process that others work beside: its array library counts on one core, and on no accelerator."""
    os.environ |= {"NPROC": "1", "OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}


def _leave_with_parent(leave: Any) -> None:
    """End this process once its parent has closed the other end, or is gone: nobody is left to take its result."""
    try:
        leave.recv()
    except (EOFError, OSError):
        os._exit(1)


def _bind(numbers: Any, workers: int, cores: int | None) -> None:
    """Give this process its share of the cores, before an array library counts them.

    Where the system cannot bind processes, or has fewer cores than are wanted, the library is told their number alone.
    """
    if cores is not None:
        os.environ["NPROC"] = str(cores)
    if not hasattr(os, "sched_setaffinity"):
        return
    available = sorted(os.sched_getaffinity(0))
    share = min(cores or max(1, len(available) // workers), len(available))
    first = numbers.get() * share
    os.sched_setaffinity(0, {available[(first + place) % len(available)] for place in range(share)})
