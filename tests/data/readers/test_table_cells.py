"""Cells of one meaning are read alike, and what is not a learner's own column keeps its value to the last digit."""

import datetime
import decimal
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset
from odaf.data.readers import detect, tables
from odaf.errors import DatasetError

ROLES: dict[str, Any] = {"observations": ["x"], "actions": ["a"], "reward": "r", "episode": "e"}
ROWS = 12


def columns(**more: Any) -> dict[str, Any]:
    """Two episodes of six rows."""
    index = np.arange(ROWS)
    return {"e": index // 6, "x": index / 8.0, "a": index % 3 - 1.0, "r": index * 1.0, **more}


def written(folder: Path, **cells: Any) -> Path:
    """A CSV file of `columns`; a cell is written as `str` does."""
    table = columns(**cells)
    lines = [";".join(table), *(";".join(map(str, row)) for row in zip(*table.values(), strict=True))]
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def column(log: Any, field: str) -> np.ndarray:
    return np.asarray(log.columns[field])


FLAG = np.arange(ROWS) % 6 == 5


@pytest.mark.parametrize(
    ("no", "yes"),
    [
        *[("0", "1"), ("0.0", "1.0"), ("0.00000000", "1.00000000"), ("0.000e+00", "1.000000000000000000e+00")],
        *[("False", "True"), ("false", "TRUE"), ("no", "Yes"), ("n", "y"), ("off", "On"), ("f", "t"), (" 0 ", " 1 ")],
        *[("FALSCH", "WAHR"), ("FAUX", "VRAI"), ("-0.0", "+1")],
    ],
)
def test_flags_and_booleans_are_read_alike_however_they_are_written(no: str, yes: str, tmp_path: Path):
    cells = [yes if flag else no for flag in FLAG]
    log = tables.read(written(tmp_path, end=cells, b=cells), **{**ROLES, "observations": ["x", "b"]}, terminated="end")
    np.testing.assert_array_equal(column(log, "terminated"), FLAG)
    np.testing.assert_array_equal(column(log, "observations")[:, 1], FLAG.astype(np.float32))


def test_flags_with_a_decimal_comma(tmp_path: Path):
    cells = ["1,0" if flag else "0,00" for flag in FLAG]
    table = {name: [f"{value:.3f}".replace(".", ",") for value in columns()[name]] for name in "exar"}
    path = written(tmp_path, end=cells, **table)
    log = tables.read(path, **ROLES, terminated="end", decimal_comma=True, infos=["end"])
    np.testing.assert_array_equal(column(log, "terminated"), FLAG)
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(ROWS) / 8.0)
    np.testing.assert_array_equal(column(log, "episode"), np.arange(ROWS) // 6)
    np.testing.assert_array_equal(np.asarray(log.infos["end"]), FLAG.astype(float))


def test_words_among_other_numbers_are_no_numbers(tmp_path: Path):
    cells = ["True", *["0.5"] * (ROWS - 1)]
    with pytest.raises(DatasetError, match=r"column 'b' is not a number in row 2 \('True'\)"):
        tables.read(written(tmp_path, b=cells), **{**ROLES, "observations": ["b"]})


@pytest.mark.parametrize("cell", ["1.234", "-1.234.567", "12.000,5"])
def test_points_between_thousands_are_not_taken_for_decimal_marks(cell: str, tmp_path: Path):
    path = written(tmp_path, b=[cell, *["0,5"] * (ROWS - 1)])
    with pytest.raises(DatasetError, match=r"column 'b' is (written with a point|not a number)"):
        tables.read(path, **{**ROLES, "observations": ["b"]}, decimal_comma=True)


@pytest.mark.parametrize(
    ("cells", "step", "options"),
    [
        ([f"{i * 0.05:.2f}".replace(".", ",") for i in range(6)], 0.05, {"decimal_comma": True}),
        ([f"08:00:{i:02d}" for i in range(6)], 1.0, {"time_format": "%H:%M:%S"}),
        ([f"08:00:00.{i}" for i in range(6)], 0.1, {"time_format": "%H:%M:%S%.f"}),
        ([f"08:00:00.{i}" for i in range(6)], 0.1, {"time_format": "%H:%M:%S.%f"}),
        ([f"08:00:00,{i}" for i in range(6)], 0.1, {"time_format": "%H:%M:%S,%f"}),
        ([f"08:00:00,{i}" for i in range(6)], 0.1, {"decimal_comma": True}),
        ([f"8:{i:02d}" for i in range(6)], 60.0, {}),
        ([f"{i} days 00:00:00.500000" for i in range(6)], 86_400.0, {}),
        ([f"1 day, 0:00:{i:02d}" for i in range(6)], 1.0, {}),
        ([f"PT{i}.5S" for i in range(6)], 1.0, {}),
        ([f"P1DT1H{i}M" for i in range(6)], 60.0, {}),
        ([f"2024-03-01T08:00:00.{i}Z" for i in range(6)], 0.1, {}),
        ([f"2024-03-01 08:00:00,{i}" for i in range(6)], 0.1, {}),
        ([f"2024-03-01 08:00:00.00000000{i}" for i in range(6)], 1e-9, {}),
        ([f"01.03.2024 08:00:00,{i}" for i in range(6)], 0.1, {"time_format": "%d.%m.%Y %H:%M:%S,%f"}),
        ([f"{1_700_000_000_000_000_000 + i * 1_000}" for i in range(6)], 1000.0, {}),
        ([f"{1_700_000_000 + i / 10:.1f}" for i in range(6)], 0.1, {}),
    ],
)
def test_times_in_text(cells: list[str], step: float, options: dict[str, Any], tmp_path: Path):
    log = tables.read(
        written(tmp_path, x=range(ROWS), a=[0, 1] * 6, r=[1] * ROWS, t=cells * 2), **ROLES, time="t", **options
    )
    np.testing.assert_allclose(np.diff(column(log, "time")[:6]), step, rtol=1e-5)
    np.testing.assert_allclose(log.provenance["time_step"], step, rtol=1e-5)


@pytest.mark.parametrize("unit", ["W", "D", "h", "m", "s", "ms", "us", "ns", "ps", "fs"])
@pytest.mark.parametrize("kind", ["m8", "M8"])
def test_times_of_every_resolution_in_frames(kind: str, unit: str):
    seconds = {"W": 604_800.0, "D": 86_400.0, "h": 3_600.0, "m": 60.0, "s": 1.0}
    small = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ps": 1e-12, "fs": 1e-15}
    stamps = (np.arange(ROWS) % 6 + 3).astype(f"{kind}[{unit}]")
    log = tables.from_frame(columns(t=stamps), **ROLES, time="t")
    np.testing.assert_allclose(np.diff(column(log, "time")[:6]), (seconds | small)[unit], rtol=1e-6)
    stamps[4] = "NaT"
    with pytest.raises(DatasetError, match="column 't' has no value in row 4"):
        tables.from_frame(columns(t=stamps), **ROLES, time="t")


@pytest.mark.parametrize("unit", ["generic", "M", "Y"])
def test_durations_without_a_fixed_length_are_refused(unit: str):
    stamps = np.arange(ROWS).astype("m8" if unit == "generic" else f"m8[{unit}]")
    with pytest.raises(DatasetError, match="column 't' holds durations in .*give them in seconds"):
        tables.from_frame(columns(t=stamps), **ROLES, time="t")


ORDER = np.random.default_rng(0).permutation(ROWS)
KEYS = {
    "epoch seconds": 1.7e9 + ORDER,
    "counter": 2**24 + 5 + ORDER,
    "nanoseconds": 1_700_000_000_000_000_000 + ORDER,
    "unsigned": (2**63 + ORDER.astype(np.uint64)).astype(np.uint64),
    "128 bits": pl.Series([2**100 + int(row) for row in ORDER], dtype=pl.Int128),
    "decimals": [decimal.Decimal(10**25 + int(row)) / 10 for row in ORDER],
    "dates": pl.Series(ORDER.astype(np.int64)).cast(pl.Datetime("us")),
    "durations": ORDER.astype("m8[s]"),
    "python": [2**60 + int(row) for row in ORDER],
}


@pytest.mark.parametrize("form", ["frame", "csv", "parquet"])
@pytest.mark.parametrize("name", KEYS)
def test_rows_ascend_by_any_key_exactly(name: str, form: str, tmp_path: Path):
    table = columns(e=np.zeros(ROWS, int), x=ORDER / 8.0, key=KEYS[name])
    options = {**ROLES, "sort_by": ["e", "key"]}
    if form == "frame":
        log = tables.from_frame(table, **options)
    elif form == "csv":
        key = KEYS[name] if not isinstance(KEYS[name], pl.Series) else KEYS[name].to_list()
        cells = [f"{value:.1f}" if isinstance(value, float) else str(value) for value in key]
        if name in ("unsigned", "128 bits", "decimals", "durations"):
            return  # such numbers are no number of 64 bits in a text, or end in a word
        log = tables.read(written(tmp_path, e=[0] * ROWS, x=ORDER / 8.0, key=cells), **options)
    else:
        frame = pl.DataFrame({each: pl.Series(_for_polars(values)) for each, values in table.items()})
        frame.write_parquet(tmp_path / "log.parquet")
        log = tables.read(tmp_path / "log.parquet", **options)
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(ROWS) / 8.0)


