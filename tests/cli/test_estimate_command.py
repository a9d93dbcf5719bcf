"""`odaf estimate` from the command line."""

import json
from pathlib import Path

import pytest

from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("estimate")
    log = dataset_of(3, 2, {"id": "Hopper-v4"})
    log.save(folder / "log.h5")
    return untrained_run(folder / "run", BehaviourCloning(hidden_sizes=(4,)), log, data=folder / "log.h5")


def test_the_table_is_printed_and_every_number_written(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "estimate.json"
    words = ["estimate", str(run), "--data", str(run.parent / "log.h5"), "--steps", "2", "--members", "2"]
    for _ in range(2):  # its own earlier file is written over
        assert main([*words, "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "behaviour" in printed and "the policy learned from this very log" in printed
    assert "wis: DeterministicActor: is deterministic" in printed and "--method fqe" in printed
    record = json.loads(out.read_text())
    assert [each["method"] for each in record["estimates"]] == ["fqe", "shrunk", "model", "blend", "wis", "pdis", "dr"]
    assert record["behaviour"]["low"] <= record["behaviour"]["value"] <= record["behaviour"]["high"]


def test_mistakes_are_explained(run: Path, capsys: pytest.CaptureFixture[str]):
    words = ["estimate", str(run), "--data", str(run.parent / "log.h5")]
    for more, said in (
        (["--method", "wis"], "DeterministicActor: is deterministic"),
        (["--discount", "2"], "must lie above 0"),
        (["--json", str(run.parent / "log.h5")], "is what the command reads"),
    ):
        assert main([*words, *more]) == 2
        assert said in capsys.readouterr().err
