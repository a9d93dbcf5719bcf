"""Folders with a file for each day: one table, whatever else lies beside the files."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from odaf import cli
from odaf.data import Dataset
from odaf.data.readers import detect, lerobot, read, tables
from odaf.errors import DatasetError

ROLES: dict[str, Any] = {"observations": ["x"], "actions": ["a"], "reward": "r"}
STRAY = [
    "_SUCCESS",
    "_metadata",
    "_common_metadata",
    ".DS_Store",
    "._day-1.csv",
    "._day-1.parquet",
    ".day-1.parquet.crc",
]
STRAY += ["Thumbs.db", "desktop.ini", "day-1.csv.bak", "~$day-1.csv", "README.md"]


def days(folder: Path, kind: str, **cells: Any) -> Path:
    """Three files of 16 rows; `x` counts the rows through all of them."""
    folder.mkdir(parents=True)
    for place, day in enumerate((1, 2, 10)):
        index = 16 * place + np.arange(16)
        frame = pl.DataFrame({"t": index * 1.0, "x": index / 2, "a": index % 3 - 1.0, "r": index * 1.0})
        frame = frame.with_columns(**{name: pl.Series(make(day, index)) for name, make in cells.items()})
        path = folder / f"day-{day}.{kind}"
        (frame.write_csv if kind == "csv" else frame.write_parquet)(path)
    for name in STRAY:
        (folder / name).write_bytes(b"\x00\x05\x16\x07 no table")
    return folder


def column(log: Any, field: str) -> np.ndarray:
    return np.asarray(log.columns[field])


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_the_files_of_a_folder_are_one_table_in_natural_order(kind: str, tmp_path: Path):
    folder = days(tmp_path / "log", kind)
    assert detect(folder) == kind
    log = read(folder, **ROLES, episode=0, time="t")
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(48) / 2)
    assert log.findings == () and np.asarray(log.row_numbers).tolist() == list(range(48))
    assert [file["name"] for file in log.provenance["files"]] == [f"day-{day}.{kind}" for day in (1, 2, 10)]
    assert log.provenance["file"] == "log" and log.provenance["rows_in_file"] == 48
    by_file = Dataset.from_log(read(folder, **ROLES, episode="file"))
    assert by_file.num_episodes == 3 and len(by_file) == 45


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_messages_name_the_file_and_the_row_in_it(kind: str, tmp_path: Path):
    folder = days(tmp_path / "log", kind, x=lambda day, index: pl.Series([None if i == 21 else i / 2 for i in index]))
    row = 7 if kind == "csv" else 5
    with pytest.raises(
        DatasetError, match=rf"log: column 'x' has no value .* in row 21 \(row {row} of day-2.{kind}\); fi"
    ):
        tables.read(folder, **ROLES, episode="file")
    assert len(tables.read(folder, **ROLES, episode="file", on_missing="break")) == 47


def test_text_in_one_file_is_text_in_all(tmp_path: Path):
    folder = days(
        tmp_path / "log", "csv", x=lambda day, index: [f"{i / 2} " if day == 2 else str(i / 2) for i in index]
    )
    log = tables.read(folder, **ROLES, episode="file", infos=["t"])
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(48) / 2)
    folder = days(tmp_path / "words", "csv", x=lambda day, index: ["Bad" if i == 21 else str(i / 2) for i in index])
    with pytest.raises(DatasetError, match=r"'x' is not a number in row 21 \('Bad', row 7 of day-2.csv\)"):
        tables.read(folder, **ROLES, episode="file")
    assert len(tables.read(folder, **ROLES, episode="file", missing_values=["Bad"], on_missing="break")) == 47


def test_what_does_not_belong_together_is_refused(tmp_path: Path):
    folder = days(tmp_path / "log", "csv")
    with pytest.raises(DatasetError, match="day-1.csv: column 'y' not found"):
        tables.read(folder, **{**ROLES, "observations": ["y"]}, episode="file")
    (folder / "day-2.csv").write_text("t,a,r\n1,1,1\n")
    with pytest.raises(DatasetError, match="day-2.csv: column 'x' not found"):
        tables.read(folder, **ROLES, episode="file")
    (folder / "day-2.csv").write_text("t,x [cm],a,r\n1,1,1,2\n")
    (folder / "day-1.csv").write_text("t,x [m],a,r\n1,1,1,2\n")
    with pytest.raises(DatasetError, match="column 'x' is in m in day-1.csv and in cm in day-2.csv; convert one"):
        tables.read(folder, **ROLES, episode="file", units="headings")
    (folder / "day-1.parquet").write_bytes(b"PAR1")
    for way in (detect, lambda path: tables.read(path, **ROLES, episode="file")):
        with pytest.raises(DatasetError, match="holds both CSV and Parquet files .day-1.csv and day-1.parquet."):
            way(folder)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "_SUCCESS").touch()
    with pytest.raises(DatasetError, match="nor with CSV or Parquet files in it"):
        detect(empty)


def test_companions_beside_the_files_of_a_lerobot_folder(tmp_path: Path):
    data = tmp_path / "arm" / "data" / "chunk-000"
    data.mkdir(parents=True)
    (tmp_path / "arm" / "meta").mkdir()
    (tmp_path / "arm" / "meta" / "info.json").write_text('{"codebase_version": "v3.0", "fps": 10, "features": {}}')
    index = np.arange(8)
    columns = {"observation.state": index * 1.0, "action": index % 3 - 1.0, "next.reward": index * 1.0}
    pl.DataFrame({**columns, "episode_index": index // 4, "frame_index": index % 4}).write_parquet(
        data / "file-000.parquet"
    )
    listed = {"episode_index": [[episode] for episode in index // 4], "frame_index": index % 4}
    pl.DataFrame({**columns, **listed}).write_parquet(data / "file-001.parquet")
    with pytest.raises(DatasetError, match="differ in type|column 'episode_index' holds cells of type List"):
        lerobot.read(tmp_path / "arm")
    (data / "file-001.parquet").unlink()
    for name in ("._file-000.parquet", ".DS_Store", "_SUCCESS"):
        (data / name).write_bytes(b"\x00")
    assert len(lerobot.read(tmp_path / "arm")) == 8


def test_a_folder_on_the_command_line(tmp_path: Path):
    folder = days(tmp_path / "log", "csv", a=lambda day, index: np.sin(index))
    words = [
        "--observations",
        "x",
        "--actions",
        "a",
        "--reward",
        "r",
        "--episode",
        "file",
        "--out",
        str(tmp_path / "o.h5"),
    ]
    assert cli.main(["data", "import", str(folder), *words]) == 0
    assert Dataset.load(tmp_path / "o.h5").num_episodes == 3
