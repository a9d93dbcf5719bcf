"""`odaf export` from the command line."""

import json
from pathlib import Path

import pytest

from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    log = dataset_of(3, 2, {"id": "Hopper-v4"})
    return untrained_run(folder / "run", BehaviourCloning(hidden_sizes=(4,)), log)


def test_the_artefact_is_written_and_replaced_by_force_alone(run: Path, tmp_path: Path, capsys):
    out = tmp_path / "new" / "artefact"
    words = ["export", str(run), "--out", str(out), "--forms", "numpy", "onnx"]
    limits = ["--max-change", "action_0=0.5", "--max-change", "action_1=0.25"]
    assert main([*words, *limits]) == 2 and "make it first" in capsys.readouterr().err
    out.parent.mkdir()
    assert main([*words, *limits]) == 0
    printed = capsys.readouterr().out
    assert "policy.safetensors" in printed and "policy.onnx: 320 actions, at most" in printed
    contract = json.loads((out / "contract.json").read_text())
    assert [entry["max_change"] for entry in contract["action"]] == [0.5, 0.25]
    assert main(words) == 2 and "exists already; name a new folder, or give --force" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert json.loads((out / "contract.json").read_text())["action"][0]["max_change"] is None


def test_mistakes_are_explained(run: Path, tmp_path: Path, capsys):
    (tmp_path / "other").mkdir()
    for more, said in (
        (["--max-change", "valve=1"], "max_change: 'valve' is no action; there are action_0, action_1"),
        (["--max-change", "action_0=wide"], "write NAME=VALUE"),
        (["--max-change", "0.5"], "write NAME=VALUE"),
        (["--step", "7"], "no checkpoint of step 7"),
        (["--out", str(tmp_path / "other"), "--force"], "is not an artefact of `odaf export`"),
    ):
        assert main(["export", str(run), "--out", str(tmp_path / "out"), "--forms", "numpy", *more]) == 2
        assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other"]
