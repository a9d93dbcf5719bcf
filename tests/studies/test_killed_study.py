"""A study whose process is killed at ten random moments ends with the records of one that nobody touched."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import odaf

SEED = 0


def test_a_study_killed_at_ten_random_moments_ends_with_the_same_records(tmp_path: Path) -> None:
    script, tests = Path(__file__).with_name("killed.py"), Path(__file__).parents[1]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(Path(odaf.__file__).parents[1]), str(tests)]),
        "NPROC": "1",
        # Each process that is begun compiles the same few programs.
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    process = subprocess.run(
        [sys.executable, str(script), str(tmp_path), str(SEED)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    said = f"seed {SEED}: {process.stdout}\n{process.stderr}"
    assert process.returncode == 0, said
    found = json.loads(process.stdout)
    assert found["unbroken"] == 0 and found["end"] == 0, said
    assert found["statuses"] == [-signal.SIGKILL] * 10, said
    unbroken, killed = (records(tmp_path / name / "ledger") for name in ("unbroken", "killed"))
    assert len(unbroken) == 5 and killed == unbroken, said
    # The longer of the trainings goes on from the shorter in both; the others went on from checkpoints.
    assert (times_resumed(tmp_path / "unbroken"), times_resumed(tmp_path / "killed") >= 4) == (1, True), said


def times_resumed(place: Path) -> int:
    """How often a process went on with a training that was not at its end."""
    processes = (place / "work").glob("*/environment.json")
    return sum(len(json.loads(process.read_text(encoding="utf-8"))["resumed"]) for process in processes)


def records(ledger: Path) -> dict[str, Any]:
    """The files of a ledger without what a clock measured."""
    contents = {path.name: path.read_text(encoding="utf-8") for path in ledger.iterdir() if path.name[0] != "."}
    return {name: untimed(json.loads(text)) if ".json" in name else text for name, text in contents.items()}


def untimed(value: Any) -> Any:
    """The same without the fields that a clock decides."""
    if isinstance(value, dict):
        return {name: untimed(held) for name, held in value.items() if name not in ("seconds", "updates_per_second")}
    return [untimed(held) for held in value] if isinstance(value, list) else value
