"""Each way a log can be wrong, one file or log spoiled that way, and what the report says about it."""

import dataclasses
import functools
import hashlib
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np
import pytest

from data.checks import healthy
from odaf.data import Dataset
from odaf.data.checks import Report, check_file, check_log, known, signs
from odaf.data.checks.sample import Sample
from odaf.data.log import Log
from odaf.errors import DatasetError

CLEAN = healthy.columns()
ROWS = len(CLEAN["rewards"])
ENDS = np.flatnonzero(CLEAN["terminated"] | CLEAN["truncated"])
LARGEST = float(np.finfo(np.float32).max)
IDS_ONLY = ("terminated", "truncated", "time", "next_observations")


def changed(name: str, rows: Any, value: Any) -> dict[str, np.ndarray]:
    column = CLEAN[name].copy()
    column[rows] = value
    return {name: column}


def only(report: Report, check: str) -> Any:
    found = [finding for finding in report.findings if finding.check == check]
    assert len(found) == 1, f"{check}: {report}"
    return found[0]


def test_a_healthy_log_passes_in_silence():
    report = check_log(healthy.log())
    assert report.findings == ()
    assert report.usable
    assert report.exit_code(strict=True) == 0
    assert report.figures["transitions"] == ROWS
    assert report.figures["episodes"] == healthy.EPISODES


def one_hot() -> np.ndarray:
    return np.eye(3)[np.arange(ROWS) % 3]


def glued() -> dict[str, np.ndarray]:
    return changed("actions", (np.arange(0, ROWS, 20), 1), 1.0)


def apart() -> dict[str, np.ndarray]:
    ids = CLEAN["episode"].copy()
    ids[ids == 20] = 7
    return {"episode": ids}


def repeated_rows() -> dict[str, np.ndarray]:
    rows = np.arange(ROWS)
    rows[50:60] = 40  # ten copies of row 40
    return {name: values[rows] for name, values in CLEAN.items() if name in ("observations", "actions", "rewards")}


def repeated_episode() -> dict[str, np.ndarray]:
    first, second = np.flatnonzero(CLEAN["episode"] == 1), np.flatnonzero(CLEAN["episode"] == 4)
    rows = np.arange(ROWS)
    rows[second] = first
    return {name: values[rows] for name, values in CLEAN.items() if name in ("observations", "actions", "rewards")}


def teleported() -> np.ndarray:
    observations = CLEAN["observations"].copy()
    observations[150:199] += 500.0  # inside the second episode, until its end
    return observations


def cut_after(rows: Any, reward: float) -> dict[str, np.ndarray]:
    """The recording stopped after these rows too, and every row earned about `reward`."""
    truncated = CLEAN["terminated"] | CLEAN["truncated"]
    truncated[list(rows)] = True
    return {"truncated": truncated, "rewards": reward + 0.1 * CLEAN["rewards"]}


def gaps() -> np.ndarray:
    time = CLEAN["time"].copy()
    time[40:99] += 0.2  # row 40 comes five steps after row 39
    return time


TRUE_AT_END = np.isin(np.arange(ROWS), ENDS)

