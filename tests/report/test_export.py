"""The table of a report as data: what stands in it, and that LaTeX reads it."""

import csv
import json
import re

import numpy as np
import pytest
from scipy import stats

from golden.runs import scored_run
from odaf import report
from odaf.errors import ConfigError
from odaf.report import export, extras
from odaf.report.records import LOCAL

FIRST = {0: [1000.0, 1200.0], 3: [1500.0, None]}  # means 1100 and 1500
GENERATED = {"summary": {"mean_return": 900.0, "best_return": 1300.0, "provenance": {"generator": "ours"}}}


@pytest.fixture
def runs(tmp_path):
    return [
        scored_run(tmp_path / "a", FIRST, "odaf", num_critics=4, data=GENERATED),
        scored_run(tmp_path / "b", {1: [-20.5]}, "odaf", num_critics=10, data={"environment": None}),
    ]


def normalised(value):
    return 100 * (value + 20.272305) / (3234.3 + 20.272305)  # Hopper's constants, from the public benchmark


def test_csv_holds_a_row_a_run_with_every_number(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)  # needs no drawing library
    out = report.build(runs, tmp_path / "new" / "table.csv", format="csv")
    with out.open(newline="") as file:
        first, second = csv.DictReader(file)
    low, high = stats.t.interval(0.95, 1, 1300.0, stats.sem([1100.0, 1500.0]))
    numbers = {name: float(first[name]) for name in ("mean", "low", "high", "normalised_mean", "normalised_low")}
    expected = {"mean": 1300.0, "low": low, "high": high, "normalised_mean": normalised(1300.0)}
    assert numbers == pytest.approx(expected | {"normalised_low": normalised(low)})
    words = {
        name: first[name] for name in ("name", "preset", "data", "origin", "environment", "fingerprint", "version")
    }
    assert words == {
        "name": "odaf, num_critics 4",
        "preset": "odaf",
        "data": "log.h5",
        "origin": LOCAL,
        "environment": "Hopper-v5",
        "fingerprint": "ab12" * 16,
        "version": "0.2.0",
    }
    counts = {
        name: first[name] for name in ("updates", "seeds", "episodes", "seconds", "updates_per_second", "success")
    }
    assert list(counts.values()) == ["100", "2", "4", "2.0", "50.0", ""]
    assert [second[name] for name in ("mean", "low", "origin", "environment", "normalised_mean")] == [
        "-20.5",
        *4 * [""],
    ]
    assert tuple(first) == export.FIELDS


def test_json_holds_every_seed_and_every_sound_episode(runs, tmp_path):
    content = json.loads(report.build(runs, tmp_path / "t.json", format="json", names=["x", "y"]).read_text())
    first, second = content["runs"]
    assert (first["name"], second["name"], second["low"]) == ("x", "y", None)
    assert first["by_seed"] == [
        {"seed": 0, "updates": 100, "mean": 1100.0, "episodes": 2, "returns": [1000.0, 1200.0]},
        {"seed": 3, "updates": 100, "mean": 1500.0, "episodes": 2, "returns": [1500.0]},
    ]
    assert "Student's t 95 % interval over seeds" in content["statistic"]


def test_latex_table_has_one_column_for_each_cell_and_says_what_its_numbers_are(runs, tmp_path):
    text = report.build(runs, tmp_path / "t.tex", format="latex", title="50 % of {Hopper}").read_text()
    low, high = stats.t.interval(0.95, 1, 1300.0, stats.sem([1100.0, 1500.0]))
    rows = [line.strip().removesuffix(r" \\").split(" & ") for line in text.splitlines() if line.endswith(r" \\")]
    assert rows == [
        ["Method", "Mean return", r"95\,\% interval", "Normalised score", "Seeds"],
        [r"odaf, num\_critics 4", "$1300.0$", f"${low:.1f}$ to ${high:.1f}$", f"${normalised(1300):.1f}$", "2"],
        [r"odaf, num\_critics 10", "$-20.5$", r"$\pm\,0.0$", "", "1"],
    ]
    assert r"\begin{tabular}{lrrrr}" in text
    caption = re.search(r"\\caption\{(.*)\}\n", text)
    assert caption is not None
    for words in (
        r"50 \% of \{Hopper\}. Mean return at the last checkpoint over 1 to 2 seeds",
        "Student's t over the seeds' means",
        r"$\pm$ is the standard deviation over the episodes of one seed",
        "1 to 4 episodes a run; normalised scores in Hopper-v5",
        r"locally generated data: odaf, num\_critics 4.",
    ):
        assert words in caption[1]
    body = text.split("\n", 1)[1]
    opened = re.findall(r"\\(begin|end)\{(\w+)\}", body)
    assert opened == [("begin", "table"), ("begin", "tabular"), ("end", "tabular"), ("end", "table")]
    bare = re.sub(r"\\[{}%&$#_]", "", body)
    assert bare.count("{") == bare.count("}") and bare.count("$") % 2 == 0 and not re.search("[%#_~^<>]", bare)


def test_no_letter_of_a_name_is_a_command(tmp_path):
    every = '\\ & % $ # _ { } ~ ^ < > | " …'
    assert export.escaped(every) == (
        r"\textbackslash{} \& \% \$ \# \_ \{ \} \textasciitilde{} \textasciicircum{} \textless{} \textgreater{} "
        r"\textbar{} '' \ldots{}"
    )
    run = scored_run(tmp_path / "a", {0: [1.0], 1: [np.pi]}, every)
    text = report.build([run], tmp_path / "t.tex", format="latex").read_text()
    (row,) = [line for line in text.splitlines() if line.endswith(r" \\") and "textbackslash" in line]
    assert len(re.findall(r"(?<!\\)&", row)) == 3  # name, mean, interval, score: nothing of the name parts a column


def test_a_table_that_cannot_be_made_leaves_an_earlier_one(runs, tmp_path):
    out = tmp_path / "t.csv"
    out.write_text("earlier")
    with pytest.raises(ConfigError, match="does not exist"):
        report.build([tmp_path / "none"], out, format="csv")
    with pytest.raises(ConfigError, match="is a folder; name the file to write"):
        report.build(runs, tmp_path, format="csv")
    assert out.read_text() == "earlier" and list(tmp_path.glob(".writing*")) == []
