"""`odaf report` from the command line: its formats, and the names of the files they go into."""

from pathlib import Path

import pytest

from golden.runs import scored_run
from odaf.cli import main


@pytest.fixture
def run(tmp_path: Path) -> str:
    return str(scored_run(tmp_path / "run", {0: [10.0, 14.0], 1: [12.0, 20.0]}))


@pytest.mark.parametrize(("layout", "ending"), [("csv", "csv"), ("json", "json"), ("latex", "tex"), ("html", "html")])
def test_each_format_is_written_and_written_over_and_nothing_else_is(run, layout, ending, tmp_path, capsys):
    out, foreign = tmp_path / f"table.{ending}", tmp_path / f"foreign.{ending}"
    foreign.write_text("mine")
    for _ in range(2):
        assert main(["report", run, "--format", layout, "--out", str(out), "--names", "a run"]) == 0
        assert f"wrote {out}" in capsys.readouterr().out
    assert "a run" in out.read_text()
    assert main(["report", run, "--format", layout, "--out", str(foreign)]) == 2
    assert "is there, and is not" in capsys.readouterr().err and foreign.read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "t.csv"], "ends in .html; name it t.html, or give --format csv"),
        (["--out", "t", "--format", "latex"], "ends in .tex; name it t.tex\n"),
        (["--out", "t.html", "--format", "json"], "name it t.json, or give --format html"),
        (["--out", "t.csv", "--format", "csv", "--title", "x"], "--title: has no place in --format csv"),
        (["--out", "t.csv", "--format", "csv", "--names", "a", "b"], "2 names for 1 runs"),
    ],
)
def test_names_and_options_that_do_not_fit_the_format_are_explained(run, words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report", run, *words]) == 2
    assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]