def _for_polars(values: Any) -> Any:
    return values.astype("m8[us]") if isinstance(values, np.ndarray) and values.dtype.kind == "m" else values


def test_a_parquet_file_that_claims_to_be_sorted_is_sorted_all_the_same(tmp_path: Path):
    pl.DataFrame(columns(e=np.zeros(ROWS, int), x=ORDER / 8.0, key=pl.Series(ORDER).set_sorted())).write_parquet(
        tmp_path / "log.parquet"
    )
    log = tables.read(tmp_path / "log.parquet", **ROLES, sort_by=["key"])
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(ROWS) / 8.0)


@pytest.mark.parametrize("statistics", [True, False, "full"])
def test_missing_values_of_a_parquet_file_are_counted_from_the_values(statistics: Any, tmp_path: Path):
    level = np.arange(200) / 8.0
    level[100:150] = np.nan
    frame = pl.DataFrame({"e": np.zeros(200, int), "x": level, "a": np.tile([0.0, 1.0], 100), "r": np.ones(200)})
    frame.write_parquet(tmp_path / "log.parquet", statistics=statistics, row_group_size=50)
    with pytest.raises(DatasetError, match=r"column 'x' has no value \(empty or NaN\) in 50 of 200 rows"):
        tables.read(tmp_path / "log.parquet", **ROLES)
    with pytest.raises(DatasetError, match=r"column 'x' has no value .* in 50 of 200 rows"):
        tables.from_frame(pl.scan_parquet(tmp_path / "log.parquet"), **ROLES)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, bool])
