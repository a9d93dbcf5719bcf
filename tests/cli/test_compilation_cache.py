"""Compiled programs that one `odaf train` leaves are found by the next, and give the same bits."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf.cli import compilation_cache

# Runs one command and prints how many programs came out of the cache.
COUNTED = """
import json, sys
import jax
from odaf.cli import main

hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(1) if name.endswith("/cache_hits") else None)
code = main(sys.argv[1:])
print(json.dumps({"code": code, "hits": len(hits)}))
"""


def _train(data: Path, out: Path, *more: str, **variables: str) -> dict:
    source = Path(odaf.__file__).parents[1]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--hidden-sizes", "8"]
    words += ["--batch-size", "8", "--steps", "4", "--evaluate-every", "0", "--quiet", *more]
    process = subprocess.run(
        [sys.executable, "-c", COUNTED, *words],
        env={**environment, "PYTHONPATH": str(source), **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    found = json.loads(process.stdout.splitlines()[-1])
    assert found["code"] == 0, process.stderr
    return {**found, "errors": process.stderr}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("data") / "log.h5"
    rows = {"observations": rng.normal(size=(40, 3)), "actions": rng.uniform(-1, 1, (40, 2)), "rewards": np.zeros(40)}
    odaf.Dataset.from_arrays(
        **rows, next_observations=rng.normal(size=(40, 3)), truncated=np.arange(40) % 10 == 9, action_bounds=(-1.0, 1.0)
    ).save(path)
    return path


def _programs(folder: Path) -> set[str]:
    return {file.name for file in folder.rglob("*-cache")}


def test_second_process_finds_the_programs_of_the_first(data: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    first = _train(data, tmp_path / "first", ODAF_CACHE_DIR=str(cache))
    kept = _programs(cache / "compiled")
    assert kept
    second = _train(data, tmp_path / "second", ODAF_CACHE_DIR=str(cache))
    assert _programs(cache / "compiled") == kept
    # a program that one process compiles twice is found by the process itself
    assert second["hits"] >= len(kept) + first["hits"]
    states = [(tmp_path / name).glob("seed-0/checkpoints/*/state.eqx") for name in ("first", "second")]
    ours, theirs = ([file.read_bytes() for file in sorted(found)] for found in states)
    assert ours == theirs and len(ours) == 2

    # Without the cache nothing is read or written, even where JAX's own variable names a folder.
    other = tmp_path / "other"
    settings = {"JAX_COMPILATION_CACHE_DIR": str(other), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    unused = _train(data, tmp_path / "third", "--no-compilation-cache", **settings)
    assert unused["hits"] == 0 and not _programs(other)


def test_folder_that_cannot_be_made_costs_a_message_only(monkeypatch, tmp_path, capsys):
    import jax

    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ODAF_CACHE_DIR", str(tmp_path / "file"))
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        compilation_cache.use_compilation_cache()
        assert jax.config.values["jax_compilation_cache_dir"] is None
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert "ODAF_CACHE_DIR" in capsys.readouterr().err


def test_folder_that_is_set_already_stays(tmp_path, monkeypatch):
    import jax

    monkeypatch.setenv("ODAF_CACHE_DIR", str(tmp_path / "ours"))
    before = jax.config.values["jax_compilation_cache_dir"]
    assert before is not None  # the tests' own
    compilation_cache.use_compilation_cache()
    assert jax.config.values["jax_compilation_cache_dir"] == before and not (tmp_path / "ours").exists()


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="the rules of XDG")
def test_where_caches_lie(monkeypatch, tmp_path):
    monkeypatch.delenv("ODAF_CACHE_DIR", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert compilation_cache.cache_directory() == tmp_path / ".cache" / "odaf"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert compilation_cache.cache_directory() == tmp_path / ".cache" / "odaf"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert compilation_cache.cache_directory() == tmp_path / "caches" / "odaf"
    monkeypatch.setenv("ODAF_CACHE_DIR", "~/own")
    assert compilation_cache.cache_directory() == tmp_path / "own"
