"""Rows that miss a value, left out: no row is followed by one that came later."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odaf.data import Dataset
from odaf.data.readers import tables
from odaf.errors import DatasetError

ROLES: dict[str, Any] = {
    "observations": ["level", "flow"],
    "actions": ["valve"],
    "reward": "profit",
    "action_bounds": (-1.0, 1.0),
    "on_missing": "break",
}


def log_of(rows: int, **cells: Any) -> pl.DataFrame:
    """Rows whose level counts them, all of one batch and one second apart, where nothing else is given."""
    index = np.arange(rows)
    columns = {"batch": index * 0, "time": index * 1.0, "level": index * 1.0, "flow": index * 0.5, "valve": index * 0.0}
    return pl.DataFrame({**columns, "profit": np.ones(rows), "end": [False] * rows, **cells})


def holes_at(values: Any, *rows: int) -> list[Any]:
    return [None if row in rows else value for row, value in enumerate(np.asarray(values).tolist())]


def read(frame: pl.DataFrame, **options: Any) -> Any:
    return tables.from_frame(frame, **{**ROLES, "episode": "batch", "time": "time", **options})


def column(log: Any, field: str) -> np.ndarray:
    return np.asarray(log.columns[field])


def found(log: Any) -> dict[str, Any]:
    return {finding["finding"]: finding for finding in log.findings}


@pytest.mark.parametrize("name", ["level", "flow", "valve", "profit", "end", "batch", "time"])
def test_a_row_that_misses_any_value_is_left_out_and_its_episode_cut(name: str):
    frame = log_of(8)
    log = read(frame.with_columns(pl.Series(name, holes_at(frame[name], 3), dtype=frame[name].dtype)), terminated="end")
    np.testing.assert_array_equal(column(log, "observations")[:, 0], [0, 1, 2, 4, 5, 6, 7])
    np.testing.assert_array_equal(column(log, "truncated"), np.arange(7) == 2)
    assert not column(log, "terminated").any()
    assert np.asarray(log.row_numbers).tolist() == [0, 1, 2, 4, 5, 6, 7]
    finding = found(log)["missing-cells"]
    assert finding["count"] == 1 and f"row 3; by column: {name} 1" in finding["message"]
    assert "time-gaps" not in found(log)  # the hole is told of once
    dataset = Dataset.from_log(log)
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 4, 5, 6])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 5, 6, 7])
    assert dataset.num_episodes == 2 and not dataset.terminated.any()


def test_the_same_without_ids_and_without_times():
    ends = [row in (3, 7) for row in range(8)]
    frame = log_of(8, end=ends, level=holes_at(range(8), 1, 5, 6))
    log = read(frame, episode=None, time=None, terminated="end")
    np.testing.assert_array_equal(column(log, "observations")[:, 0], [0, 2, 3, 4, 7])
    np.testing.assert_array_equal(column(log, "truncated"), [True, False, False, True, False])
    np.testing.assert_array_equal(column(log, "terminated"), [False, False, True, False, True])


def test_an_end_that_goes_with_its_row_leaves_a_cut_behind():
    frame = log_of(8, batch=[0] * 4 + [1] * 4, end=[row in (3, 7) for row in range(8)], level=holes_at(range(8), 3, 4))
    log = read(frame, terminated="end", time=None)
    np.testing.assert_array_equal(column(log, "truncated"), [False, False, True, False, False, False])
    np.testing.assert_array_equal(column(log, "terminated"), [False] * 5 + [True])
    assert found(log)["missing-cells"]["count"] == 2
    assert len(np.unique(column(log, "episode"))) == 2


def test_a_flag_nobody_knows_ends_nothing_and_joins_nothing():
    """Time begins anew after row 3, whose flag is missing: it may have been an end."""
    frame = log_of(8, time=[0, 1, 2, 3, 0, 1, 2, 3], end=holes_at([row in (3, 7) for row in range(8)], 3))
    log = read(frame, episode=None, terminated="end")
    np.testing.assert_array_equal(column(log, "observations")[:, 0], [0, 1, 2, 4, 5, 6, 7])
    np.testing.assert_array_equal(column(log, "truncated"), np.arange(7) == 2)


def test_gaps_beside_holes_are_told_apart():
    frame = log_of(9, time=[0, 1, 2, 3, 4, 9, 10, 11, 12], level=holes_at(range(9), 2))
    log = read(frame)
    assert found(log)["time-gaps"]["count"] == 1 and "after row 4" in found(log)["time-gaps"]["message"]
    np.testing.assert_array_equal(column(log, "truncated"), np.isin(column(log, "observations")[:, 0], [1, 4]))
    assert len(np.unique(column(log, "episode"))) == 3
    # The usual step is that of the episode, not that of the pieces it falls into.
    short = log_of(6, time=[0, 1, 2, 3, 4, 7], level=holes_at(range(6), 3))
    assert found(read(short))["time-gaps"]["count"] == 1


def test_sorting_comes_first_and_needs_its_keys():
    frame = log_of(6, level=holes_at(range(6), 2))[[5, 4, 3, 2, 1, 0]]
    log = read(frame, sort_by=["batch", "time"])
    np.testing.assert_array_equal(column(log, "observations")[:, 0], [0, 1, 3, 4, 5])
    assert np.asarray(log.infos["source_row"]).tolist() == [5, 4, 2, 1, 0]
    assert "row 3; by column" in found(log)["missing-cells"]["message"]
    with pytest.raises(DatasetError, match="column 'time' has no value in row 1; rows are sorted by it"):
        read(log_of(6, time=holes_at(range(6), 1)), sort_by=["batch", "time"])


def test_logged_successors_count_as_values():
    frame = log_of(5, after=holes_at([1.0, 2.0, 3.0, 4.0, 5.0], 2), after_flow=np.zeros(5))
    dataset = Dataset.from_log(read(frame, next_observations=["after", "after_flow"]))
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 4, 5])
    np.testing.assert_array_equal(dataset.truncated, [False, True, False, True])


def test_nothing_left_is_said():
    with pytest.raises(
        DatasetError, match="column 'level' has no value in 4 of 4 rows.*leave out columns that hold next"
    ):
        read(log_of(4, level=[None] * 4))


def test_the_message_that_refuses_names_the_way_out(tmp_path: Path):
    path = tmp_path / "log.csv"
    log_of(6, level=holes_at(range(6), 2)).write_csv(path)
    options = {**ROLES, "episode": "batch", "on_missing": "error"}
    with pytest.raises(
        DatasetError, match=r"'level' has no value .* in row 4; .*pass on_missing=\"break\" to leave such"
    ):
        tables.read(path, **options)
    assert len(tables.read(path, **{**options, "on_missing": "break"})) == 5


@st.composite
def recordings(draw: Any) -> list[dict[str, Any]]:
    """Rows of several episodes; about every fourth misses something."""
    rows, names = [], ("level", "flow", "valve", "profit", "end")
    for batch in range(draw(st.integers(1, 4))):
        steps = draw(st.integers(1, 8))
        ends = draw(st.booleans())
        for step in range(steps):
            row = {"batch": batch, "time": float(step), "level": 1_000.0 * batch + step, "flow": 0.0, "valve": 0.0}
            rows.append({**row, "profit": 1.0, "end": ends and step == steps - 1})
            if not draw(st.integers(0, 3)):
                rows[-1][draw(st.sampled_from(names))] = None
    return rows


@given(rows=recordings(), by_id=st.booleans(), timed=st.booleans(), lags=st.integers(0, 2))
def test_successors_are_the_next_moment_of_their_episode_or_none(
    rows: list[dict[str, Any]], by_id: bool, timed: bool, lags: int
):
    frame = pl.DataFrame(rows, schema_overrides={"level": pl.Float64, "end": pl.Boolean}, infer_schema_length=None)
    keys = {(row["batch"], row["time"]) for row in rows if None not in row.values()}
    usable = {}
    for row in rows:
        batch, time = row["batch"], row["time"]
        whole = all((batch, time - lag) in keys for lag in range(lags + 1))
        if whole and (row["end"] or (batch, time + 1) in keys):
            usable[row["level"]] = bool(row["end"])
    options = {
        "episode": "batch" if by_id else None,
        "time": "time" if timed else None,
        "terminated": "end",
        "lags": lags,
    }
    try:
        dataset = Dataset.from_log(read(frame, **options))
    except DatasetError as error:
        few = "no row is left|none has a successor|no episode is longer|no end of an episode|no row is marked"
        assert any(part in str(error) for part in few.split("|")) or (timed and not by_id), str(error)
        return
    if not by_id:  # without ids, an episode whose end is not marked runs on into the next
        level, after = dataset.observations[:, 0], dataset.next_observations[:, 0]
        same = np.floor(level / 1000) == np.floor(after / 1000)
        assert ((after == level + 1) | dataset.terminated | ~same).all()
        return
    level, after = dataset.observations[:, 0], dataset.next_observations[:, 0]
    assert dict(zip(level.tolist(), dataset.terminated.tolist(), strict=True)) == usable
    assert ((after == level + 1) | dataset.terminated).all()
    for lag in range(1, lags + 1):
        np.testing.assert_array_equal(dataset.observations[:, 3 * lag - 1], level - lag)
