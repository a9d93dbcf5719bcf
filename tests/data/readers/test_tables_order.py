"""Time order, gaps and successors of tables."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odaf.data import Dataset
from odaf.data.checks import check_log
from odaf.data.readers import tables
from odaf.errors import DatasetError

ROLES = {"observations": ["level"], "actions": ["valve"], "reward": "profit", "action_bounds": (-1.0, 1.0)}


def log_of(batch, time, **more):
    """Rows whose level counts them."""
    rows = len(time)
    columns = {"level": np.arange(rows) * 1.0, "valve": np.zeros(rows), "profit": np.ones(rows), "time": time}
    return pl.DataFrame({**columns, **({} if batch is None else {"batch": batch}), **more})


def column(log, field) -> np.ndarray:
    return np.asarray(log.columns[field])


def read(frame, **options):
    return tables.from_frame(frame, **{**ROLES, "episode": "batch", "time": "time", **options})


def found(log):
    return {finding["finding"]: finding for finding in log.findings}


def test_an_episode_ends_where_rows_are_missing():
    frame = log_of([3] * 6 + [4] * 3, [0.0, 0.1, 0.2, 0.5, 0.6, 0.7, 9.0, 9.1, 9.2])
    log = read(frame)
    np.testing.assert_array_equal(column(log, "truncated"), np.arange(9) == 2)
    np.testing.assert_array_equal(column(log, "episode"), [0, 0, 0, 1, 1, 1, 2, 2, 2])
    gap = found(log)["time-gaps"]
    assert gap["count"] == 1 and "after row 2; there the next row is 0.3 later, usual is 0.1" in gap["message"]
    dataset = Dataset.from_log(log)
    # Rows 2, 5 and 8 have no successor: 3 is not what follows 2.
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 3, 4, 6, 7])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 4, 5, 7, 8])
    assert dataset.num_episodes == 3
    with pytest.raises(DatasetError, match=r"column 'time': rows are missing after row 2.*on_gap=\"break\""):
        read(frame, on_gap="error")


def test_without_gaps_ids_stay_as_they_are_and_nothing_is_reported():
    log = read(log_of([3, 3, 3, 7, 7], [0.0, 1.0, 2.05, 5.0, 6.0]), on_gap="error")
    assert column(log, "episode").tolist() == [3, 3, 3, 7, 7] and log.findings == ()
    assert "truncated" not in log.columns and log.provenance["time_step"] == pytest.approx(1.0, abs=0.1)


def test_the_usual_step_can_be_given():
    frame = log_of([0] * 4, [0.0, 2.0, 4.0, 6.0])
    assert read(frame).findings == ()
    assert found(read(frame, time_step=1.0))["time-gaps"]["count"] == 3


def test_gaps_without_ids_and_beside_other_ends():
    ends = np.arange(8) == 4
    log = read(log_of(None, [0, 1, 2, 5, 6, 0, 1, 9], end=ends), episode=None, terminated="end", time_step=1.0)
    assert "episode" not in log.columns
    np.testing.assert_array_equal(column(log, "truncated"), np.isin(np.arange(8), [2, 6]))
    dataset = Dataset.from_log(log)
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(dataset.terminated, [False, False, False, True, False])
    assert dataset.num_episodes == 3
    # Flags that mark nothing do not tell episodes apart, even where gaps would.
    with pytest.raises(DatasetError, match=r"no row is marked as the end of an episode"):
        read(log_of(None, [0, 1, 2, 5, 6], end=[False] * 5), episode=None, terminated="end")


def test_a_task_that_ended_before_a_gap_was_not_cut():
    log = read(log_of([0] * 4, [0, 1, 9, 10], end=[False, True, False, False]), terminated="end", time_step=1.0)
    assert not column(log, "truncated").any()
    np.testing.assert_array_equal(Dataset.from_log(log).terminated, [False, True, False])


def test_a_constant_makes_one_episode():
    log = read(log_of(None, [0, 1, 2, 3]), episode=0)
    assert column(log, "episode").tolist() == [0, 0, 0, 0] and Dataset.from_log(log).num_episodes == 1


def test_logged_successors_survive_a_gap():
    frame = log_of([0] * 5, [0, 1, 2, 9, 10], after=[1.0, 2.0, 2.5, 4.0, 5.0])
    dataset = Dataset.from_log(read(frame, next_observations=["after"]))
    assert len(dataset) == 5 and dataset.next_observations[2, 0] == 2.5 and dataset.truncated[2]


def test_uneven_sampling_is_reported():
    time = [0, 1, 2, 3, 0, 1, 2, 3, 0, 2, 4, 6]
    log = read(log_of(np.repeat([0, 1, 2], 4), time))
    assert list(found(log)) == ["uneven-sampling"] and "from 1 to 2" in found(log)["uneven-sampling"]["message"]


@pytest.mark.parametrize(
    ("batch", "time", "message"),
    [
        (
            [0, 0, 1, 1, 0],
            [0, 1, 0, 1, 2],
            r"'batch': id 0 comes back after other ids: it begins in rows 0, 4 \(",
        ),
        (
            [0, 0, 0],
            [0, 2, 1],
            r"'time': time goes back .* in row 2 \(2, then 1\); pass sort_by=\['batch', 'time'",
        ),
        ([0, 0, 0], [0, 1, 1], r"column 'time': time stands still inside an episode in row 2 \(1, then 1\)"),
        (["a", "b", "a"], [0, 1, 2], r"id a comes back after other ids: it begins in rows 0, 2"),
    ],
)
def test_rows_out_of_order_name_rows_and_remedy(batch, time, message, tmp_path):
    frame = log_of(batch, time)
    with pytest.raises(DatasetError, match=message):
        read(frame)
    frame.write_csv(tmp_path / "log.csv")  # there the same rows are called two more
    with pytest.raises(DatasetError, match=r"rows? (2|4)\b"):
        tables.read(tmp_path / "log.csv", **ROLES, episode="batch", time="time")


def test_sorting_repairs_the_order_and_says_so():
    frame = log_of([1, 0, 1, 0, 1], [1, 0, 2, 1, 0])
    with pytest.raises(DatasetError, match=r"comes back after other ids.*pass sort_by=\['batch', 'time'\]"):
        read(frame)
    log = read(frame, sort_by=["batch", "time"])
    assert column(log, "observations")[:, 0].tolist() == [1, 3, 4, 0, 2]
    assert np.asarray(log.infos["source_row"]).tolist() == [1, 3, 4, 0, 2]
    assert found(log)["rows-sorted"]["count"] == 5
    assert Dataset.from_log(log).num_episodes == 2
    ordered = frame.sort("batch", "time")
    assert read(ordered, sort_by=["batch", "time"]).findings == ()
    # Rows logged twice stay a mistake, and are named as in the source.
    twice = log_of([0, 0, 0, 0], [3, 1, 2, 1])
    with pytest.raises(DatasetError, match=r"stands still .* in row 3 \(1, then 1\); remove rows that"):
        read(twice, sort_by=["batch", "time"])


def test_sorting_by_a_column_that_has_no_other_meaning(tmp_path):
    frame = log_of([0, 0, 0], [0, 0, 0]).with_columns(pl.Series("frame", [2, 10, 1]))
    frame.write_csv(tmp_path / "log.csv")
    log = tables.read(tmp_path / "log.csv", **ROLES, episode="batch", sort_by=["frame"])
    assert column(log, "observations")[:, 0].tolist() == [2, 0, 1]
    assert np.asarray(log.infos["source_row"]).tolist() == [4, 2, 3]


@st.composite
def histories(draw):
    """Episodes of a counter: (batch, time, level, terminated) a row, with gaps in time, in a shuffled order or not."""
    rows = []
    for batch in range(draw(st.integers(1, 5))):
        clock, steps = 0, draw(st.integers(1, 8))
        ends = draw(st.booleans())
        for step in range(steps):
            rows.append((batch, clock, 1_000 * batch + clock, ends and step == steps - 1))
            clock += 1 if draw(st.integers(0, 5)) else draw(st.integers(2, 5))
    shuffled = draw(st.booleans())
    return (draw(st.permutations(rows)) if shuffled else rows), shuffled


@pytest.mark.parametrize("form", ["frame", "csv", "parquet"])
@given(history=histories())
def test_successors_are_the_recorded_ones_and_never_of_another_episode(form, tmp_path_factory, history):
    rows, shuffled = history
    names = ("batch", "time", "level", "end")
    frame = pl.DataFrame({name: [row[at] for row in rows] for at, name in enumerate(names)})
    frame = frame.with_columns(valve=pl.lit(0.0), profit=pl.col("level") + 0.5)
    options = {**ROLES, "episode": "batch", "time": "time", "terminated": "end", "time_step": 1.0}
    options["sort_by"] = ["batch", "time"] if shuffled else []
    if form == "frame":
        log = tables.from_frame(frame, **options)
    else:
        path = tmp_path_factory.getbasetemp() / f"history.{form}"
        (frame.write_csv if form == "csv" else frame.write_parquet)(path)
        log = tables.read(path, **options)
    moments = {(row[0], row[1]) for row in rows}
    ended = {row[2] for row in rows if row[3]}
    # A row can be used where the task ended, or where the very next moment of its episode was recorded.
    usable = sorted(row[2] for row in rows if row[3] or (row[0], row[1] + 1) in moments)
    if not usable:
        with pytest.raises(DatasetError, match="none has a successor"):
            Dataset.from_log(log)
        return
    dataset = Dataset.from_log(log)
    level, after = dataset.observations[:, 0], dataset.next_observations[:, 0]
    assert sorted(level.tolist()) == usable
    assert set(level[dataset.terminated].tolist()) == ended
    np.testing.assert_array_equal(after[~dataset.terminated], level[~dataset.terminated] + 1)
    np.testing.assert_array_equal(dataset.rewards, level + 0.5)
    inside = ~(dataset.terminated | dataset.truncated)
    np.testing.assert_array_equal(level[1:][inside[:-1]], after[:-1][inside[:-1]])


def test_rows_of_a_sorted_file_are_named_by_their_place_in_it(tmp_path):
    """The log of two batches is written backwards: its last rows, 5 and 2, have no successor."""
    rows = [(1, 2.0, 12), (1, 1.0, 11), (1, 0.0, 10), (0, 2.0, 2), (0, 1.0, 1), (0, 0.0, 0)]
    lines = ["batch,time,level,valve,profit", *(f"{batch},{time},{level},0.5,1" for batch, time, level in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    options = {**ROLES, "episode": "batch", "time": "time", "sort_by": ["batch", "time"]}
    log = tables.read(tmp_path / "log.csv", **options)
    findings = {entry["finding"]: entry["message"] for entry in Dataset.from_log(log).provenance["findings"]}
    assert findings["dropped-without-successor"].endswith("2 of 6 rows, the first of them 5, 2")
    assert findings["unfinished-episodes"].endswith("2 of 6 rows, the first of them 5, 2")
    spoiled = (tmp_path / "log.csv").read_text().replace("1,1.0,11,0.5,1", "1,1.0,11,7.5,1")  # in row 3
    (tmp_path / "log.csv").write_text(spoiled)
    log = tables.read(tmp_path / "log.csv", **options)
    (finding,) = (entry for entry in check_log(log).findings if entry.check == "actions-outside-bounds")
    assert finding.rows == (3,)
    with pytest.raises(DatasetError, match="leaves its bounds in row 3: column 0 is 7.5 in row 3"):
        Dataset.from_log(log)
