"""Jobs side by side: results, order, failures, and workers that do not outlive their parent."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from odaf.experiments.workers import run_jobs

PARENT = """
import sys, time, os
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[1])))
import sleepers
from odaf.experiments.workers import run_jobs

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


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    (tmp_path / "parent.py").write_text(PARENT)
    (tmp_path / "sleepers.py").write_text(SLEEPERS)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    process = subprocess.Popen([sys.executable, str(tmp_path / "parent.py"), str(tmp_path)], env=environment)
    notes = [tmp_path / "one", tmp_path / "two"]
    _until(lambda: all(note.exists() and note.read_text() for note in notes))
    workers = [int(note.read_text()) for note in notes]
    assert all(map(_runs, workers))
    process.send_signal(signal.SIGKILL)
    process.wait()
    _until(lambda: not any(map(_runs, workers)))


def _runs(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


def _until(true) -> None:
    deadline = time.monotonic() + 30
    while not true():
        assert time.monotonic() < deadline, "nothing happened for 30 seconds"
        time.sleep(0.05)