def test_masked_entries_are_missing_whatever_lies_behind_the_mask(kind: Any):
    behind = np.where(np.arange(ROWS) == 3, -999, np.arange(ROWS)).astype(kind)
    mask = np.arange(ROWS) == 3
    with pytest.raises(DatasetError, match=r"column 'x' has no value \(empty or NaN\) in row 3"):
        tables.from_frame(columns(x=np.ma.masked_array(behind, mask)), **ROLES)
    wide = np.ma.masked_array(np.stack([behind, behind], 1), np.stack([mask, ~mask & False], 1))
    with pytest.raises(DatasetError, match=r"column 'x' has no value .* in row 3"):
        tables.from_frame(columns(x=wide), **ROLES)
    ids = np.ma.masked_array(np.arange(ROWS) // 6, mask)
    with pytest.raises(DatasetError, match="column 'e' has no value in row 3"):
        tables.from_frame(columns(e=ids), **ROLES)
    log = tables.from_frame(columns(x=np.ma.masked_array(behind, np.zeros(ROWS, bool))), **ROLES)
    assert column(log, "observations").shape == (ROWS, 1)


def test_further_columns_keep_type_and_precision(tmp_path: Path):
    further = {
        "count": 2**40 + np.arange(ROWS),
        "wide": np.arange(ROWS, dtype=np.uint64) + 2**63,
        "small": np.arange(ROWS).astype(np.int8),
        "fine": 1.0 + np.arange(ROWS) * 1e-12,
        "flag": FLAG,
        "pair": np.stack([np.arange(ROWS), np.arange(ROWS)], 1) + 2**40,
    }
    when = [datetime.datetime(2024, 3, 1) + datetime.timedelta(microseconds=index) for index in range(ROWS)]
    frame = pl.DataFrame(columns(**further, when=when))
    frame.write_parquet(tmp_path / "log.parquet")
    names = [*further, "when"]
    dataset = Dataset.from_log(tables.read(tmp_path / "log.parquet", **ROLES, infos=names, time="when"))
    dataset.save(tmp_path / "own.h5")
    kept = np.delete(np.arange(ROWS), [5, 11])
    for infos in (dataset.infos, Dataset.load(tmp_path / "own.h5").infos):
        for name, values in further.items():
            assert infos[name].dtype == np.asarray(values).dtype, name
            np.testing.assert_array_equal(infos[name], np.asarray(values)[kept])
        assert infos["when"][1] - infos["when"][0] == 1 and infos["when"].dtype == np.int64


def test_further_columns_of_a_text_table_get_the_type_that_holds_them(tmp_path: Path):
    cells = {
        "count": [2**60 + index for index in range(ROWS)],
        "fine": [f"{1 + index * 1e-12:.15f}" for index in range(ROWS)],
        "flag": ["True", "False"] * 6,
        "holes": ["", *range(1, ROWS)],
    }
    with pytest.raises(DatasetError, match="column 'holes' has no value"):
        tables.read(written(tmp_path, **cells), **ROLES, infos=list(cells))
    log = tables.read(written(tmp_path, **cells), **ROLES, infos=list(cells), on_missing="break")
    assert {name: values.dtype.kind for name, values in log.infos.items()} == {
        "count": "i",
        "fine": "f",
        "flag": "b",
        "holes": "f",
    }
    assert np.asarray(log.infos["count"])[1] == 2**60 + 1 and np.isnan(np.asarray(log.infos["holes"])[0])
    assert len(log) == ROWS  # a further column that misses a value costs no row


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            1_700_000_000 + np.arange(ROWS),
            "holds 12 different numbers, up to 1700000011, of which single precision keeps 1",
        ),
        (2**24 + np.arange(ROWS), "of which single precision keeps 7 apart"),
        (2**60 + np.arange(ROWS), "of which single precision keeps 1 apart"),
        (1.7e9 + np.arange(ROWS) / 4.0, "of which single precision keeps 1 apart"),
    ],
)
def test_numbers_that_single_precision_merges_are_refused_for_learners(values: Any, message: str, tmp_path: Path):
    for read in (
        lambda: tables.from_frame(columns(x=values), **ROLES),
        lambda: tables.read(written(tmp_path, x=values), **ROLES),
    ):
        with pytest.raises(DatasetError, match=f"column 'x' .*{message}") as caught:
            read()
        assert ("x_since = x - " in str(caught.value)) == (values.max() < 2**53)
    options = {**ROLES, "observations": [f"since = x - {values.min():.0f}"]}
    if values.max() > 2**53:
        with pytest.raises(DatasetError, match="column 'x' holds whole numbers beyond 53 bits"):
            tables.from_frame(columns(x=values), **options)
    else:
        log = tables.from_frame(columns(x=values), **options)
        np.testing.assert_array_equal(column(log, "observations")[:, 0], values - values.min())


