"""Our file format: round trips, atomic writes, and a message for every way a file can be wrong."""

import errno
import json
import os
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from odaf.data import Dataset, convert, fingerprint, storage
from odaf.data.writing import write_atomically
from odaf.errors import DatasetError


def small(**changes):
    rng = np.random.default_rng(0)
    columns = {
        "observations": rng.normal(size=(12, 3)),
        "actions": rng.uniform(-1, 1, (12, 2)),
        "rewards": rng.normal(size=12),
        "next_observations": rng.normal(size=(12, 3)),
        "terminated": np.arange(12) == 5,
        "truncated": np.arange(12) == 11,
        "action_bounds": (-1.0, 1.0),
        "observation_names": ("level", "flow", "temp °C"),
        "provenance": {"plant": "Süd", "nested": {"list": [1, 2.5, None, True]}},
    }
    return Dataset.from_arrays(**{**columns, **changes})


@pytest.fixture
def path(tmp_path):
    small().save(tmp_path / "log.h5")
    return tmp_path / "log.h5"


def assert_equal(left, right):
    for name in ("observations", "actions", "rewards", "next_observations", "terminated", "truncated"):
        assert getattr(left, name).dtype == getattr(right, name).dtype
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    for name in ("episode_starts", "action_low", "action_high"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    assert left.observation_names == right.observation_names and left.action_names == right.action_names
    assert left.provenance == right.provenance


def test_everything_comes_back(path):
    assert_equal(Dataset.load(path), small())
    assert Dataset.load(path).fingerprint() == small().fingerprint()
    with h5py.File(path) as file:
        assert file.attrs["sha256"] == small().file_fingerprint()


numbers = st.floats(-(2.0**99), 2.0**99, width=32)


@settings(max_examples=40)
@given(st.data(), st.integers(1, 9), st.integers(1, 4), st.integers(1, 3), st.text(max_size=5))
def test_any_dataset_comes_back_bit_for_bit(tmp_path_factory, data, rows, obs_dim, act_dim, note):
    draw = data.draw
    ends = draw(hnp.arrays(np.int64, rows, elements=st.integers(0, 2)))
    ends[-1] = max(ends[-1], 1)
    dataset = Dataset.from_arrays(
        draw(hnp.arrays(np.float32, (rows, obs_dim), elements=numbers)),
        draw(hnp.arrays(np.float32, (rows, act_dim), elements=st.floats(-2, 5, width=32))),
        draw(hnp.arrays(np.float32, rows, elements=numbers)),
        draw(hnp.arrays(np.float32, (rows, obs_dim), elements=numbers)),
        terminated=ends == 1,
        truncated=ends == 2,
        action_bounds=(-2.0, 5.0),
        provenance={"note": note},
    )
    path = tmp_path_factory.mktemp("round") / "trip.h5"
    dataset.save(path)
    assert_equal(Dataset.load(path), dataset)
    assert Dataset.load(path).file_fingerprint() == dataset.file_fingerprint()


CHANGES = {
    "rewards": {"rewards": np.zeros(12)},
    "ends": {"terminated": np.arange(12) == 6},
    "bounds": {"action_bounds": (-1.0, 1.5)},
    "names": {"action_names": ("a", "b")},
}
NOTES = {
    "provenance": {"provenance": {"plant": "Nord"}},
    "units": {"action_units": ("V", "A")},
    "infos": {"infos": {"temperature": np.arange(12)}},
}


@pytest.mark.parametrize("name", CHANGES)
def test_fingerprint_tells_any_difference(name):
    changed = small(**CHANGES[name])
    assert changed.fingerprint() != small().fingerprint()
    assert changed.file_fingerprint() != small().file_fingerprint()


@pytest.mark.parametrize("name", NOTES)
def test_what_no_learner_sees_changes_the_print_of_the_file_alone(name):
    noted = small(**NOTES[name])
    assert noted.fingerprint() == small().fingerprint()
    assert noted.file_fingerprint() != small().file_fingerprint()


def test_fingerprint_is_that_of_the_documented_bytes():
    """Worked here from the format's description: name, type, shape, bytes of each array, then the metadata."""
    import hashlib

    dataset = small()
    digest = hashlib.sha256()
    for name, kind in zip(
        [
            "observations",
            "actions",
            "rewards",
            "next_observations",
            "terminated",
            "truncated",
            "episode_starts",
            "action_low",
            "action_high",
        ],
        ["<f4"] * 4 + ["|b1"] * 2 + ["<i8"] + ["<f4"] * 2,
        strict=True,
    ):
        array = getattr(dataset, name)
        digest.update(f"{name} {kind} {array.shape}\n".encode() + array.tobytes())
    content = {name: list(getattr(dataset, name)) for name in ("observation_names", "action_names")}
    rows = digest.copy()
    text = json.dumps({**content, "mixture": None}, sort_keys=True, separators=(",", ":")).encode()
    rows.update(b"rows %d\n" % len(text) + text)
    assert dataset.fingerprint() == rows.hexdigest()
    content |= {"observation_units": [""] * 3, "action_units": [""] * 2}
    text = json.dumps({**content, "provenance": dataset.provenance}, sort_keys=True, separators=(",", ":")).encode()
    digest.update(b"metadata %d\n" % len(text) + text)
    assert dataset.file_fingerprint() == digest.hexdigest()


def test_saving_replaces_the_old_file_only_when_complete(path, monkeypatch):
    def fail(*_, **__):
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        with pytest.raises(DatasetError, match=r"log.h5: cannot be written \(disk full\)"):
            small(rewards=np.zeros(12)).save(path)
    assert_equal(Dataset.load(path), small())
    assert [entry.name for entry in path.parent.iterdir()] == ["log.h5"]
    small(rewards=np.zeros(12)).save(path)
    assert not Dataset.load(path).rewards.any()


def test_a_full_disk_names_the_file_without_room(tmp_path):
    def write(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="log.bin") as caught:
        write_atomically(tmp_path / "log.bin", write)
    assert caught.value.filename == str(tmp_path / "log.bin") and not list(tmp_path.iterdir())


def test_saving_into_a_missing_folder(tmp_path):
    with pytest.raises(DatasetError, match=r"nowhere/log.h5: cannot be written .*; choose a folder that exists"):
        small().save(tmp_path / "nowhere" / "log.h5")


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(DatasetError, match=r"none.h5: there is no such file; check the path"):
        Dataset.load(tmp_path / "none.h5")
    with pytest.raises(DatasetError, match="is a folder of no known layout: .*: name the file inside it"):
        Dataset.load(tmp_path)
    with (
        pytest.raises(DatasetError, match="is a folder; name the HDF5 file inside it"),
        storage.opened(tmp_path),
    ):
        pass


def test_not_hdf5(tmp_path):
    for name, content, message in (
        ("log.csv", b"time,level\n0,1.5\n", r"log.csv: not an HDF5 file \(its first bytes are b'time,lev'\)"),
        ("policy.pkl", b"\x80\x04\x95cos\nsystem\n", "policy.pkl: not an HDF5 file"),
        ("empty.h5", b"", "empty.h5: the file is empty"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DatasetError, match=message), storage.opened(tmp_path / name):
            pass
        with pytest.raises(DatasetError, match=name):
            Dataset.load(tmp_path / name)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_truncated_file(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(DatasetError, match=r"log.h5: the file is cut short at [\d,]+ bytes .*; copy it again"):
        Dataset.load(path)


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def replace(name, data):
    def change(file):
        del file[name]
        file[name] = data

    return change


def set_attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def flip_one_bit(file):
    file["rewards"][3] = np.nextafter(file["rewards"][3], np.float32(9))


EDITS = {
    "another format": (set_attribute("format", "odaf-run"), "says its format is 'odaf-run', expected 'odaf-dataset'"),
    "format of no type": (set_attribute("format", 3), "says its format is .*3.*, expected 'odaf-dataset'"),
    "newer": (set_attribute("version", 4), "written in version 4 of the format, this odaf reads up to 3; upgrade odaf"),
    "version text": (set_attribute("version", "one"), "attribute 'version' is 'one', expected a whole number"),
    "no checksum": (lambda file: file.attrs.__delitem__("sha256"), "attribute 'sha256' is missing"),
    "missing": (lambda file: file.__delitem__("rewards"), r"field 'rewards' is missing; the file has \['action_high'"),
    "type": (replace("rewards", np.zeros(12)), "field 'rewards' holds float64, expected float32; generate"),
    "text": (replace("rewards", np.array([b"x"] * 12)), r"field 'rewards' holds \|S1, expected float32"),
    "shape": (replace("actions", np.zeros(12, np.float32)), r"field 'actions' has shape \(12,\), expected 2 axes"),
    "length": (replace("rewards", np.zeros(11, np.float32)), "field 'rewards' has 11 rows, 'observations' has 12"),
    "group": (
        lambda file: (file.__delitem__("rewards"), file.create_group("rewards")),
        "'rewards' is a group, expected",
    ),
    "nothing": (replace("rewards", h5py.Empty("f4")), "field 'rewards' is empty"),
    "soft link": (replace("rewards", h5py.SoftLink("/actions")), "field 'rewards' is a link to another place"),
    "other file": (replace("rewards", h5py.ExternalLink("x.h5", "/a")), "field 'rewards' is a link to another place"),
    "metadata shape": (replace("metadata", np.zeros(3)), "field 'metadata' must be one JSON text"),
    "one bit": (flip_one_bit, r"contents do not match their checksum \(stored [0-9a-f]{12}"),
    "provenance": (replace("metadata", '{"provenance": {}}'), "contents do not match their checksum"),
}


@pytest.mark.parametrize("name", EDITS)
def test_edited_file_names_what_is_wrong(path, name):
    change, message = EDITS[name]
    edit(path, change)
    with pytest.raises(DatasetError, match=f"^{path}: .*{message}"):
        Dataset.load(path)


def reseal(file):
    """Gives an edited file a checksum that fits, as another program that writes the format would."""
    arrays = {name: file[name][()] for name in file if name != "metadata"}
    file.attrs["sha256"] = fingerprint.checksum(arrays, file["metadata"][()].decode())


SEALED = {
    "nan": (
        replace("rewards", np.where(np.arange(12) > 9, np.nan, 0).astype(np.float32)),
        "field 'rewards' holds NaN or infinity in 2 of 12 rows, the first of them 10, 11",
    ),
    "beyond": (
        replace("actions", np.full((12, 2), 2, np.float32)),
        "field 'actions' leaves its bounds in 12 of 12 rows",
    ),
    "width": (replace("next_observations", np.zeros((12, 2), np.float32)), "'next_observations' has 2 columns"),
    "starts": (replace("episode_starts", np.array([0, 40])), "field 'episode_starts' names row 40"),
    "ends": (
        replace("episode_starts", np.array([0, 7])),
        "disagree: an episode end is marked inside an episode, row 5",
    ),
    "not JSON": (replace("metadata", "{"), "field 'metadata' cannot be read"),
    "names": (
        replace("metadata", '{"provenance": {}}'),
        "field 'metadata' cannot be read .KeyError: 'observation_names'",
    ),
}


@pytest.mark.parametrize("name", SEALED)
def test_well_formed_file_with_wrong_contents(path, name):
    change, message = SEALED[name]
    edit(path, change)
    edit(path, reseal)
    with pytest.raises(DatasetError, match=f"^{path}: .*{message}"):
        Dataset.load(path)


def test_data_in_another_file_is_not_followed(path, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(48))

    def change(file):
        del file["rewards"]
        file.create_dataset("rewards", (12,), "<f4", external=[(str(tmp_path / "secret.bin"), 0, 48)])

    edit(path, change)
    with pytest.raises(DatasetError, match="field 'rewards' is stored in another file"):
        Dataset.load(path)


def test_damage_anywhere_is_noticed_or_harmless(path):
    """Every 101st byte inverted in turn: the file either fails with our error or still holds the same data."""
    content, expected = path.read_bytes(), small().fingerprint()
    refused = 0
    positions = range(0, len(content), 101)
    for position in positions:
        damaged = bytearray(content)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            assert Dataset.load(path).fingerprint() == expected
        except DatasetError as error:
            assert str(error).startswith(str(path))
            refused += 1
    assert refused > len(positions) / 10


def test_damage_on_which_the_hdf5_library_would_hang(path):
    """An empty object where the file keeps its texts: the library would look at it for ever."""
    content = path.read_bytes()
    start = content.index(b"GCOL") + 16
    path.write_bytes(content[:start] + bytes(16) + content[start + 16 :])
    for read in (Dataset.load, storage.is_own_file):
        with pytest.raises(DatasetError, match=f"the file is damaged at byte {start:,}, where its texts are"):
            read(path)


def test_options_of_the_other_layout_are_refused(path):
    choices: list[dict[str, Any]] = [{"max_episode_steps": 10}, {"action_bounds": (-1, 1)}, {"d4rl_compat": True}]
    for options in choices:
        with pytest.raises(DatasetError, match=f"{next(iter(options))} applies to files in the D4RL layout"):
            Dataset.load(path, **options)


def test_large_provenance_fits(tmp_path):
    """HDF5 attributes end at 64 KiB; provenance must not."""
    dataset = small(provenance={"notes": ["x" * 1000] * 200})
    dataset.save(tmp_path / "long.h5")
    assert Dataset.load(tmp_path / "long.h5").provenance == dataset.provenance


def steps(seen):
    """The calls of a listener, checked for going only forward and ending at the end."""
    done, totals = [entry[0] for entry in seen], {entry[1] for entry in seen}
    assert done == sorted(done) and len(totals) == 1 and done[-1] == totals.pop()
    return len(done)


def test_writing_and_reading_say_how_far_they_have_come(tmp_path, monkeypatch):
    monkeypatch.setattr(fingerprint, "PIECE", 64)  # bytes, so that these few rows are many pieces
    dataset = Dataset.from_arrays(
        np.arange(120.0).reshape(40, 3), np.zeros((40, 1)), np.zeros(40), episode=np.zeros(40), action_bounds=(-1, 1),
        infos={"wide": np.arange(160).reshape(40, 4), "none": np.zeros((40, 0))},
    )  # fmt: skip
    print_whole = dataset.file_fingerprint()
    written, read = [], []
    dataset.save(tmp_path / "log.h5", lambda *entry: written.append(entry))
    again = Dataset.load(tmp_path / "log.h5", progress=lambda *entry: read.append(entry))
    assert again.file_fingerprint() == print_whole
    np.testing.assert_array_equal(again.infos["wide"], dataset.infos["wide"])
    assert steps(written) > 40 and steps(read) > 20
    monkeypatch.undo()
    assert again.file_fingerprint() == print_whole, "the size of the pieces is no part of what is summed"


def test_other_layouts_say_how_far_they_have_come(tmp_path):
    dataset = Dataset.from_arrays(
        np.zeros((9, 1)),
        np.zeros((9, 1)),
        np.zeros(9),
        np.zeros((9, 1)),
        episode=np.arange(9) // 3,
        action_bounds=(-1, 1),
    )
    seen = {name: [] for name in ("to d4rl", "from d4rl", "to minari", "from minari")}
    convert.to_d4rl(dataset, tmp_path / "d4rl", lambda *entry: seen["to d4rl"].append(entry))
    convert.to_minari(dataset, tmp_path / "minari", progress=lambda *entry: seen["to minari"].append(entry))
    for name in ("d4rl", "minari"):
        Dataset.load(tmp_path / name, progress=lambda *entry, name=name: seen[f"from {name}"].append(entry))
    assert {name: steps(entries) for name, entries in seen.items()} == {
        "to d4rl": 6, "from d4rl": 7, "to minari": 3, "from minari": 7
    }  # fmt: skip