# what is spoiled: (columns that change, columns left out, settings) and (check, severity, field, count, first rows).
SPOILED: dict[str, tuple[Any, Any]] = {
    "missing field": (({}, ("rewards",)), ("field-missing", "error", "rewards", 1, ())),
    "length": (({"actions": CLEAN["actions"][:-1]},), ("length-mismatch", "error", "actions", 1, ())),
    "no rows": (({name: values[:0] for name, values in CLEAN.items()},), ("no-rows", "error", "", 0, ())),
    "rank": (({"observations": CLEAN["observations"][:, 0]},), ("wrong-shape", "error", "observations", 1, ())),
    "pictures": (({"observations": np.zeros((ROWS, 4, 4))},), ("wrong-shape", "error", "observations", 1, ())),
    "rewards of two": (({"rewards": CLEAN["actions"]},), ("wrong-shape", "error", "rewards", 1, ())),
    "width of successors": (
        ({"next_observations": CLEAN["actions"]},),
        ("wrong-width", "error", "next_observations", 1, ()),
    ),
    "names": (({}, (), {"observation_names": ("a", "b")}), ("wrong-width", "error", "observations", 1, ())),
    "NaN": ((changed("rewards", [3, 17], np.nan),), ("not-finite", "error", "rewards", 2, (3, 17))),
    "infinity": (
        (changed("observations", ([5, 5, 9], [0, 1, 2]), np.inf),),
        ("not-finite", "error", "observations", 2, (5, 9)),
    ),
    "too large": ((changed("rewards", 8, 1e300),), ("too-large", "error", "rewards", 1, (8,))),
    "outside": ((changed("actions", ([4, 6], 0), 1.07),), ("actions-outside-bounds", "error", "actions", 2, (4, 6))),
    "a hair outside": (
        (changed("actions", (4, 0), 1.0005),),
        ("actions-rounded-outside", "warning", "actions", 1, (4,)),
    ),
    "no bounds": (({}, (), {"action_bounds": None}), ("bounds-unknown", "note", "actions", 2, ())),
    "bounds upside down": (({}, (), {"action_bounds": (1.0, -1.0)}), ("action-bounds", "error", "actions", 1, ())),
    "on the bounds": ((glued(),), ("actions-on-bounds", "warning", "actions", 150, (0, 20, 40, 60, 80))),
    "on a bound once": ((changed("actions", (9, 0), -1.0),), ("actions-on-bounds", "note", "actions", 1, (9,))),
    "bounds of a percentage": (
        ({}, (), {"action_bounds": (-100.0, 100.0)}),
        ("bounds-too-wide", "warning", "actions", 2, ()),
    ),
    "no true bounds": (
        ({}, (), {"action_bounds": (-LARGEST, LARGEST)}),
        ("bounds-too-wide", "warning", "actions", 2, ()),
    ),
    "one bound too wide": (
        ({}, (), {"action_bounds": ((-1.0, -1e3), (1.0, 1e3))}),
        ("bounds-too-wide", "warning", "actions", 1, ()),
    ),
    "choices": (
        ({"actions": np.arange(ROWS)[:, None] % 4}, (), {"action_bounds": None}),
        ("actions-discrete", "error", "actions", ROWS, ()),
    ),
    "one-hot choices": (({"actions": one_hot()},), ("actions-discrete", "error", "actions", ROWS, ())),
    "a switch": (
        ({"actions": np.where(CLEAN["actions"] > 0, 1.0, -1.0)},),
        ("actions-few-values", "warning", "actions", ROWS, ()),
    ),
    "no end at all": (({}, ("terminated", "truncated", "episode")), ("no-episode-end", "error", "", ROWS, ())),
    "no end marked": (
        ({"terminated": np.zeros(ROWS, bool), "truncated": np.zeros(ROWS, bool)}, ("episode",)),
        ("no-episode-end", "error", "", ROWS, ()),
    ),
    "both ends": ((changed("truncated", ENDS[0], True),), ("both-ends", "warning", "terminated", 1, (int(ENDS[0]),))),
    "all terminal": (
        ({"terminated": np.ones(ROWS, bool)}, ("truncated", "episode", "time", "next_observations")),
        ("terminals-are-timeouts", "warning", "terminated", ROWS, ()),
    ),
    "terminals equal timeouts": (
        ({"terminated": TRUE_AT_END, "truncated": TRUE_AT_END},),
        ("terminals-are-timeouts", "warning", "terminated", healthy.EPISODES, ()),
    ),
    "a clock as terminals": (
        (
            {"terminated": np.arange(ROWS) % 100 == 99, "time": np.arange(ROWS)},
            ("truncated", "episode", "next_observations"),
        ),
        ("terminals-are-timeouts", "warning", "terminated", ROWS // 100, ()),
    ),
    "unfinished, flags": (
        (changed("truncated", ENDS[-1], False), ("episode",)),
        ("unfinished-episode", "warning", "truncated", 100, (int(ENDS[-2]) + 1,)),
    ),
    "unfinished, ids": (
        (changed("terminated", ENDS[[0, 3]], False),),
        ("unfinished-episode", "warning", "truncated", 2, (int(ENDS[0]), int(ENDS[3]))),
    ),
    "unfinished, last id": (
        (changed("truncated", ENDS[-1], False),),
        ("unfinished-episode", "warning", "truncated", 1, (int(ENDS[-1]),)),
    ),
    "only ids": (({}, ("terminated", "truncated")), ("no-terminals", "note", "terminated", healthy.EPISODES, ())),
    "ids apart": ((apart(),), ("episode-ids-apart", "error", "episode", 1, (int(ENDS[19]) + 1,))),
    "texts as ids, apart": (
        ({"episode": np.char.add("batch ", apart()["episode"].astype(str))},),
        ("episode-ids-apart", "error", "episode", 1, (int(ENDS[19]) + 1,)),
    ),
    "end inside": ((changed("terminated", 12, True),), ("flag-inside-episode", "error", "episode", 1, (12,))),
    "odd flags": (
        ({"terminated": CLEAN["terminated"] * 2.0},),
        ("flag-values", "error", "terminated", 10, tuple(ENDS[::3][:5].tolist())),
    ),
    "gap in time": (({"time": gaps()},), ("time-gaps", "warning", "time", 1, (40,))),
    "time twice": ((changed("time", 30, CLEAN["time"][29]),), ("time-repeats", "error", "time", 1, (30,))),
    "time backwards": ((changed("time", 30, 0.0),), ("time-backwards", "error", "time", 1, (30,))),
    "jump": (
        ({"observations": teleported()}, ("next_observations",)),
        ("jump", "warning", "observations", 1, (150,)),
    ),
    "another successor": (
        (changed("next_observations", (70, 0), 12.0),),
        ("successor-differs", "warning", "next_observations", 1, (70,)),
    ),
    "constant observation": (
        (changed("observations", (slice(None), 1), 4.0), ("next_observations",)),
        ("constant-dimension", "warning", "observations", 1, ()),
    ),
    "constant action": (
        (changed("actions", (slice(None), 1), 0.25),),
        ("constant-dimension", "warning", "actions", 1, ()),
    ),
    "constant action of unknown range": (
        (changed("actions", (slice(None), 1), 0.25), (), {"action_bounds": None}),
        ("constant-dimension", "error", "actions", 1, ()),
    ),
    "scales": (
        ({"observations": CLEAN["observations"] * [1.0, 1e5, 1.0]}, ("next_observations",)),
        ("scales-differ", "note", "observations", 3, ()),
    ),
    "a clock among observations": (
        ({"observations": CLEAN["observations"] + [0.0, 1.7e9, 0.0]}, ("next_observations",)),
        ("far-from-zero", "error", "observations", 1, ()),
    ),
    "a clock among observations, already rounded": (
        ({"observations": (CLEAN["observations"] + [0.0, 1e6, 0.0]).astype(np.float32)}, ("next_observations",)),
        ("far-from-zero", "warning", "observations", 1, ()),
    ),
    "transitions twice": (
        (repeated_rows(), ("next_observations",)),
        ("duplicate-transitions", "warning", "", 10, (50, 51, 52, 53, 54)),
    ),
    "episode twice": (
        (repeated_episode(), ("next_observations",)),
        ("duplicate-episodes", "warning", "", 1, (int(ENDS[3]) + 1,)),
    ),
    "constant reward": (({"rewards": np.full(ROWS, -1.0)},), ("reward-constant", "warning", "rewards", ROWS, ())),
    "no reward": (({"rewards": np.zeros((ROWS, 1))},), ("reward-constant", "warning", "rewards", ROWS, ())),
    "large rewards": (({"rewards": CLEAN["rewards"] * 1e6},), ("reward-scale", "warning", "rewards", ROWS, ())),
    "small rewards": (({"rewards": CLEAN["rewards"] * 1e-6},), ("reward-scale", "warning", "rewards", ROWS, ())),
    "rewards that vary little": (
        ({"rewards": CLEAN["rewards"] * 1e-3 + 100},),
        ("reward-scale", "warning", "rewards", ROWS, ()),
    ),
    "the best return is a fragment's": (
        (cut_after([int(ENDS[0]) + 10], -1.0), ("episode",)),
        ("returns-by-length", "warning", "rewards", 1, (int(ENDS[0]) + 1,)),
    ),
    "returns that follow lengths": (
        ({"terminated": np.zeros(ROWS, bool), **cut_after(range(19, ROWS, 100), 1.0)}, ("episode", "time")),
        ("returns-by-length", "note", "rewards", 60, (0, 20, 99, 120, 199)),
    ),
    "texts": (
        ({"actions": changed("actions", 0, 0)["actions"].astype(str).astype(object)},),
        ("not-numbers", "error", "actions", ROWS, ()),
    ),
    "a text among numbers": (
        ({"rewards": np.array(["0.5"] * 7 + ["err"] + ["1"] * (ROWS - 8), dtype=object)},),
        ("not-numbers", "error", "rewards", 1, (7,)),
    ),
    "few rows": (
        ({name: values[: ENDS[7] + 1] for name, values in CLEAN.items()},),
        ("too-few", "warning", "", int(ENDS[7]) + 1, ()),
    ),
}


def spoiled(name: str) -> Log:
    given, _ = SPOILED[name]
    settings: dict[str, Any] = given[2] if len(given) > 2 else {}
    changes, drop = given[0], given[1] if len(given) > 1 else ()
    return healthy.log(changes, drop, **settings)


@functools.cache
def report_of(name: str) -> Report:
    return check_log(spoiled(name))


@pytest.fixture(autouse=True, scope="module")
def signs_of_a_sample_are_found_once() -> Iterator[None]:
    """Most of a check's time goes into them, and they depend on the sample alone, which many of these logs share."""
    met: dict[bytes, signs.Signs] = {}
    find = signs.find

    def found(sample: Sample) -> signs.Signs:
        digest = hashlib.sha256()
        for field in dataclasses.fields(sample):
            value = getattr(sample, field.name)
            digest.update(repr((field.name, getattr(value, "dtype", None), getattr(value, "shape", value))).encode())
            digest.update(b"" if value is None else np.ascontiguousarray(value).tobytes())
        key = digest.digest()
        if key not in met:
            met[key] = find(sample)
        return met[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(signs, "find", found)
        yield


@pytest.mark.parametrize("name", SPOILED)
def test_the_report_says_what_is_wrong_and_where(name: str):
    _, (check, severity, field, count, rows) = SPOILED[name]
    report = report_of(name)
    finding = only(report, check)
    assert (finding.severity, finding.field, finding.count, finding.rows) == (severity, field, count, rows)
    assert finding.remedy
    assert report.exit_code() == (2 if severity == "error" else report.exit_code())
    assert report.exit_code(strict=True) == {"error": 2, "warning": 1, "note": 0}[severity] or len(report.findings) > 1


def test_a_zero_is_said_without_a_sign():
    report = check_log(healthy.log({"actions": np.where(CLEAN["actions"] > 0, 1.0, -0.0)}))
    assert " 0 to 1" in only(report, "actions-few-values").message


@pytest.mark.parametrize("name", SPOILED)
def test_blocks_of_any_size_give_the_same_report(name: str, monkeypatch: pytest.MonkeyPatch):
    """Whatever a check carries from one block to the next is right at every border."""
    whole = report_of(name)
    for rows in (257, 1_000):
        monkeypatch.setattr("odaf.data.checks.run._block_rows", lambda facts, rows=rows: rows)
        pieces = check_log(spoiled(name))
        left = [dataclasses.replace(finding, message="") for finding in whole.findings]
        assert [dataclasses.replace(finding, message="") for finding in pieces.findings] == left
        assert str(pieces.findings) == str(whole.findings) or name in ("jump",)


# These are judgements about the task; the rows themselves can be held.
HELD_ALL_THE_SAME = {"choices", "one-hot choices", "time twice", "time backwards"}


@pytest.mark.parametrize("name", SPOILED)
def test_what_has_no_error_becomes_a_dataset_and_what_has_one_does_not(name: str):
    log = spoiled(name)
    if report_of(name).usable:
        Dataset.from_log(log)
    elif name not in HELD_ALL_THE_SAME:
        with pytest.raises((DatasetError, TypeError)):
            Dataset.from_log(log)


def test_rows_are_numbered_as_in_the_source():
    spoiled = changed("rewards", [3, 17], np.nan)
    report = check_log(healthy.log(spoiled, row_numbers=range(2, 2 + healthy.ROWS)))
    assert only(report, "not-finite").rows == (5, 19)
    moved = np.arange(healthy.ROWS)[::-1]
    assert only(check_log(healthy.log(spoiled, row_numbers=moved)), "not-finite").rows == (moved[3], moved[17])


def test_width_of_the_environment_that_the_log_names():
    report = check_log(healthy.log(provenance={"environment": {"name": "gymnasium", "id": "Hopper-v4"}}))
    assert {finding.field for finding in report.findings if finding.check == "wrong-width"} == {
        "observations",
        "actions",
    }
    assert "Hopper-v4 needs 11" in str(report.findings[0])


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_of_observations_do_not_matter(unit: float):
    """Amperes or strain: the normaliser divides by each column's own spread."""
    assert (
        check_log(healthy.log({"observations": CLEAN["observations"] * unit}, ("next_observations",))).of("warning")
        == ()
    )


def test_bounds_that_are_no_bounds_are_named_in_memory_too():
    columns: dict[str, Any] = {name: CLEAN[name] for name in ("observations", "actions", "rewards", "episode")}
    report = Dataset.from_arrays(**columns, action_bounds=(-LARGEST, LARGEST)).check()
    assert "--action-bounds" in only(report, "bounds-too-wide").remedy


def test_width_asked_for():
    assert check_log(healthy.log(), widths=(3, 2)).usable
    assert "needs 4" in only(check_log(healthy.log(), widths=(4, 2)), "wrong-width").message


def test_antmaze_without_its_position():
    report = check_log(healthy.log({"observations": np.zeros((ROWS, 27))}, ("next_observations",)), widths=(29, 2))
    assert "achieved goal" in only(report, "wrong-width").remedy


def test_what_the_reader_decided_is_in_the_report():
    note = {"finding": "rows-sorted", "count": 3, "message": "three rows stood out of order"}
    finding = only(check_log(healthy.log(findings=(note,))), "rows-sorted")
    assert (finding.severity, finding.count, finding.message) == ("note", 3, note["message"])


# ---- files ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def own(tmp_path):
    Dataset.from_log(healthy.log(drop=("time",))).save(tmp_path / "log.h5")
    return tmp_path / "log.h5"


def test_a_file_of_our_own_is_checked_where_it_lies(own):
    report = check_file(own)
    assert report.usable
    assert (report.format, report.figures["transitions"]) == ("odaf", ROWS)
    assert report.to_dict() == {**Dataset.load(own).check().to_dict(), "source": str(own)}


def test_a_file_cut_short(own):
    content = own.read_bytes()
    own.write_bytes(content[:-5_000])
    finding = only(check_file(own), "unreadable")
    assert finding.severity == "error"
    assert "cut short" in finding.message
    assert "copy it again" in finding.remedy


def test_a_file_of_no_layout(tmp_path):
    (tmp_path / "log.h5").write_bytes(b"nothing that anyone would call data")
    assert check_file(tmp_path / "log.h5").exit_code() == 2
    assert check_file(tmp_path / "none.h5").exit_code() == 2


def test_a_file_of_our_own_that_was_edited(own):
    with h5py.File(own, "r+") as file:
        file["rewards"][3] += 1.0  # type: ignore[index,operator]
    assert "checksum" in only(check_file(own), "unreadable").message


def write_d4rl(path, **changes):
    with h5py.File(path, "w") as file:
        for name in ("observations", "actions", "rewards"):
            file[name] = CLEAN[name].astype(np.float32)
        file["terminals"], file["timeouts"] = CLEAN["terminated"], CLEAN["truncated"]
        for name, values in changes.items():
            del file[name]
            if values is not None:
                file[name] = values


def test_a_file_in_the_d4rl_layout(tmp_path):
    path = tmp_path / "tank.hdf5"
    write_d4rl(path, rewards=changed("rewards", 5, np.nan)["rewards"])
    report = check_file(path)
    assert only(report, "not-finite").rows == (5,)
    assert report.format == "d4rl"


def test_a_d4rl_file_of_version_0(tmp_path):
    write_d4rl(tmp_path / "tank.hdf5", timeouts=None)
    assert only(check_file(tmp_path / "tank.hdf5"), "unreadable").severity == "error"
    report = check_file(tmp_path / "tank.hdf5", max_episode_steps=100)
    assert "version 0" in only(report, "other-version").message


def test_minari_is_not_d4rl():
    log = healthy.log(format="minari", source="mujoco/hopper/expert-v0", drop=("time",))
    assert "version 5" in only(check_log(log), "other-version").message
    assert check_log(healthy.log(format="minari", source="mujoco", drop=("time",))).exit_code(strict=True) == 1


def test_a_published_file_that_is_not_the_published_one(tmp_path):
    path = tmp_path / "hopper_medium_replay-v2.hdf5"
    write_d4rl(path)
    assert "75,854,457" in only(check_file(path), "known-file-differs").message


def test_a_published_file_by_its_digest(tmp_path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "tank-expert-v2.hdf5"
    write_d4rl(path)
    size, digest = path.stat().st_size, known.file_sha256(path)
    monkeypatch.setattr(known, "PUBLISHED", (known.Published("tank-expert-v2", size, digest),))
    assert only(check_file(path), "known-file").severity == "note"
    monkeypatch.setattr(known, "PUBLISHED", (known.Published("tank-expert-v2", size, "0" * 64),))
    assert "SHA-256" in only(check_file(path), "known-file-differs").message


def test_the_table_of_published_files_is_that_of_the_literature():
    """Sizes and digests of the files as their authors' host serves them."""
    assert {entry.name: entry.sha256[:8] for entry in known.PUBLISHED} == {
        "hopper-medium-replay-v2": "e121c5f7",
        "walker2d-medium-replay-v2": "e75de96a",
    }
