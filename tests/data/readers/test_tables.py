"""Columns of CSV files, Parquet files and frames: what they become, and what is said of cells that cannot be used."""

import datetime
import json
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset
from odaf.data.readers import tables
from odaf.data.readers.table_meaning import Meaning
from odaf.errors import DatasetError

ROLES = {"observations": ["level", "flow"], "actions": ["valve"], "reward": "profit", "episode": "batch"}
BOUNDS = {"valve": (0.0, 100.0)}


def tank(rows=10, steps=5):
    """A log of batches of `steps` rows; its last row trips."""
    index = np.arange(rows)
    return pl.DataFrame(
        {
            "batch": index // steps,
            "time": (index % steps) * 0.5,
            "level": index + 0.25,
            "flow": -1.0 * index,
            "valve": index * 2.0,
            "profit": index * 10.0,
            "tripped": index == rows - 1,
            "note": [f"row {number}" for number in index],
        }
    )


def column(log, field) -> np.ndarray:
    return np.asarray(log.columns[field])


def csv_file(folder, text, encoding="utf-8"):
    path = folder / "log.csv"
    path.write_bytes(text.encode(encoding))
    return path


def check_tank(log):
    index = np.arange(10.0)
    np.testing.assert_array_equal(column(log, "observations"), np.stack([index + 0.25, -index], axis=1))
    np.testing.assert_array_equal(column(log, "actions")[:, 0], 2.0 * index)
    np.testing.assert_array_equal(np.ravel(column(log, "rewards")), 10.0 * index)
    np.testing.assert_array_equal(column(log, "episode"), np.repeat([0, 1], 5))
    assert log.observation_names == ("level", "flow") and log.action_names == ("valve",)


def findings(dataset):
    return {finding["finding"]: finding["count"] for finding in dataset.provenance["findings"]}


@pytest.mark.parametrize("form", ["csv", "parquet", "polars", "lazy", "mapping"])
def test_every_form_gives_the_same_log(form, tmp_path):
    frame, path = tank(), tmp_path / f"log.{form}"
    options = {**ROLES, "terminated": "tripped", "action_bounds": BOUNDS}
    if form == "csv":
        frame.write_csv(path)
        log = tables.read(path, **options)
        assert log.row_numbers == range(2, 12) and log.source == str(path)
    elif form == "parquet":
        frame.write_parquet(path)
        log = tables.read(path, **options)
        assert log.row_numbers == range(10)
    else:
        whole = {
            "polars": frame,
            "lazy": frame.lazy(),
            "mapping": {name: frame[name].to_numpy() for name in frame.columns},
        }
        log = tables.from_frame(whole[form], **options)
        assert log.format == "frame"
    check_tank(log)
    assert log.provenance["columns_not_read"] == ["time", "note"] and log.provenance["rows_in_file"] == 10
    dataset = Dataset.from_log(log)
    assert len(dataset) == 9  # the last row of batch 0 has no successor
    assert findings(dataset) == {
        "unfinished-episodes": 1,
        "dropped-without-successor": 1,
        "terminal-successor-unknown": 1,
    }
    json.dumps(dataset.summary())


def test_only_named_columns_of_a_parquet_file_are_read(tmp_path, monkeypatch):
    tank().write_parquet(tmp_path / "log.parquet")
    asked, original = [], pl.read_parquet
    monkeypatch.setattr(pl, "read_parquet", lambda *a, **k: asked.extend(k["columns"]) or original(*a, **k))
    tables.read(tmp_path / "log.parquet", **ROLES)
    assert sorted(asked) == ["batch", "flow", "level", "profit", "valve"]


class Series:
    """As much of pandas' interface as is used; missing values are marked, not None."""

    def __init__(self, values):
        self._values = values

    def __len__(self):
        return len(self._values)

    def to_numpy(self):
        return self._values

    def isna(self):
        return np.array([value is Ellipsis for value in self._values])


class Frame:
    """A frame that is neither polars nor a mapping."""

    def __init__(self, columns):
        self._columns = columns
        self.columns = list(columns)

    def __getitem__(self, name):
        return Series(self._columns[name])