def test_large_numbers_that_stay_apart_are_read():
    for values in (2**24 * np.arange(ROWS), 1.2e20 * np.arange(1, ROWS + 1), 1e8 + 1e4 * np.arange(ROWS)):
        log = tables.from_frame(columns(x=values), **ROLES)
        np.testing.assert_allclose(column(log, "observations")[:, 0], values, rtol=1e-6)


BATCHES = np.arange(ROWS) // 6
IDS = {
    "uuid": [uuid.UUID(int=int(batch) + 2**100) for batch in BATCHES],
    "bytes": [b"%016d" % batch for batch in BATCHES],
    "128 bits": pl.Series([2**100 + int(batch) for batch in BATCHES], dtype=pl.Int128),
    "huge": [2**100 + int(batch) for batch in BATCHES],
    "decimal": [decimal.Decimal(2**90 + int(batch)) for batch in BATCHES],
    "flag": BATCHES.astype(bool),
    "dates": BATCHES.astype("M8[D]"),
    "unsigned": BATCHES.astype(np.uint64) + 2**63,
    "whole": 2**53 + BATCHES,
    "nullable": np.array([2**60 + int(batch) for batch in BATCHES], object),
}


@pytest.mark.parametrize("name", IDS)
def test_ids_of_any_kind_stay_apart(name: str):
    log = tables.from_frame(columns(e=IDS[name]), **ROLES)
    assert len(np.unique(column(log, "episode"))) == 2
    assert Dataset.from_log(log).num_episodes == 2


