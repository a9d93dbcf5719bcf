"""`odaf assess` from the command line."""

import json
from pathlib import Path

import pytest

from golden.runs import untrained_run
from golden.tiny import linear_dataset
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main


def test_a_run_is_assessed_written_down_and_laid_beside_what_happened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    log = linear_dataset(episodes=10, length=8, seed=0)
    log.save(tmp_path / "log.h5")
    aside = linear_dataset(episodes=19, length=8, seed=1)
    aside.save(tmp_path / "holdout.h5")
    run = untrained_run(
        tmp_path / "run", BehaviourCloning(hidden_sizes=(4,)), log, seeds=(0,), data=tmp_path / "log.h5"
    )
    page, record = tmp_path / "assess.html", tmp_path / "assess.json"
    name = aside.observation_names[0]
    words = ["assess", str(run), "--data", str(tmp_path / "holdout.h5"), "--steps", "2", "--members", "2"]
    words += ["--out", str(page), "--json", str(record)]
    assert main([*words, "--keep", f"{name} < 1", "--keep", f"{name} > -9", "--after", str(tmp_path / "log.h5")]) == 0
    printed = capsys.readouterr().out
    assert "0 of 19 logged episodes broke it, 0.0% (0.0% to 17.6%); the policy: cannot" in printed
    assert "cannot be told, no logged episode broke it" in printed
    assert "10 episodes of the new log" in printed and f"wrote {page}" in printed
    found = json.loads(record.read_text())
    assert found["verdict"] in ("better", "worse", "not decided", "refused") and len(found["keep"]) == 2
    assert found["after"]["episodes"] == 10 and "Promised, and happened" in page.read_text()
    assert main([*words, "--keep", f"{name} <"]) == 2
    assert f"expression '{name} <'" in capsys.readouterr().err
