"""Ctrl-C in a real process: what was trained is saved, with workers too, and the command says at which update."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf.training.interrupts import held_back


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("data") / "log.h5"
    odaf.Dataset.from_arrays(
        rng.normal(size=(60, 2)), rng.uniform(-1, 1, (60, 1)), rng.normal(size=60),
        episode=np.repeat(np.arange(6), 10), action_bounds=(-1, 1),
    ).save(path)  # fmt: skip
    return path


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_interrupted_training_is_saved_where_it_stands(data: Path, tmp_path: Path, workers: str):
    out = tmp_path / "run"
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--seeds", "0", "1"]
    words += ["--hidden-sizes", "8", "--batch-size", "8", "--steps", "5000000", "--stretch", "50", "--quiet"]
    words += ["--checkpoint-every", "5000000", "--workers", workers]
    process = subprocess.Popen(
        [sys.executable, "-m", "odaf", *words],
        env={**os.environ, "PYTHONPATH": str(Path(odaf.__file__).parents[1])},
        stderr=subprocess.PIPE,
        text=True,
    )
    seeds = (0,) if workers == "1" else (0, 1)  # one after another, or side by side
    files = [out / f"seed-{seed}" / "metrics.jsonl" for seed in seeds]
    deadline = time.monotonic() + 200
    while not all(file.exists() and file.stat().st_size for file in files):
        assert process.poll() is None and time.monotonic() < deadline, "nothing was trained"
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=200)
    assert process.returncode == 130, errors
    run = odaf.load_run(out)
    for seed in seeds:
        step = run.summary[seed]["step"]
        assert 0 < step < 5_000_000 and step % 50 == 0 and run.summary[seed]["status"] == "running"
        assert run.files.metrics(seed)[-1]["step"] == step  # nothing after the last saved update was made
        assert re.search(rf"seed {seed} at update {step:,}\b", errors), errors
    assert f"odaf resume {out}" in errors


def test_inside_a_block_where_all_is_saved_an_interrupt_passes_at_once():
    with held_back(lambda: None) as interrupt:
        with pytest.raises(KeyboardInterrupt), interrupt.passing():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
        assert not interrupt.came
        os.kill(os.getpid(), signal.SIGINT)  # held again
        interrupt.wait_for(())
        assert interrupt.came
        with pytest.raises(KeyboardInterrupt), interrupt.passing():
            raise AssertionError("it came before the block")


def test_the_first_interrupt_waits_and_the_second_does_not():
    told = []
    with held_back(lambda: told.append("told")) as interrupt:
        os.kill(os.getpid(), signal.SIGINT)
        interrupt.wait_for(())
        assert interrupt.came and told == ["told"]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
    with pytest.raises(KeyboardInterrupt):  # as before, once it is over
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)