@pytest.mark.parametrize(
    ("ids", "message"),
    [
        ([1, "1"] * 6, "column 'e' mixes numbers and text, for instance"),
        ([0.0] * 11 + [np.nan], "column 'e' has no value in row 11"),
        ([2**200] * ROWS, "column 'e' holds whole numbers beyond 127 bits"),
        ([{"a": 1}] * ROWS, "column 'e' holds cells of type Struct"),
        ([object()] * ROWS, "column 'e' holds cells of type Object"),
        (np.zeros(ROWS, complex), "column 'e' holds cells of type Object"),
        (np.zeros((ROWS, 2, 2)), "column 'e' holds cells of type Array"),
        (np.array(3.0), "column 'e' is array"),
    ],
)
def test_ids_that_name_nothing_get_a_message(ids: Any, message: str):
    with pytest.raises(DatasetError, match=message):
        tables.from_frame(columns(e=ids), **ROLES)


def test_ids_in_text(tmp_path: Path):
    cells = [f"{batch:.8e}" if row % 2 else f"{batch}.0" for row, batch in enumerate(BATCHES)]
    log = tables.read(written(tmp_path, e=cells), **ROLES)
    assert column(log, "episode").tolist() == BATCHES.tolist()
    log = tables.read(written(tmp_path, e=[f"00{batch}" for batch in BATCHES]), **ROLES)
    assert column(log, "episode").tolist() == [f"00{batch}" for batch in BATCHES]


EMPTY = {
    "at the end": lambda lines: [*lines, "", ""],
    "between": lambda lines: [*lines[:7], "", *lines[7:]],
    "under the headings": lambda lines: [lines[0], "", *lines[1:]],
    "above the headings": lambda lines: ["", "  ", *lines],
    "of separators": lambda lines: [*lines[:7], ";;;", "; ;;", *lines[7:]],
    "of quotes": lambda lines: [*lines[:7], '"";"";"";""', *lines[7:]],
    "of blanks": lambda lines: [*lines[:7], "   ", *lines[7:]],
    "sep=;": lambda lines: ["sep=;", *lines],
    '"sep=;"': lambda lines: ['"sep=;"', *lines],
    "sep=; and empty": lambda lines: ["SEP=;", "", *lines, ""],
}


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("name", EMPTY)
def test_empty_lines_count_but_are_no_rows(name: str, end: str, tmp_path: Path):
    path = written(tmp_path)
    lines = EMPTY[name](path.read_text().splitlines())
    path.write_bytes(end.join([*lines, ""]).encode())
    assert detect(path) == "csv"
    log = tables.read(path, **ROLES)
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(ROWS) / 8.0)
    assert [lines[number - 1] for number in np.asarray(log.row_numbers)] == [
        line for line in lines if line[:1].isdigit()
    ]
    lines[-1 if lines[-1] else -3] = "1;high;0;1"
    path.write_bytes(end.join([*lines, ""]).encode())
    with pytest.raises(DatasetError, match=rf"column 'x' is not a number in row {lines.index('1;high;0;1') + 1} "):
        tables.read(path, **ROLES)


