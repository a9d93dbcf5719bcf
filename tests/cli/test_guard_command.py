"""`odaf guard` from the command line."""

import json
from pathlib import Path

import numpy as np
import pytest

from golden.runs import untrained_run
from golden.tiny import linear_dataset
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main
from odaf.deployment import GuardedPolicy


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("guard")
    log = linear_dataset(episodes=10, length=8, seed=0)
    log.save(folder / "log.h5")
    linear_dataset(episodes=19, length=8, seed=1).save(folder / "holdout.h5")
    return untrained_run(folder / "run", BehaviourCloning(hidden_sizes=(4,)), log, seeds=(0,), data=folder / "log.h5")


def words(run: Path, *more: str) -> list[str]:
    small = ["--false-alarms", "0.05", "--steps", "1", "--references", "10"]
    return ["guard", str(run), "--data", str(run.parent / "holdout.h5"), *small, *more]


def test_a_guard_is_made_written_and_asked(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out, record = tmp_path / "guard.safetensors", tmp_path / "guard.json"
    for _ in range(2):  # its own earlier files are written over
        assert main(words(run, "--reaction", "hold", "--out", str(out), "--json", str(record), "--why", "7")) == 0
    printed = capsys.readouterr().out
    assert "in at most 5.00% of episodes like the 19 set aside (recordings, 8 steps at the median)" in printed
    assert "the last action is held" in printed and "Critics: 4 fitted to the log" in printed
    assert f"wrote {out}; for C, ONNX or NumPy: odaf export {out} --out artefact" in printed
    assert "nearest logged rows" in printed and "rest of episode" in printed
    found = json.loads(record.read_text())
    assert found["calibration"]["episodes"] == 19 and set(found["levels"]) == {
        "range", "distance", "disagreement", "surprise",
    }  # fmt: skip
    guarded = GuardedPolicy.load(out)
    assert guarded.reaction == "hold"
    assert np.isfinite(guarded.act(guarded.begin(), np.zeros(3, np.float32))[0]).all()


def test_mistakes_are_explained(run: Path, capsys: pytest.CaptureFixture[str]):
    for more, said in (
        (["--false-alarms", "0.01"], "false_alarms=0.01 needs 99 episodes set aside, and there are 19"),
        (["--log", str(run.parent / "holdout.h5")], "was begun with data of fingerprint"),
        (["--out", str(run.parent / "log.h5")], "is there, and is not a guarded policy"),
        (["--why", "900"], "there is no row 900"),
        (["--why", "height=3"], "is neither a row nor a column"),
        (["--why", "observation_0=3"], "observation_1, observation_2 is missing"),
    ):
        assert main(words(run, *more)) == 2
        assert said.replace("false_alarms=", "--false-alarms ") in capsys.readouterr().err
