"""Real processes, really killed: what they leave is continued to the bits of a run that was never touched."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import odaf

STEPS = 1200


def _start(directory: Path, die_at: int = 0) -> subprocess.Popen:
    script = Path(__file__).with_name("tiny_learner.py")
    source = Path(odaf.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, str(script), str(directory), str(STEPS), str(die_at)],
        env={**os.environ, "PYTHONPATH": str(source)},
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(process: subprocess.Popen) -> int:
    _, errors = process.communicate(timeout=120)
    assert process.returncode in (0, -signal.SIGKILL), errors
    return process.returncode


def _newest(directory: Path) -> int:
    names = [child.name for child in (directory / "seed-0" / "checkpoints").glob("0*")]
    return max((int(name) for name in names), default=-1)


def test_killed_runs_end_with_the_bits_of_an_unbroken_one(tiny, tmp_path):
    unbroken, killed = tmp_path / "unbroken", tmp_path / "killed"
    assert _finish(_start(unbroken)) == 0
    rng = random.Random(0)

    deaths = 0
    for die_at in (5, 60):  # inside a write: the first files of the run, then a checkpoint
        deaths += _finish(_start(killed, die_at)) == -signal.SIGKILL
    for _ in range(2):  # from outside, at any moment after training has got further
        process, before = _start(killed), _newest(killed)
        deadline = time.monotonic() + 60
        while _newest(killed) <= before and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.04))
        process.kill()
        deaths += _finish(process) == -signal.SIGKILL
    between = _newest(killed)
    assert deaths >= 3 and 0 < between < STEPS

    assert _finish(_start(killed)) == 0
    arrays = tiny.arrays_of(killed)
    assert arrays == tiny.arrays_of(unbroken) and len(arrays) == 1 + STEPS // 200 + 2  # one in ten, and the last three
    lines = tiny.lines_of(killed)
    assert lines == tiny.lines_of(unbroken)
    assert [line["step"] for line in lines if "tiny/loss" in line] == list(range(10, STEPS + 1, 10))
    for file in (unbroken / "seed-0" / "evaluations").iterdir():
        with np.load(file) as ours, np.load(killed / "seed-0" / "evaluations" / file.name) as theirs:
            np.testing.assert_array_equal(ours["actions"], theirs["actions"])