def test_excels_first_line_says_what_parts_the_cells(tmp_path: Path):
    path = tmp_path / "log.csv"
    path.write_text("sep=:\ne:x,a;r:x:a:r\n" + "".join(f"{i // 6}:q:{i}:0:1\n" for i in range(ROWS)))
    assert tables.read(path, **ROLES).provenance["separator"] == ":"


def test_a_row_of_units_under_the_headings(tmp_path: Path):
    path = written(tmp_path, t=[index * 0.5 for index in range(6)] * 2)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "", "-;m³;[%];(EUR);s", *lines[1:]]))
    options = {**ROLES, "time": "t"}
    log = tables.read(path, **options, units_row=True)
    assert log.observation_units == ("m³",) and log.action_units == ("%",)
    assert len(log) == ROWS and np.asarray(log.row_numbers)[0] == 4
    assert tables.read(path, **options, units_row=True, units={"x": "l"}).observation_units == ("l",)
    with pytest.raises(DatasetError, match=r"'t' .* in row 3 \('s'\); pass units_row=True if that row holds units"):
        tables.read(path, **options)
    with pytest.raises(DatasetError, match="row 2 should hold the units, but it holds a number in each column"):
        tables.read(written(tmp_path), **ROLES, units_row=True)


WORDS = ["Bad", "No Data", "-9999", "#NV"]


@pytest.mark.parametrize("word", [*WORDS, "bad", "NO DATA", " Bad ", "-9999.0"])
def test_words_for_missing_values(word: str, tmp_path: Path):
    cells = [word if row == 3 else row / 8.0 for row in range(ROWS)]
    path = written(tmp_path, x=cells)
    log = tables.read(path, **ROLES, missing_values=WORDS, on_missing="nan")
    np.testing.assert_array_equal(np.isnan(column(log, "observations")[:, 0]), np.arange(ROWS) == 3)
    with pytest.raises(
        DatasetError, match=r"column 'x' has no value \(empty or NaN\) in row 5; .*on_missing=\"break\""
    ):
        tables.read(path, **ROLES, missing_values=WORDS)
    for frame in (columns(x=np.array(cells, object)), pl.DataFrame(columns(x=[str(cell) for cell in cells]))):
        if "9999" not in word:
            with pytest.raises(DatasetError, match="column 'x' (mixes|holds text)"):
                tables.from_frame(frame, **ROLES)
        log = tables.from_frame(frame, **ROLES, missing_values=WORDS, on_missing="nan")
        np.testing.assert_array_equal(np.isnan(column(log, "observations")[:, 0]), np.arange(ROWS) == 3)


def test_a_number_that_stands_for_missing_does_so_in_every_way_in(tmp_path: Path):
    cells = np.where(np.arange(ROWS) == 3, -9999.0, np.arange(ROWS))
    pl.DataFrame(columns(x=cells)).write_parquet(tmp_path / "log.parquet")
    for read in (
        lambda: tables.read(tmp_path / "log.parquet", **ROLES, missing_values=["-9999"]),
        lambda: tables.from_frame(columns(x=cells.astype(int)), **ROLES, missing_values=["-9999"]),
        lambda: tables.read(written(tmp_path, x=cells), **ROLES, missing_values=["-9999"]),
    ):
        with pytest.raises(DatasetError, match=r"column 'x' has no value .* in row (3|5)"):
            read()


def test_a_line_of_nothing_but_missing_values_is_no_empty_line(tmp_path: Path):
    path = written(tmp_path)
    lines = path.read_text().splitlines()
    lines[4] = "0;Bad;Bad;Bad"
    path.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match=r"has no value .* in row 5"):
        tables.read(path, **ROLES, missing_values=["Bad"])
    with pytest.raises(
        DatasetError, match=r"is not a number in row 5 \('Bad'\); .*pass missing_values=\[\"Bad\"\] if it"
    ):
        tables.read(path, **ROLES)