def test_frames_with_the_interface_of_pandas():
    frame = tank()
    columns = {name: frame[name].to_numpy() for name in frame.columns}
    columns["batch"] = np.array([f"b{batch}" for batch in columns["batch"]], object)
    columns["level"] = columns["level"].astype(object)  # as pandas holds nullable numbers
    log = tables.from_frame(Frame(columns), **ROLES)
    np.testing.assert_array_equal(column(log, "observations")[:, 0], np.arange(10) + 0.25)
    assert column(log, "episode").tolist() == ["b0"] * 5 + ["b1"] * 5
    columns["level"][3] = ...
    with pytest.raises(DatasetError, match=r"frame: column 'level' has no value \(empty or NaN\) in row 3"):
        tables.from_frame(Frame(columns), **ROLES)
    columns["level"][3] = "full"
    with pytest.raises(DatasetError, match=r"column 'level' mixes numbers and text, for instance 'full' in row 3"):
        tables.from_frame(Frame(columns), **ROLES)


class Nullable:
    """A column of pandas' type Int64 and its like: values behind marks, which come as NaN unless one says otherwise."""

    def __init__(self, values, kind):
        self._values = values
        self.dtype = type(kind, (), {"numpy_dtype": np.dtype(kind.lower())})()

    def __len__(self):
        return len(self._values)

    def isna(self):
        return np.array([value is None for value in self._values])

    def to_numpy(self, dtype=None, na_value=np.nan):
        return np.array([na_value if value is None else value for value in self._values], dtype)


