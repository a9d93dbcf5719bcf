"""Import, check, convert, mix, split and plot from the command line."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from odaf.cli import main
from odaf.data import Dataset

TABLE = [
    "--observations",
    "level",
    "flow",
    "--actions",
    "valve",
    "--reward",
    "profit",
    "--episode",
    "batch",
    "--terminated",
    "tripped",
]


def write_table(path: Path, **spoiled) -> Path:
    """A log of thirty batches of a hundred rows as a plant would export it; every second batch trips."""
    rng = np.random.default_rng(0)
    rows = 3_000
    columns = {
        "level": rng.normal(size=rows).cumsum() / 50,
        "flow": rng.normal(size=rows),
        "valve": rng.uniform(1, 99, rows),
        "profit": rng.normal(size=rows),
        "batch": np.repeat(np.arange(30), 100),
        "tripped": (np.arange(rows) % 200 == 199).astype(int),
        **spoiled,
    }
    if "valve" not in spoiled and "flow" not in spoiled:
        columns["flow"][1:] += (columns["valve"][:-1] - 50) / 30  # a row later, the valve shows
    lines = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def valve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plant")
    out = folder / "valve.h5"
    words = ["data", "import", str(write_table(folder / "log.csv")), "--out", str(out), *TABLE]
    assert main([*words, "--action-bounds", "0", "100", "--units", "level=m", "valve=%"]) == 0
    return out


def test_import_keeps_names_units_bounds_and_the_report(valve: Path):
    dataset = Dataset.load(valve)
    assert (dataset.observation_names, dataset.action_names) == (("level", "flow"), ("valve",))
    assert (dataset.observation_units, dataset.action_units) == (("m", ""), ("%",))
    assert (dataset.action_low.tolist(), dataset.action_high.tolist()) == ([0.0], [100.0])
    assert (len(dataset), dataset.num_episodes) == (2_985, 30)
    validation = dataset.provenance["validation"]
    assert validation["verdict"].startswith("usable")
    assert [finding["check"] for finding in validation["findings"]] == ["no-successor", "unfinished-episode"]
    assert re.fullmatch(r"[0-9a-f]{64}", dataset.provenance["file_sha256"])


def test_info_shows_what_the_import_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    table = write_table(tmp_path / "log.csv", valve=np.arange(3_000) % 4, profit=np.full(3_000, 2.5))
    words = ["data", "import", str(table), "--out", str(tmp_path / "valve.h5"), *TABLE]
    assert main([*words, "--accept", "actions-discrete"]) == 0
    capsys.readouterr()
    assert main(["data", "info", str(tmp_path / "valve.h5")]) == 0
    changed, _, report = capsys.readouterr().out.partition("what the checks found before the import")
    assert "dropped-without-successor (15): " in changed
    assert "the first of them 101, 301" in changed  # the headings are row 1
    assert "log.csv · csv" in report
    assert re.search(r"error +actions-discrete", report)
    assert re.search(r"warning +reward-constant +rewards +3,000 +every reward is 2.5", report)
    assert report.endswith("errors accepted: actions-discrete\n")


def test_info_shows_no_report_where_there_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    Dataset.from_arrays(np.zeros((4, 1)), np.zeros((4, 1)), np.zeros(4), episode=[0] * 4, action_bounds=(-1, 1)).save(
        tmp_path / "log.h5"
    )
    assert main(["data", "info", str(tmp_path / "log.h5")]) == 0
    assert "what the checks found" not in capsys.readouterr().out


def test_a_log_with_errors_is_not_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    table = write_table(tmp_path / "log.csv", valve=np.arange(3_000) % 4)
    words = ["data", "import", str(table), "--out", str(tmp_path / "valve.h5"), *TABLE]
    assert main(words) == 2
    err = capsys.readouterr().err
    assert "whole numbers 0 to 3" in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "valve.h5").exists()
    assert main([*words, "--accept", "actions-discrete"]) == 0


def test_check_exits_with_what_it_found(valve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "check", str(valve), "--strict"]) == 0
    table = write_table(tmp_path / "log.csv", profit=np.zeros(3_000, int))
    words = ["data", "check", str(table), *TABLE, "--action-bounds", "0", "100"]
    capsys.readouterr()
    assert main(words) == 0
    assert "reward-constant" in capsys.readouterr().out
    assert main([*words, "--strict"]) == 1
    assert main([*words[:-1], "50"]) == 2


def test_check_numbers_rows_as_the_spreadsheet_does_and_writes_json(tmp_path: Path):
    valve = np.linspace(1, 99, 3_000)
    valve[7] = 120.0
    table = write_table(tmp_path / "log.csv", valve=valve)
    report = tmp_path / "report.json"
    words = ["data", "check", str(table), *TABLE, "--action-bounds", "0", "100", "--json", str(report)]
    assert main(words) == 2
    content = json.loads(report.read_text(encoding="utf-8"))
    assert content["usable"] is False
    (finding,) = (finding for finding in content["findings"] if finding["severity"] == "error")
    assert (finding["check"], finding["rows"]) == ("actions-outside-bounds", [9])  # the headings are row 1


def test_check_of_a_file_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "log.h5").write_bytes(b"nothing that anyone would call data")
    assert main(["data", "check", str(tmp_path / "log.h5")]) == 2
    assert "unreadable" in capsys.readouterr().out
    assert main(["data", "check", str(tmp_path / "none.h5")]) == 2
    assert "there is no such file" in capsys.readouterr().err


def test_check_against_an_environment(valve: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("gymnasium")
    assert main(["data", "check", str(valve), "--env", "Pendulum-v1"]) == 2
    assert "needs 3" in capsys.readouterr().out


@pytest.mark.parametrize("layout", ["d4rl", "minari"])
def test_convert_and_back(layout: str, valve: Path, tmp_path: Path):
    assert main(["data", "convert", str(valve), "--to", layout, "--out", str(tmp_path / "other")]) == 0
    options: dict[str, Any] = {"action_bounds": (0.0, 100.0)} if layout == "d4rl" else {}
    read, original = Dataset.load(tmp_path / "other", **options), Dataset.load(valve)
    np.testing.assert_array_equal(read.observations, original.observations)
    np.testing.assert_array_equal(read.truncated, original.truncated)
    np.testing.assert_array_equal(read.episode_starts, original.episode_starts)


def test_split_then_mix(valve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    train, holdout, mixed = (str(tmp_path / name) for name in ("train.h5", "holdout.h5", "mixed.h5"))
    assert main(["data", "split", str(valve), "--train", train, "--holdout", holdout, "--share", "0.5"]) == 0
    assert (Dataset.load(train).num_episodes, Dataset.load(holdout).num_episodes) == (15, 15)
    words = ["data", "mix", train, holdout, "--ratio", "0.9", "--transitions", "1000", "--out", mixed]
    assert main(words) == 0
    assert f"100 rows of {train}, 900 of {holdout}" in capsys.readouterr().out
    np.testing.assert_array_equal(Dataset.load(mixed).rewards[100:], Dataset.load(holdout).rewards[:900])


def test_mix_per_batch(valve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    mixed = str(tmp_path / "mixed.h5")
    words = ["data", "mix", str(valve), str(valve), "--ratio", "0.9", "--per-batch", "--out", mixed]
    assert main([*words, "--transitions", "9"]) == 2
    assert "--transitions: --per-batch keeps all rows" in capsys.readouterr().err
    assert main(words) == 0
    assert "training draws a share of 0.9 of each batch from" in capsys.readouterr().out
    read = Dataset.load(mixed)
    assert read.mixture is not None
    assert (len(read), read.mixture.border, read.mixture.ratio) == (5_970, 2_985, 0.9)
    assert main(["data", "info", mixed]) == 0
    assert "per batch: each row comes from the 2,985 rows of the first part, or with probability 0.9 from" in (
        capsys.readouterr().out
    )
    assert main(["data", "convert", mixed, "--to", "d4rl", "--out", str(tmp_path / "other")]) == 2
    assert "which D4RL's layout cannot say" in capsys.readouterr().err
    assert main(["data", "mix", str(valve), str(valve), "--ratio", "0.9", "--out", mixed]) == 0
    assert main(["data", "info", mixed]) == 0
    assert "static, ratio 0.9: 298 rows of the expert data and 2,686 rows of the other data" in capsys.readouterr().out


def test_long_work_shows_a_bar_on_a_terminal(
    valve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    one, two = str(tmp_path / "one.h5"), str(tmp_path / "two.h5")
    commands = (
        (["data", "split", str(valve), "--train", one, "--holdout", two], [valve, one, two]),
        (["data", "mix", one, two, "--ratio", "0.5", "--out", str(tmp_path / "mixed.h5")], [one, two, "mixed.h5"]),
        (["data", "convert", one, "--to", "minari", "--out", str(tmp_path / "minari")], [one, "minari"]),
    )
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "400")
    for words, files in commands:
        assert main(words) == 0
        assert capsys.readouterr().err == "", "a bar that is not on a terminal"
        if words[1] == "convert":
            shutil.rmtree(tmp_path / "minari")
        with monkeypatch.context() as terminal:
            terminal.setattr("sys.stderr.isatty", lambda: True)
            assert main(words) == 0
        err = capsys.readouterr().err
        assert all(str(file) in err for file in files)
        assert "100%" in err


def test_plot_is_one_page_that_stands_alone(valve: Path, tmp_path: Path):
    assert main(["data", "plot", str(valve), "--out", str(tmp_path / "valve.html"), "--title", "<Valve>"]) == 0
    page = (tmp_path / "valve.html").read_text(encoding="utf-8")
    assert not re.findall(r"https?:|//[a-z]|<script|<img|<link", page), "something from outside"
    assert page.count("<svg") == 4  # returns, lengths, coverage, one action
    assert "&lt;Valve&gt;" in page
    explained = [int(share) for share in re.findall(r"component, (\d+)% of the variance", page)]
    assert len(explained) == 2
    assert 98 <= sum(explained) <= 102  # two columns: the two axes hold everything
