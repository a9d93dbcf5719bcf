"""A log larger than the memory a process may have is checked all the same, with the same findings."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from odaf.data import fingerprint, storage
from odaf.data.checks import check_file

ROWS, WIDTH = 700_000, 48
LIMIT = 208 * 2**20
"""Bytes of data the process may have beside read-only maps of files: libraries take half of it, the log has more.
(OpenBLAS alone takes 32 MB when it first multiplies matrices.)"""

CHILD = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_DATA, ({limit}, {limit}))
from odaf.data.checks import check_file
print(json.dumps(check_file(sys.argv[1]).to_dict()))
"""
HOLD = """
import resource, sys
resource.setrlimit(resource.RLIMIT_DATA, ({limit}, {limit}))
import h5py
with h5py.File(sys.argv[1]) as file:
    columns = [file[name][()] for name in ("observations", "next_observations")]
"""


def run(code: str, path: Path) -> subprocess.CompletedProcess[str]:
    environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1", "PATH": ""}
    return subprocess.run(
        [sys.executable, "-c", code.format(limit=LIMIT), str(path)], capture_output=True, text=True, env=environment
    )


def write(path: Path, own: bool) -> None:
    """Written piece by piece: a walk with two values missing and a jump inside an episode."""
    rng = np.random.default_rng(0)
    terminated, truncated = ("terminated", "truncated") if own else ("terminals", "timeouts")
    walk = np.cumsum(rng.normal(size=(100_001, WIDTH)), axis=0).astype(np.float32)
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        for name, width in (("observations", WIDTH), ("next_observations", WIDTH), ("actions", 4)):
            file.create_dataset(name, (ROWS, width), "<f4")
        for first in range(0, ROWS, 100_000):
            rows = slice(first, first + 100_000)
            walk += 1.0
            if first == 300_000:
                walk[70_500:] += 1_000
            file["observations"][rows] = walk[:-1]  # type: ignore[index]
            file["next_observations"][rows] = walk[1:]  # type: ignore[index]
            file["actions"][rows] = rng.uniform(-1, 1, (100_000, 4))  # type: ignore[index]
        rewards = rng.normal(size=ROWS).astype(np.float32)
        rewards[[12, 400_000]] = np.nan
        file["rewards"] = rewards
        file[terminated] = np.zeros(ROWS, bool)
        file[truncated] = np.arange(ROWS) % 1_000 == 999
        if own:
            file["episode_starts"] = np.arange(0, ROWS, 1_000)
            file["action_low"], file["action_high"] = np.full(4, -1, np.float32), np.full(4, 1, np.float32)
            texts = {"observation_names": [f"x{index}" for index in range(WIDTH)], "action_names": list("abcd")}
            texts |= {"observation_units": [""] * WIDTH, "action_units": [""] * 4}
            file["metadata"] = json.dumps({**texts, "provenance": {}})
            file.attrs["format"], file.attrs["version"] = storage.FORMAT, 1
            arrays = {name: file[name][()] for name in file if name != "metadata"}  # type: ignore[index]
            file.attrs["sha256"] = fingerprint.checksum(arrays, file["metadata"][()].decode())  # type: ignore[index]


@pytest.mark.parametrize(
    "own", [pytest.param(True, id="our own layout"), pytest.param(False, id="D4RL layout", marks=pytest.mark.slow)]
)
def test_a_file_larger_than_memory(own: bool, tmp_path: Path):
    path = tmp_path / "long.hdf5"
    write(path, own)
    assert path.stat().st_size > 1.25 * LIMIT
    done = run(CHILD, path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found == check_file(path).to_dict()
    by_check = {finding["check"]: finding for finding in found["findings"]}
    assert by_check["not-finite"]["rows"] == [12, 400_000]
    # the step that is added once stays in the walk, which every later piece follows again
    assert by_check["jump"]["rows"] == [370_500, 470_500, 570_500, 670_500]
    held = run(HOLD, path)
    assert held.returncode != 0, "the limit does not bind: the log fits into memory after all"
