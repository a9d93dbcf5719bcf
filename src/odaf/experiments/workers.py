"""Jobs side by side on one machine, each process on a core of its own."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

Job = TypeVar("Job")


def run_jobs(function: Callable[[Job], Any], jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, Any]]:
    """Call `function` on every job and yield (job, result) as they finish.

    With one worker everything happens in this process. With more, each worker process is bound to its share of the
    cores before it loads an array library, so that workers do not fight over threads; jobs start in the given order.
    Workers end with this process, however it ends.

    Args:
        function: importable by name, so that a fresh process finds it.
        jobs: picklable descriptions.
        workers: processes at the same time.

    Raises:
        Whatever a job raises; jobs that have not started are then dropped.
    """
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield job, function(job)
        return
    context = multiprocessing.get_context("spawn")
    numbers = context.Queue()
    for number in range(workers):
        numbers.put(number)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(numbers, workers)) as pool:
        futures = {pool.submit(function, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begin(numbers: Any, workers: int) -> None:
    threading.Thread(target=_leave_with_parent, args=(os.getppid(),), daemon=True).start()
    _bind(numbers, workers)


def _leave_with_parent(parent: int) -> None:
    """End this process once its parent is gone: nobody is left to take its result."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _bind(numbers: Any, workers: int) -> None:
    """Give this process its share of the cores; where the system cannot bind processes, leave it unbound."""
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    share = max(1, len(cores) // workers)
    first = numbers.get() * share % len(cores)
    os.sched_setaffinity(0, cores[first : first + share])
