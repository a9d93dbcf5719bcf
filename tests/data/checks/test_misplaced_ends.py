"""Resets that no flag announces, flags that stand a row late, and flags that stay on; in files and in memory."""

from typing import Any

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.data.checks import Report, check_log
from odaf.data.log import Log

ENDS = {"reset-unmarked", "ends-late", "flag-stays-on", "jump", "successor-differs"}


def walks(length: int, columns: int = 2, rows: int = 6_000) -> dict[str, Any]:
    """Walks of small steps, each from a start of its own."""
    rng = np.random.default_rng(0)
    starts = rng.uniform(-5, 5, (rows // length, 1, columns))
    steps = 0.02 * rng.normal(size=(rows // length, length, columns))
    observations = (starts + np.cumsum(steps, axis=1)).reshape(-1, columns).astype(np.float32)
    count = len(observations)
    return {
        "observations": observations,
        "actions": rng.uniform(-1, 1, (count, 1)).astype(np.float32),
        "rewards": rng.normal(size=count).astype(np.float32),
        "truncated": np.arange(count) % length == length - 1,
    }


def late(flags: np.ndarray) -> np.ndarray:
    moved = np.append(False, flags[:-1])
    moved[-1] = True
    return moved


def in_file(columns: dict[str, Any]) -> Report:
    return check_log(Log(columns, "log.csv", "csv", action_bounds=(-1.0, 1.0)))


def in_memory(columns: dict[str, Any]) -> Report:
    return Dataset.from_arrays(**columns, action_bounds=(-1.0, 1.0)).check()


def ends(report: Report) -> dict[str, Any]:
    return {finding.check: finding for finding in report.findings if finding.check in ENDS}


@pytest.mark.parametrize("judge", [in_file, in_memory])
@pytest.mark.parametrize("length", [10, 20, 50, 200])
def test_sound_walks_are_left_alone(length: int, judge: Any):
    assert ends(judge(walks(length))) == {}
    following = {**walks(length)}
    following["next_observations"] = following["observations"] + np.float32(0.01)
    following["next_observations"][:-1][~following["truncated"][:-1]] = following["observations"][1:][
        ~following["truncated"][:-1]
    ]
    assert ends(judge(following)) == {}


@pytest.mark.parametrize("judge", [in_file, in_memory])
@pytest.mark.parametrize("length", [20, 50, 200])
@pytest.mark.parametrize("columns", [1, 2, 6])
def test_resets_without_a_flag_are_seen_at_any_spacing(length: int, columns: int, judge: Any):
    """Every 20 rows they are 5 % of all steps, and lift every percentile above the 95th."""
    log = {**walks(length, columns), "episode": np.zeros(6_000, int)}
    del log["truncated"]
    finding = ends(judge(log))["reset-unmarked"]
    resets = 6_000 // length - 1
    assert 0.9 * resets <= finding.count <= resets
    assert finding.severity == "warning"
    assert all(row % length == 0 for row in finding.rows)


def test_one_end_lost_among_many():
    log = walks(100)
    log["truncated"][2_999] = False
    finding = ends(in_file(log))["reset-unmarked"]
    assert (finding.count, finding.rows) == (1, (3_000,))


@pytest.mark.parametrize("length", [20, 50, 200])
def test_flags_a_row_late(length: int):
    log = walks(length)
    log["truncated"] = late(log["truncated"])
    finding = ends(in_file(log))["ends-late"]
    assert "one row late" in finding.remedy
    assert finding.rows[0] == length  # the last row of the first episode is the first of the second
    finding = ends(in_memory(log))["ends-late"]
    assert finding.count > 0.8 * 6_000 / length
    assert "where" not in finding.message and "goes on in the next episode" in finding.message


@pytest.mark.parametrize("judge", [in_file, in_memory])
def test_flags_a_row_late_beside_successors_that_are_right(judge: Any):
    """The steps need not be small: the successors say it."""
    rng = np.random.default_rng(0)
    log = walks(50)
    log["observations"] = rng.normal(size=(6_000, 2)).astype(np.float32)
    log["next_observations"] = np.roll(log["observations"], -1, axis=0)
    log["next_observations"][49::50] = rng.normal(size=(120, 2))
    assert "ends-late" not in ends(judge(log))
    log["truncated"] = late(log["truncated"])
    finding = ends(judge(log))["ends-late"]
    assert (finding.field, finding.rows[:3]) == ("next_observations", (49, 99, 149))


@pytest.mark.parametrize("judge", [in_file, in_memory])
@pytest.mark.parametrize("length", [50, 200])
def test_next_observations_by_a_shift_over_the_ends(length: int, judge: Any):
    log = walks(length)
    log["next_observations"] = np.roll(log["observations"], -1, axis=0)
    finding = ends(judge(log))["ends-late"]
    assert "numpy.roll" in finding.remedy
    assert finding.rows[:2] == (length - 1, 2 * length - 1)


@pytest.mark.parametrize("judge", [in_file, in_memory])
@pytest.mark.parametrize("flag", ["terminated", "truncated"])
def test_flags_that_stay_on(flag: str, judge: Any):
    log = walks(100)
    del log["truncated"]
    log[flag] = np.arange(6_000) % 100 >= 96
    assert ends(judge(log))["flag-stays-on"].count >= 100
    log[flag] = np.arange(6_000) % 100 == 99
    assert "flag-stays-on" not in ends(judge(log))


def test_episodes_of_one_row_are_no_flag_that_stays_on():
    """Each begins somewhere else: a task of a single choice."""
    log = walks(20)
    place = np.arange(6_000) % 20
    log["observations"][place < 3] = np.random.default_rng(1).uniform(-5, 5, (900, 2))
    log["truncated"] = (place < 3) | (place == 19)
    assert "flag-stays-on" not in ends(in_file(log))


def test_a_recording_cut_every_hundred_rows_goes_on_all_the_same():
    """Nobody set the plant back: the next row of the next episode is a usual step away."""
    rng = np.random.default_rng(0)
    log = walks(100)
    log["observations"] = np.cumsum(0.02 * rng.normal(size=(6_000, 2)), axis=0).astype(np.float32)
    log["next_observations"] = np.roll(log["observations"], -1, axis=0)
    log["next_observations"][-1] = log["observations"][-1]
    assert ends(in_file(log)) == {}


@pytest.mark.parametrize("rows", [257, 1_000, 4_096])
def test_blocks_of_any_size_find_the_same(rows: int, monkeypatch: pytest.MonkeyPatch):
    logs = [walks(50), walks(50), walks(100)]
    logs[0]["truncated"] = late(logs[0]["truncated"])
    logs[1]["next_observations"] = np.roll(logs[1]["observations"], -1, axis=0)
    logs[2]["truncated"] = np.arange(6_000) % 100 >= 97
    whole = [in_file(log).findings for log in logs]
    monkeypatch.setattr("odaf.data.checks.run._block_rows", lambda facts: rows)
    assert [in_file(log).findings for log in logs] == whole
