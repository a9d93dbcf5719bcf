"""`odaf compare` from the command line: what is printed, what is written, and what a mistake leads to."""

import json
from pathlib import Path

import pytest

from golden.runs import scored_run
from odaf.cli import main


@pytest.fixture
def runs(tmp_path: Path) -> list[str]:
    seeds = {0: [10.0, 14.0], 1: [12.0, 20.0]}
    return [str(scored_run(tmp_path / name, seeds, num_critics=size)) for name, size in (("a", 4), ("b", 10))]


def test_compare_prints_the_table_and_writes_the_numbers(runs, tmp_path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "comparison.json"
    for _ in range(2):  # its own earlier file is written over
        assert main(["compare", *runs, "--json", str(out)]) == 0
    assert "odaf, num_critics 4 against odaf, num_critics 10" in capsys.readouterr().out
    assert json.loads(out.read_text())["pairs"][0]["difference"]["mean"] == 0.0
    assert main(["compare", runs[0], "--against", runs[1], "--names", "small", "large"]) == 0
    assert "small against large" in capsys.readouterr().out


def test_mistakes_are_explained(runs, tmp_path, capsys: pytest.CaptureFixture[str]):
    foreign = tmp_path / "foreign.json"
    foreign.write_text("{}")
    for words, said in (
        ([], "name at least one run directory"),
        ([*runs, "--names", "one"], "give --names one for each run"),
        ([*runs, "--json", str(foreign)], "is there, and is not a comparison of `odaf compare`"),
        ([*runs, "--json", runs[0]], "is a folder; name a file in it"),
    ):
        assert main(["compare", *words]) == 2
        assert said in capsys.readouterr().err
    assert foreign.read_text() == "{}"
