"""Options that say how a table is to be read: what the reader gets of them, and what they do to a file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from odaf.cli import main
from odaf.cli.readers import ReaderOptions
from odaf.data import Dataset
from odaf.errors import ConfigError

ROLES = ["--observations", "Füllstand", "--actions", "valve", "--action-bounds", "0", "100"]
REWARD, EPISODE = ["--reward", "profit"], ["--episode", "batch"]
ODD = ["--encoding", "latin-1", "--skip-rows", "2", "--decimal-comma"]


def write_odd_table(path: Path, separator: str = ";", **cells: str) -> Path:
    """Two batches of ten rows as an older German program exports them; row n of the log is row 4 + n of the file.

    Args:
        path: where to write.
        separator: between cells.
        cells: other text for single cells, by column and row, such as level_3.
    """
    lines = ["Anlage Süd", "exported by hand", separator.join(["batch", "time", "Füllstand", "valve", "profit"])]
    for row in range(20):
        time = row % 10 + (row % 10 > 6)  # the step after the seventh row is twice as long
        given = [str(row // 10), str(time), f"{row},5", str(5 * row), f"-{row},25"]
        names = ("batch", "time", "level", "valve", "profit")
        lines.append(separator.join(cells.get(f"{name}_{row}", cell) for name, cell in zip(names, given, strict=True)))
    path.write_bytes("\r\n".join(lines).encode("latin-1"))
    return path


def imported(table: Path, *words: str) -> Dataset:
    out = table.with_suffix(".h5")
    assert main(["data", "import", str(table), "--out", str(out), "--accept", "too-few", *words]) == 0
    return Dataset.load(out)


def findings(dataset: Dataset) -> list[str]:
    return [finding["finding"] for finding in dataset.provenance["findings"]]


def test_a_table_with_lines_above_commas_in_numbers_and_old_letters(tmp_path: Path):
    dataset = imported(write_odd_table(tmp_path / "log.txt"), *ROLES, *REWARD, *EPISODE, *ODD)
    kept = np.delete(np.arange(20), [9, 19])  # nobody logged what followed the last rows
    np.testing.assert_array_equal(dataset.observations[:, 0], kept + 0.5)
    np.testing.assert_array_equal(dataset.rewards, -(kept + 0.25) * np.sign(kept + 1))
    assert dataset.observation_names == ("Füllstand",)
    assert dataset.provenance["encoding"] == "latin-1"


@pytest.mark.parametrize("left_out", ["--encoding", "--skip-rows", "--decimal-comma"])
def test_none_of_the_three_can_be_left_out(left_out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = list(ODD)
    place = words.index(left_out)
    del words[place : place + (1 if left_out == "--decimal-comma" else 2)]
    table = write_odd_table(tmp_path / "log.txt")
    words = ["data", "import", str(table), "--out", str(tmp_path / "log.h5"), *ROLES, *REWARD, *EPISODE, *words]
    assert main(words) == 2
    assert str(table) in capsys.readouterr().err


@pytest.mark.parametrize(("written", "given"), [("\t", "tab"), ("\t", "\\t"), (":", ":")])
def test_any_separator(written: str, given: str, tmp_path: Path):
    table = write_odd_table(tmp_path / "log.txt", separator=written)
    dataset = imported(table, *ROLES, *REWARD, *EPISODE, *ODD, "--separator", given)
    assert dataset.provenance["separator"] == written


def test_an_empty_cell_is_refused_or_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    table = write_odd_table(tmp_path / "log.txt", level_3="")
    words = [str(table), *ROLES, *REWARD, *EPISODE, *ODD]
    assert main(["data", "import", *words, "--out", str(tmp_path / "log.h5")]) == 2
    assert "column 'Füllstand' has no value (empty or NaN) in row 7;" in capsys.readouterr().err
    report = tmp_path / "report.json"
    assert main(["data", "check", *words, "--on-missing", "nan", "--json", str(report)]) == 2
    found = {finding["check"]: finding["rows"] for finding in json.loads(report.read_text("utf-8"))["findings"]}
    assert found["not-finite"] == [7]  # two lines, the headings, three rows before it


def test_the_usual_step_decides_what_is_a_gap(tmp_path: Path):
    table = write_odd_table(tmp_path / "log.txt")
    words = (*ROLES, *REWARD, *EPISODE, *ODD, "--time", "time")
    broken = imported(table, *words)
    assert (broken.num_episodes, "time-gaps" in findings(broken)) == (4, True)
    whole = imported(table, *words, "--time-step", "2")
    assert (whole.num_episodes, "time-gaps" in findings(whole)) == (2, False)


def test_a_table_without_rewards_and_without_episodes(tmp_path: Path):
    table = write_odd_table(tmp_path / "log.txt")
    dataset = imported(table, *ROLES, *ODD, "--constant-reward", "-0.5", "--single-episode")
    assert dataset.num_episodes == 1
    assert set(dataset.rewards.tolist()) == {-0.5}


@pytest.mark.parametrize(("words", "expected"), [(["--reward", "index"], range(8)), (["--constant-reward", "0"], [0])])
def test_the_reward_of_a_lerobot_folder(words: list[str], expected: Any, tmp_path: Path):
    """Eight frames without `next.reward`: another column of numbers is named, or cloning needs none."""
    frames = pl.DataFrame(
        {
            "observation.state": [[float(row)] for row in range(8)],
            "action": [[0.1 * row] for row in range(8)],
            "episode_index": [0, 0, 0, 0, 1, 1, 1, 1],
            "frame_index": [0, 1, 2, 3, 0, 1, 2, 3],
            "index": list(range(8)),
            "next.done": [row % 4 == 3 for row in range(8)],
        }
    )
    folder = tmp_path / "arm"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    frames.write_parquet(folder / "data" / "chunk-000" / "file-000.parquet")
    info = {"codebase_version": "v3.0", "fps": 10, "features": {}}
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    assert set(imported(folder, *words).rewards.tolist()) == set(expected)


def test_options_of_a_text_table_do_not_make_one_of_other_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pl.DataFrame({"a": [0.0], "b": [0.0], "c": [0.0]}).write_parquet(tmp_path / "log.parquet")
    words = ["--observations", "a", "--actions", "b", "--reward", "c", "--single-episode", "--skip-rows", "1"]
    assert main(["data", "check", str(tmp_path / "log.parquet"), *words]) == 2
    assert "apply to CSV files" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"action_bounds": (0.0, 1.0)}, {"action_bounds": (0.0, 1.0)}),
        (
            {"action_bounds": (0.0, 1.0, -1.0, 2.0), "actions": ("a", "b")},
            {"action_bounds": {"a": (0.0, 1.0), "b": (-1.0, 2.0)}, "actions": ("a", "b")},
        ),
        ({"action_bounds": (0.0, 1.0, -1.0, 2.0)}, {"action_bounds": ((0.0, -1.0), (1.0, 2.0))}),
        ({"units": ("headings",)}, {"units": "headings"}),
        ({"units": ("level=m", "valve=a=b")}, {"units": {"level": "m", "valve": "a=b"}}),
        ({"format": "csv"}, {}),
        ({"constant_reward": 0.0, "single_episode": True}, {"reward": 0.0, "episode": 0}),
        ({"decimal_comma": True, "skip_rows": 0}, {"decimal_comma": True, "skip_rows": 0}),
        ({"separator": "tab"}, {"separator": "\t"}),
    ],
)
def test_options_as_the_reader_takes_them(given: dict, expected: dict):
    assert ReaderOptions(**given).for_reader() == expected


@pytest.mark.parametrize(
    "given",
    [
        {"action_bounds": (1.0,)},
        {"action_bounds": (1.0, 2.0, 3.0)},
        {"action_bounds": (0.0, 1.0, 0.0, 1.0), "actions": ("a",)},
        {"units": ("level",)},
        {"reward": "profit", "constant_reward": 0.0},
        {"episode": "batch", "single_episode": True},
    ],
)
def test_options_that_make_no_sense(given: dict):
    with pytest.raises(ConfigError, match="--(action-bounds|units|reward|episode): "):
        ReaderOptions(**given).for_reader()


def test_accepting_what_cannot_be_held_is_refused_before_anything_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    table = tmp_path / "log.csv"
    table.write_text("no table at all")
    words = ["data", "import", str(table), "--out", str(tmp_path / "log.h5"), "--accept", "not-finite", *ROLES]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "not-finite: no data set can hold such rows" in said and "--on-missing break does so" in said


def test_a_log_as_historians_write_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Units under the headings, words for missing values, decimal commas; reward and error are computed."""
    lines = ["sep=;", "Schicht;Zeit;Füllstand;Sollwert;valve", "-;s;m;m;%"]
    for row in range(40):
        level = "Bad" if row == 7 else "No Data" if row == 25 else f"{row / 4:.2f}".replace(".", ",")
        lines.append(f"{row // 20},0;{row % 20 / 2:.1f}".replace(".", ",") + f";{level};3,5;{row % 11},5")
    (tmp_path / "log.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    roles = ["--observations", "Füllstand", "--observation", "Fehler = Füllstand - Sollwert", "--actions", "valve"]
    roles += ["--reward", "1 - abs(Füllstand - Sollwert)", "--episode", "Schicht", "--time", "Zeit", "--lags", "1"]
    dialect = ["--units-row", "--decimal-comma", "--missing-values", "Bad, no data"]
    words = ["data", "import", str(tmp_path / "log.csv"), "--out", str(tmp_path / "log.h5"), *roles, *dialect]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "column 'Füllstand' has no value (empty or NaN) in 2 of 40 rows, the first of them 11, 29" in said
    assert "--on-missing break" in said
    assert main([*words, "--on-missing", "break"]) == 0
    dataset = Dataset.load(tmp_path / "log.h5")
    names = ("Füllstand", "Fehler", "Füllstand_lag1", "Fehler_lag1", "valve_lag1")
    assert dataset.observation_names == names and dataset.observation_units == ("m", "", "m", "", "%")
    assert (
        dataset.num_episodes == 4 and len(dataset) == 40 - 2 - 2 * 4
    )  # the first row has no history, the last no successor
    np.testing.assert_allclose(dataset.rewards, 1.0 - np.abs(dataset.observations[:, 1]))
    np.testing.assert_array_equal(dataset.observations[1, [2, 4]], [0.25, 1.5])


def test_remedies_of_tables_can_be_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Each message names an option; with it, the next message is another one, until the log is read."""
    path = tmp_path / "log.csv"
    lines = ["e;x;a;r", "-;m;-;EUR", *(f"{i // 10};{'Bad' if i == 5 else f'{i},5'};{i % 3},5;1" for i in range(20))]
    path.write_text("\n".join(lines), encoding="utf-8")
    words = ["--observations", "x", "--actions", "a", "--reward", "r", "--episode", "e"]
    for named in (["--units-row"], ["--decimal-comma"], ["--missing-values", "Bad"], ["--on-missing", "break"]):
        assert main(["data", "import", str(path), "--out", str(tmp_path / "log.h5"), *words]) == 2
        said = capsys.readouterr().err
        assert " ".join(named) in said, said
        words += named
    assert main(["data", "import", str(path), "--out", str(tmp_path / "log.h5"), *words]) == 0
