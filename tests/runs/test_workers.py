"""Jobs side by side: results, order, failures, and workers that do not outlive their parent."""

import functools
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from golden import jobs
from odaf.runs.workers import run_jobs

PARENT = """
import sys, time, os
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[1])))
import sleepers
from odaf.runs.workers import run_jobs

if __name__ == "__main__":
    list(run_jobs(sleepers.note_and_sleep, [Path(sys.argv[1]) / "one", Path(sys.argv[1]) / "two"], 2))
"""
SLEEPERS = """
import os, time


def note_and_sleep(path):
    path.write_text(str(os.getpid()))
    time.sleep(60)
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_comes_back_with_its_result(workers: int) -> None:
    assert sorted(run_jobs(math.factorial, [1, 2, 3], workers)) == [(1, 1), (2, 2), (3, 6)]


def test_a_failing_job_raises() -> None:
    with pytest.raises(ValueError, match="negative"):
        list(run_jobs(math.factorial, [-1, 2], 2))


@pytest.mark.parametrize("workers", [1, 2])
def test_what_jobs_tell_is_heard_before_their_result(workers: int) -> None:
    heard: list[tuple[int, object]] = []
    for job, _ in run_jobs(jobs.halve, [4, 6, 8], workers, receive=heard.append):
        assert [part for number, part in heard if number == job] == ["half of", job]
    assert len(heard) == 6


@pytest.mark.parametrize("workers", [1, 2])
def test_preparation_comes_once_before_the_first_job_of_each_process(workers: int) -> None:
    prepare = functools.partial(jobs.prepare, 7)
    assert [found for _, found in run_jobs(jobs.preparations, [0, 1, 2], workers, prepare=prepare)] == [[7]] * 3
    assert jobs.prepared == ([7] if workers == 1 else [])
    jobs.prepared.clear()


def test_single_job_runs_apart_when_it_has_to() -> None:
    assert next(run_jobs(jobs.process, [0], 2))[1] == os.getpid()
    assert next(run_jobs(jobs.process, [0], 2, always_apart=True))[1] != os.getpid()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_finished_job_may_bring_further_ones(workers: int) -> None:
    def then(job: int, result: int) -> list[int]:
        assert result == math.factorial(job)
        return [job - 1] if job > 1 else []

    assert sorted(job for job, _ in run_jobs(math.factorial, [3], workers, then=then)) == [1, 2, 3]


def test_what_still_runs_at_the_end_of_the_time_is_stopped() -> None:
    began = time.monotonic()
    jobs_ = [0.0, 60.0, 61.0]  # the last one waits for the only worker
    assert list(run_jobs(jobs.sleep, jobs_, 1, until=began + 3.0)) == [(0.0, 0.0)]
    assert time.monotonic() - began < 20.0


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_when_their_parent_is_killed_or_interrupted(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "parent.py").write_text(PARENT)
    (tmp_path / "sleepers.py").write_text(SLEEPERS)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py"), str(tmp_path)],
        env=environment,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    )
    notes = [tmp_path / "one", tmp_path / "two"]
    _until(lambda: all(note.exists() and note.read_text() for note in notes))
    workers = [int(note.read_text()) for note in notes]
    assert all(map(_runs, workers))
    os.killpg(process.pid, how) if how == signal.SIGINT else process.kill()  # a terminal interrupts all of them
    _, errors = process.communicate(timeout=30)
    assert errors.count("Traceback") == (how == signal.SIGINT)  # the parent's own
    _until(lambda: not any(map(_runs, workers)))


def _runs(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


def _until(true) -> None:
    deadline = time.monotonic() + 30
    while not true():
        assert time.monotonic() < deadline, "nothing happened for 30 seconds"
        time.sleep(0.05)