class Moment(datetime.datetime):
    """pandas' Timestamp: a moment of Python's, which has no nanoseconds, that can give them."""

    nanoseconds = 0

    @classmethod
    def at(cls, nanoseconds, zone=None):
        moment = cls.fromtimestamp(nanoseconds // 10**9, zone)
        moment.nanoseconds = nanoseconds
        return moment

    def to_datetime64(self):
        return np.datetime64(self.nanoseconds, "ns")


def test_numbers_that_may_be_missing_keep_their_type_and_their_digits():
    """As pandas' Int64, boolean and Float32 give them: what is missing is missing, and nothing is rounded."""
    rows, large = 10, 2**60
    columns: dict[str, Any] = {name: tank()[name].to_numpy() for name in tank().columns}
    columns["batch"] = Nullable([large + 1] * 5 + [large + 2] * 4 + [None], "Int64")
    columns["id"] = Nullable([large + row for row in range(rows)], "UInt64")
    columns["count"] = Nullable(list(range(rows)), "Int8")
    columns["on"] = Nullable([True, False] * 5, "Bool")
    log = tables.from_frame(columns, **ROLES, infos=["id", "count", "on"], on_missing="break")
    assert column(log, "episode").tolist() == [0] * 5 + [1] * 4, "ids that differ in their last digit are two"
    infos = {name: np.asarray(values) for name, values in log.infos.items()}
    assert infos["id"].tolist()[:3] == [large, large + 1, large + 2] and infos["id"].dtype == np.uint64
    assert infos["count"].dtype == np.int8 and infos["on"].dtype == bool
    columns["level"] = Nullable([None, *range(1, rows)], "Float32")
    with pytest.raises(DatasetError, match=r"frame: column 'level' has no value .* in row 0;"):
        tables.from_frame(columns, **{**ROLES, "episode": 0})


def test_moments_keep_their_nanoseconds_and_are_of_one_kind():
    zone = ZoneInfo("Europe/Berlin")
    first = 1711846800 * 10**9  # half an hour before clocks go forward
    moments: list[Any] = [Moment.at(first + 100 * row, zone) for row in range(10)]
    columns: dict[str, Any] = {name: tank()[name].to_numpy() for name in tank().columns}
    columns |= {"time": Series(np.array(moments, object)), "seen": Series(np.array(moments, object))}
    log = tables.from_frame(columns, **ROLES, infos=["seen"])
    assert np.asarray(log.infos["seen"]).tolist() == [first + 100 * row for row in range(10)]
    assert not [finding for finding in log.findings if finding["finding"] == "time-gaps"]
    moments[3] = ...
    columns["seen"] = Series(np.array(moments, object))
    with pytest.raises(DatasetError, match="column 'seen' has no value .* in row 3"):
        tables.from_frame(columns, **ROLES, infos=["seen"])
    moments[3] = Moment.at(0)
    columns["seen"] = Series(np.array(moments, object))
    with pytest.raises(DatasetError, match="mixes moments in a time zone and moments without a time zone, .* in row 3"):
        tables.from_frame(columns, **ROLES, infos=["seen"])


def test_pandas_frames():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({name: tank()[name].to_numpy() for name in tank().columns})
    check_tank(tables.from_frame(frame, **ROLES))
    frame["level"] = frame["level"].astype("Float64")
    frame["batch"] = frame["batch"].astype("category")
    check_tank(tables.from_frame(frame, **ROLES))
    frame.loc[3, "level"] = pandas.NA
    with pytest.raises(DatasetError, match="column 'level' has no value .* in row 3"):
        tables.from_frame(frame, **ROLES)


def test_from_dataframe_as_the_front_page_shows_it():
    dataset = Dataset.from_dataframe(
        tank(),
        observations=["level", "flow"],
        actions=["valve"],
        reward="profit",
        episode="batch",
        terminated="tripped",
        time="time",
        action_bounds=BOUNDS,
        units={"level": "m", "valve": "%"},
    )
    assert dataset.observation_units == ("m", "") and dataset.action_units == ("%",)
    assert dataset.num_episodes == 2 and dataset.action_high.tolist() == [100.0]
    assert dataset.provenance["time_step"] == 0.5
    with pytest.raises(DatasetError, match="Dataset.from_dataframe: column 'levle' not found; did you mean 'level'"):
        Dataset.from_dataframe(tank(), **{**ROLES, "observations": ["levle"]})
    with pytest.raises(DatasetError, match=r"unknown among the options \['episod'.*a frame takes .*sort_by"):
        tables.from_frame(tank(), observations=["level"], actions=["valve"], reward="profit", episod="batch")


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("batch,level,flow,valve,profit\n{}", {}),
        ("\ufeffbatch,level,flow,valve,profit\r\n{}", {}),
        ("batch;level;flow;valve;profit\n{}", {}),
        ("batch\tlevel\tflow\tvalve\tprofit\n{}", {}),
        ("batch|level|flow|valve|profit\n{}", {}),
        ('"batch", "level", flow , valve, profit\n{}', {}),
        ("batch;level;flow;valve;profit\n{}", {"decimal_comma": True}),
        ("batch,level,flow,valve,profit\n{}", {"decimal_comma": True}),
        ("made by logger 3, version 1\n\nbatch;level;flow;valve;profit\n{}", {"skip_rows": 2}),
        ("batch,level,flow,valve,profit,größe\n{}", {"encoding": "latin-1"}),
        ("batch;level;flow;valve;profit\n{}", {"encoding": "utf-16"}),
        ("b [,];profit,,;batch;level;flow;valve;profit\n{}", {"separator": ";"}),
    ],
)
def test_dialects(text, options, tmp_path):
    separator = next(mark for mark in ";\t|," if mark in text.replace(", version", ""))
    quote = '"' if separator == "," else ""
    rows = [[index // 5, index + 0.25, -1.0 * index, 2.0 * index, 10.0 * index] for index in range(10)]
    lines = [[f"{quote}{value}{quote}" for value in row] for row in rows]
    if "größe" in text:
        lines = [[*line, '"groß, und ""rund"""'] for line in lines]
    if "profit,," in text:
        lines = [["a, b", "", *line] for line in lines]
    body = "\n".join(separator.join(line) for line in lines)
    if options.get("decimal_comma"):
        body = body.replace(".", ",")
    path = csv_file(tmp_path, text.format(body), options.get("encoding", "utf-8"))
    log = tables.read(path, **ROLES, **options)
    check_tank(log)
    assert log.provenance["separator"] == separator


def test_spaces_around_numbers_and_words_for_flags(tmp_path):
    text = "batch,level,flow,valve,profit,end\n" + "".join(
        f"a, {i}.5 ,1,2,3,{'Yes' if i == 3 else 'no'}\n" for i in range(4)
    )
    log = tables.read(csv_file(tmp_path, text), **ROLES, terminated="end")
    assert column(log, "observations")[:, 0].tolist() == [0.5, 1.5, 2.5, 3.5]
    assert column(log, "terminated").tolist() == [False, False, False, True]


def test_units_from_headings_only_when_asked(tmp_path):
    text = "batch,level [m],flow (m³/s),valve [%],profit\n0,1,2,3,4\n0,1,2,4,4\n"
    path = csv_file(tmp_path, text)
    log = tables.read(path, **ROLES, units="headings", action_bounds=BOUNDS)
    assert log.observation_names == ("level", "flow") and log.observation_units == ("m", "m³/s")
    assert log.action_units == ("%",) and Dataset.from_log(log).action_high.tolist() == [100.0]
    with pytest.raises(DatasetError, match="column 'level' not found; did you mean 'level"):
        tables.read(path, **ROLES)
    frame = pl.read_csv(path)
    assert tables.from_frame(frame, **ROLES, units="headings").observation_units == ("m", "m³/s")
    with pytest.raises(DatasetError, match="units: column 'levl' not found; did you mean 'level'"):
        tables.from_frame(tank(), **ROLES, units={"levl": "m"})


def test_lists_in_cells_become_columns(tmp_path):
    frame = pl.DataFrame(
        {
            "state": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
            "action": np.arange(6.0).reshape(3, 2),
            "profit": [1, 2, 3],
            "next": [[4.0, 5.0, 6.0], [7.0, 8.0, 9.0], [0.0, 0.0, 0.0]],
        }
    )
    frame.write_parquet(tmp_path / "log.parquet")
    roles = {"observations": ["state"], "actions": ["action"], "reward": "profit", "episode": 0}
    log = tables.read(tmp_path / "log.parquet", **roles, next_observations=["next"], action_bounds={"action": (-9, 9)})
    np.testing.assert_array_equal(column(log, "observations"), np.arange(1.0, 10.0).reshape(3, 3))
    np.testing.assert_array_equal(column(log, "actions"), np.arange(6.0).reshape(3, 2))
    assert log.observation_names == ("state_0", "state_1", "state_2") and log.action_names == ("action_0", "action_1")
    dataset = Dataset.from_log(log)
    assert len(dataset) == 3 and dataset.action_low.tolist() == [-9.0, -9.0]
    mapping = {"state": np.arange(9.0).reshape(3, 3), "action": np.zeros((3, 2)), "profit": [0.0, 1.0, 2.0]}
    assert tables.from_frame(mapping, **roles).columns["observations"].shape == (3, 3)


def test_dates_become_seconds(tmp_path):
    start = datetime.datetime(2024, 3, 1, 12)
    moments = [start + datetime.timedelta(seconds=0.5 * index) for index in range(5)] * 2
    frame = tank().with_columns(pl.Series("time", moments))
    for form in ("parquet", "iso", "german"):
        path = tmp_path / f"log.{form}"
        options: dict[str, Any] = {}
        if form == "parquet":
            frame.write_parquet(path)
        elif form == "iso":
            frame.write_csv(path)
        else:
            frame.with_columns(pl.col("time").dt.strftime("%d.%m.%Y %H:%M:%S%.f")).write_csv(path)
            options = {"time_format": "%d.%m.%Y %H:%M:%S%.f"}
        log = tables.read(path, **ROLES, time="time", **options)
        np.testing.assert_allclose(np.diff(column(log, "time"))[:4], 0.5)
        assert log.provenance["time_step"] == 0.5


def test_missing_cells_can_be_kept_as_nan(tmp_path):
    path = csv_file(tmp_path, "batch,level,flow,valve,profit\n0,1,2,3,4\n0,NA,,3,4\n0,1,nan,3,4\n")
    log = tables.read(path, **ROLES, on_missing="nan")
    np.testing.assert_array_equal(np.isnan(column(log, "observations")), [[0, 0], [1, 1], [0, 1]])


def test_infos_are_kept_beside_the_rows():
    dataset = Dataset.from_log(tables.from_frame(tank(), **ROLES, infos=["time"], action_bounds=BOUNDS))
    np.testing.assert_array_equal(dataset.infos["time"], np.tile([0.0, 0.5, 1.0, 1.5], 2))


def rows_with(row, cells, rows=8):
    lines = [f"{index // 4},{index},1,2,3" for index in range(rows)]
    lines[row] = cells
    return "batch,level,flow,valve,profit\n" + "\n".join(lines) + "\n"


CSV_TROUBLE = {
    "text": (rows_with(3, "0,high,1,2,3"), {}, r"log.csv: column 'level' is not a number in row 5 \('high'\); correct"),
    "comma": (rows_with(3, '0,"3,5",1,2,3'), {}, r"column 'level' is not a number in row 5 .*decimal_comma=True"),
    "list": (rows_with(2, '0,"[1.0, 2.0]",1,2,3'), {}, r"column 'level' .* in row 4 .*looks like a list"),
    "empty": (rows_with(6, "1,1,1,2,"), {}, r"column 'profit' has no value \(empty or NaN\) in row 8; .*on_missing"),
    "nan": (rows_with(6, "1,1,nan,2,1"), {}, r"column 'flow' has no value .* in row 8 \(nan\)"),
    "short": (rows_with(6, "1,1,1"), {}, r"column 'valve' has no value .* in row 8"),
    "no id": (rows_with(5, ",5,1,2,3"), {}, r"column 'batch' has no value in row 7; every row needs the id"),
    "long": (rows_with(3, "0,3,5,1,2,3"), {}, r"log.csv: row 5 has 6 cells, there are 5 headings; quote"),
    "huge": (rows_with(1, "0,1e300,1,2,3"), {}, r"column 'level' is too large for single precision in row 3"),
    "not a flag": (rows_with(1, "0,2,0,2,3"), {"terminated": "flow", "episode": None}, None),
    "flag": (rows_with(1, "0,2,7,2,3"), {"terminated": "flow"}, r"'flow' is neither true nor false in row 3 \(.*7"),
    "case": (rows_with(0, "0,0,1,2,3"), {"reward": "Profit"}, r"column 'Profit' not found; did you mean 'profit'\?"),
    "missing": (rows_with(0, "0,0,1,2,3"), {"reward": "cost"}, r"column 'cost' not found; the table has 'batch', 'lev"),
    "same name": (rows_with(0, "0,0,1,2,3").replace("profit", "level", 1), {"reward": "valve"}, "2 columns are called"),
    "no rows": ("batch,level,flow,valve,profit\n", {}, "has 5 columns and no rows"),
    "nothing": ("", {}, r"row 1 should hold the headings, but the file is empty there"),
    "one wide": ("level\n1\n", {"observations": "level"}, r"observations is the text 'level'; give a list of names"),
    "no names": ("level\n1\n", {"actions": []}, "actions names no column"),
    "twice named": (rows_with(0, "0,0,1,2,3"), {"observations": ["flow", "flow"]}, "column 'flow' is named twice"),
    "uneven": (rows_with(0, "0,0,1,2,3"), {"next_observations": ["level"]}, "next_observations names 1 columns"),
    "quote": (rows_with(3, '0,"3,1,2,3'), {}, "cannot be read"),
    "no ends": (rows_with(0, "0,0,1,2,3"), {"episode": None}, r"no end of an episode was given.*episode=0 if all rows"),
    "step": (rows_with(0, "0,0,1,2,3"), {"time_step": 1.0}, "time_step= and time_format= explain a time column"),
    "no step": (rows_with(0, "0,0,1,2,3"), {"time_step": 0.0, "time": "level"}, "time_step is 0.0; give the time"),
    "separator": (rows_with(0, "0,0,1,2,3"), {"separator": "::"}, "separator is '::'; it must be one character"),
    "skip": (rows_with(0, "0,0,1,2,3"), {"skip_rows": -1}, "skip_rows is -1"),
    "encoding": (rows_with(0, "0,0,1,2,3"), {"encoding": "utf-99"}, "encoding 'utf-99' is unknown"),
    "time": (
        rows_with(2, "0,2,1,noon,3"),
        {"time": "valve"},
        r"'valve' is not a number of sec.* in row 4 \('noon'",
    ),
    "unit": (rows_with(0, "0,0,1,s,3"), {"time": "valve"}, r"'valve' is not a number of sec.* in row 2 .*units_row=Tr"),
    "date": (
        rows_with(0, "0,0,1,noon,3").replace(",2,3", ",one,3"),
        {"time": "valve"},
        r"'valve' cannot be read as a date.*time_format=",
    ),
}


@pytest.mark.parametrize("name", CSV_TROUBLE)
def test_csv_trouble_names_file_column_rows_and_remedy(name, tmp_path):
    text, options, message = CSV_TROUBLE[name]
    path = csv_file(tmp_path, text)
    if message is None:
        assert column(tables.read(path, **{**ROLES, **options}), "terminated").sum() == 7
        return
    with pytest.raises(DatasetError, match=message) as caught:
        tables.read(path, **{**ROLES, **options})
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("field", ["on_gap", "on_missing", "units"])
def test_words_that_are_no_choice_are_refused(field):
    meaning = Meaning(observations=["level"], actions=["valve"], reward="profit")
    object.__setattr__(meaning, field, "drop")  # run-time type checks would not let it pass
    with pytest.raises(DatasetError, match=f"log: {field} is 'drop'"):
        meaning.check("log")


def test_rows_of_a_csv_file_are_counted_behind_what_is_skipped(tmp_path):
    path = csv_file(tmp_path, "one\ntwo\n" + rows_with(3, "0,high,1,2,3"))
    with pytest.raises(DatasetError, match="column 'level' is not a number in row 7"):
        tables.read(path, **ROLES, skip_rows=2)


def test_text_that_is_not_utf_8_says_which_option_helps(tmp_path):
    path = csv_file(tmp_path, "batch,level,flow,valve,profit,note\n0,1,2,3,4,größe\n", "latin-1")
    with pytest.raises(DatasetError, match=r'not text in UTF-8 \(byte 0xf6\); pass encoding="latin-1"'):
        tables.read(path, **ROLES)
    path = csv_file(tmp_path, "batch,level,flow,valve,profit\n0,1,2,3,4\n", "utf-16")
    with pytest.raises(DatasetError, match='is text in UTF-16; pass encoding="utf-16"'):
        tables.read(path, **ROLES)
    with pytest.raises(DatasetError, match="is not text in ascii"):
        tables.read(csv_file(tmp_path, "grö", "utf-8"), **ROLES, encoding="ascii")


FRAME_TROUBLE = {
    "text": (pl.Series("level", ["1"] * 10), r"column 'level' holds text, not numbers in 10 of 10 rows.*\('1'\)"),
    "null": (
        pl.Series("level", [1.0, None] * 5),
        r"'level' has no value .* 5 of 10 rows, the first of them 1, 3",
    ),
    "all null": (pl.Series("level", [None] * 10), r"column 'level' has no value .* 10 of 10 rows"),
    "date": (pl.Series("level", [datetime.date(2024, 1, 1)] * 10), r"'level' holds cells of type Date, not numbers"),
    "struct": (pl.Series("level", [{"a": 1}] * 10), r"'level' holds cells of type Struct.*, not numbers"),
    "ragged": (
        pl.Series("level", [[1, 2]] * 9 + [[1]]),
        r"lists of different lengths: 2 .* 1 elsewhere in row 9 ",
    ),
    "hole": (pl.Series("level", [[1, 2]] * 9 + [[1, None]]), r"column 'level' has no value .* in row 9 \(\[1, None\]"),
    "no list": (
        pl.Series("level", [[1, 2]] * 9 + [None]),
        r"'level' has no value in row 9; every row needs its",
    ),
    "empty lists": (pl.Series("level", [[]] * 10, dtype=pl.List(pl.Float64)), "column 'level' holds empty lists"),
    "nested": (pl.Series("level", [[[1.0]]] * 10), r"'level' holds cells of type List\(List\(Float64\)\)"),
    "list of text": (pl.Series("level", [["a"]] * 10), r"'level' holds cells of type List\(String\)"),
    "flag, first row": (
        pl.Series("tripped", [2, 1, 0, 0, 0, 0, 0, 0, 0, 0]),
        r"'tripped' is neither true nor false in row 0",
    ),
    "flag": (pl.Series("tripped", [0, 1, 2, 0, 0, 0, 0, 0, 0, 0]), r"'tripped' is neither true nor false in row 2"),
    "text flag": (pl.Series("tripped", ["no"] * 10), "'tripped' holds text"),
    "no flags": (pl.Series("tripped", [None] * 10), "'tripped' has no value in 10 of 10 rows"),
    "null flag": (pl.Series("tripped", [False] * 9 + [None]), "'tripped' has no value in row 9"),
    "null id": (pl.Series("batch", [0] * 9 + [None]), "'batch' has no value in row 9; every row needs the id"),
    "list id": (pl.Series("batch", [[0]] * 10), r"'batch' holds cells of type List\(Int64\)"),
    "no time": (pl.Series("time", [0.0] * 9 + [None]), "'time' has no value in row 9; every row needs its time"),
    "endless": (pl.Series("time", [0.0] * 9 + [np.inf]), "'time' is not finite in row 9"),
    "text time": (pl.Series("time", ["0"] * 10), "'time' holds text"),
}


@pytest.mark.parametrize("name", FRAME_TROUBLE)
def test_frame_trouble_names_column_rows_and_remedy(name, tmp_path):
    series, message = FRAME_TROUBLE[name]
    frame = tank().with_columns(series)
    with pytest.raises(DatasetError, match=message):
        tables.from_frame(frame, **ROLES, terminated="tripped", time="time")
    frame.write_parquet(tmp_path / "log.parquet")
    with pytest.raises(DatasetError, match=r"log.parquet: .*" + message):
        tables.read(tmp_path / "log.parquet", **ROLES, terminated="tripped", time="time")


def test_what_is_no_table_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="got int; pass a polars or pandas frame"):
        tables.from_frame(3, **ROLES)
    with pytest.raises(DatasetError, match="column name 0 is not a text"):
        tables.from_frame({0: [1.0]}, **ROLES)
    with pytest.raises(DatasetError, match=r"column 'level' has 3 rows, there should be 10"):
        tables.from_frame({name: tank()[name].to_numpy() for name in tank().columns} | {"level": np.zeros(3)}, **ROLES)
    with pytest.raises(DatasetError, match=r"column 'level' is 3; give a sequence with one entry per step"):
        tables.from_frame({"level": 3, "flow": [1.0], "valve": [1.0], "profit": [1.0]}, **{**ROLES, "episode": 0})
    with pytest.raises(DatasetError, match=r"column 'level' holds cells of type Object, not numbers in 2 of 2 rows"):
        tables.from_frame(
            {"level": [1j, 2j], "flow": [1, 2], "valve": [0, 1], "profit": [1, 2], "batch": [0, 0]}, **ROLES
        )
    with pytest.raises(DatasetError, match="there is no such file"):
        tables.read(tmp_path / "none.csv", **ROLES)
    with pytest.raises(DatasetError, match="is a folder"):
        tables.read(tmp_path, **ROLES)
    path = tmp_path / "log.parquet"
    tank().write_parquet(path)
    with pytest.raises(
        DatasetError, match="separator=, decimal_comma=, encoding=, skip_rows= and units_row= apply to CSV"
    ):
        tables.read(path, **ROLES, skip_rows=1)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(DatasetError, match="no complete Parquet file: its last four bytes are not the signature"):
        tables.read(path, **ROLES)


def test_arrays_of_a_log_are_shared_with_the_dataset_not_copied():
    log = tables.from_frame(tank(), **ROLES, next_observations=["flow", "level"], action_bounds=BOUNDS)
    dataset = Dataset.from_log(log)
    assert np.shares_memory(dataset.observations, column(log, "observations"))
    assert not dataset.observations.flags.writeable
