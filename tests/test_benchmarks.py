"""The timed scripts still run: tiny sizes, figures not looked at."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = {"load_dataset": ["--rows", "3000"], "import_table": ["--rows", "3000"]}


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_runs_and_writes_its_figures(name, tmp_path):
    out = tmp_path / "figures.json"
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *SCRIPTS[name], "--json", str(out)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "machine" in json.loads(out.read_text())
