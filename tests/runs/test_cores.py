"""The bits of a run belong to a number of cores: it is in the record, and a resume keeps to it on another machine."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf.components.critics import usable_cores

# A batch of 256 through wide layers is shared between cores, and its sums are then added in another order.
COMMAND = """
import os, sys
os.sched_setaffinity(0, [int(core) for core in sys.argv[1].split()])
from odaf.cli import main
sys.exit(main(sys.argv[2:]))
"""
# Of this worker, those that it left to the others included.
CORES = os.environ.get("ODAF_TESTS_CORES", "").split() or sorted(getattr(os, "sched_getaffinity", lambda _: [])(0))
needs_two_cores = pytest.mark.skipif(len(CORES) < 2, reason="needs two cores to choose from")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("data") / "log.h5"
    odaf.Dataset.from_arrays(
        rng.normal(size=(600, 11)), rng.uniform(-1, 1, (600, 3)), rng.normal(size=600),
        episode=np.repeat(np.arange(6), 100), action_bounds=(-1, 1),
    ).save(path)  # fmt: skip
    return path


def _odaf(cores: int, *words: str | Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "NPROC"}
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, " ".join(map(str, CORES[:cores])), *map(str, words)],
        env=environment | {"PYTHONPATH": str(Path(odaf.__file__).parents[1])},
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stderr


def _state(out: Path, step: int, seed: int = 0) -> bytes:
    return (out / f"seed-{seed}" / "checkpoints" / f"{step:08d}" / "state.eqx").read_bytes()


@needs_two_cores
def test_a_run_begun_on_one_core_keeps_its_bits_on_two(data: Path, tmp_path: Path):
    train = ("train", "behaviour-cloning", "--data", data, "--evaluate-every", "0")
    _odaf(1, *train, "--steps", "120", "--checkpoint-every", "60", "--out", tmp_path / "whole")
    assert json.loads((tmp_path / "whole" / "config.json").read_text())["cores"] == 1
    shutil.copytree(tmp_path / "whole", tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "seed-0" / "checkpoints" / "00000120")  # as if it had been killed after 60
    said = _odaf(2, "resume", tmp_path / "cut")
    assert _state(tmp_path / "cut", 120) == _state(tmp_path / "whole", 120)
    assert "not with the bits" not in said
    record = json.loads((tmp_path / "cut" / "environment.json").read_text())
    assert [record["cores"], record["resumed"][0]["cores"]] == [1, 1]


@needs_two_cores
@pytest.mark.slow
def test_workers_and_machines_may_change_and_the_cores_of_a_seed_may_not(data: Path, tmp_path: Path):
    train = ("train", "behaviour-cloning", "--data", data, "--evaluate-every", "0", "--seeds", "0", "1")
    _odaf(2, *train, "--steps", "120", "--workers", "1", "--out", tmp_path / "whole")  # each seed on both cores
    _odaf(1, *train, "--steps", "120", "--workers", "1", "--cores", "1", "--out", tmp_path / "one")
    assert _state(tmp_path / "one", 120) != _state(tmp_path / "whole", 120)  # else this test shows nothing
    _odaf(2, *train, "--steps", "60", "--workers", "1", "--out", tmp_path / "cut")
    _odaf(1, "resume", tmp_path / "cut", "--steps", "90", "--workers", "2")  # two threads each on a single core
    _odaf(2, "resume", tmp_path / "cut", "--steps", "120")
    for seed in (0, 1):
        assert _state(tmp_path / "cut", 120, seed) == _state(tmp_path / "whole", 120, seed)


def test_cores_are_counted_as_xla_counts_them(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NPROC", "7")
    assert usable_cores() == 7
    monkeypatch.setenv("NPROC", "")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2}, raising=False)
    assert usable_cores() == 3
