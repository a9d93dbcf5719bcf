"""The layout is told from the contents; what would run code is refused before anything is loaded."""

import bz2
import contextlib
import gzip
import itertools
import pickle
import zipfile

import h5py
import numpy as np
import pytest

from odaf.data import Dataset, readers
from odaf.errors import DatasetError

ran = []


class Bomb:
    """Unpickling one leaves a trace."""

    def __reduce__(self):
        return (ran.append, ("unpickled",))


def hdf5(path, *names):
    with h5py.File(path, "w") as file:
        for name in names:
            file[name] = np.zeros((3, 1))


def claim(path):
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "odaf-run"


def save(path, array=None, **arrays):
    """Unlike NumPy's own function of a path, this adds no ending to the name."""
    with path.open("wb") as file:
        if array is None:
            np.savez(file, **arrays)
        else:
            np.save(file, array, allow_pickle=True)


FILES = {
    "d4rl": lambda path: hdf5(path, "observations", "actions", "rewards", "terminals"),
    "d4rl without rewards": lambda path: hdf5(path, "observations", "actions"),
    "minari": lambda path: hdf5(path, "episode_0/rewards", "episode_11/rewards"),
    "d3rlpy": lambda path: hdf5(path, "columns", "num_episodes", "version", "rewards_0"),
    "d3rlpy 1": lambda path: hdf5(path, "observations", "actions", "rewards", "terminals", "episode_terminals"),
    "ogbench": lambda path: save(path, observations=np.zeros(3), actions=np.zeros(3)),
    "parquet": lambda path: path.write_bytes(b"PAR1" + bytes(20)),
    "csv": lambda path: path.write_text("time,level\n0,1.5\n"),
    "csv with semicolons": lambda path: path.write_text("Zeit;Füllstand\n0;1,5\n", encoding="utf-8-sig"),
    "csv of a spreadsheet": lambda path: path.write_text("time\tlevel\n0\t1.5\n", encoding="utf-16"),
    "csv cut inside a letter": lambda path: path.write_bytes(b"a,b\n" + b"1,\xc3\xa4\n" * 2000),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("suffix", ["", ".csv", ".h5", ".npz"])
def test_contents_decide_and_the_name_does_not(tmp_path, name, suffix):
    path = tmp_path / f"file{suffix}"
    FILES[name](path)
    if suffix == ".h5" and name.startswith("csv"):  # the only contradiction that is taken for a mistake
        with pytest.raises(DatasetError, match="named like an HDF5 file, but it holds a text table; .* format='csv'"):
            readers.detect(path)
        return
    assert readers.detect(path) == name.split(" ")[0]


FLAT = ("observations", "actions", "rewards", "terminals")
# Fields in one HDF5 file, by what each layout alone has.
MARKS = {
    "D4RL": (*FLAT, "timeouts"),
    "Minari": ("episode_0/rewards",),
    "d3rlpy": ("columns", "num_episodes", "version", "rewards_0"),
    "d3rlpy 1": (*FLAT, "episode_terminals", "discrete_action"),
}
# (members of an archive, the layout or the two that fit)
ARCHIVES = [
    ((*FLAT, "timeouts"), "d4rl"),
    ((*FLAT, "infos/qpos"), "d4rl"),
    ((*FLAT, "next_observations"), "d4rl"),
    (("observations", "actions", "terminals", "timeouts"), "d4rl"),  # its reader misses the rewards
    (("observations", "actions", "terminals"), "ogbench"),
    ((*FLAT, "masks"), "ogbench"),
    ((*FLAT, "qpos"), "ogbench"),
    ((*FLAT, "masks", "next_observations"), "ogbench"),
    (FLAT, "both"),
    ((*FLAT, "timeouts", "masks"), "both"),
    ((*FLAT, "infos/qpos", "qpos"), "both"),
]


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(MARKS, 2)))
def test_what_only_one_layout_has_decides_and_two_such_things_are_refused(tmp_path, first, second):
    path = tmp_path / "file.h5"
    names = sorted({*MARKS[first], *MARKS[second]})
    hdf5(path, *names)
    layouts = {name.split(" ")[0] for name in (first, second)}
    if len(layouts) == 1:
        with pytest.raises(DatasetError, match="two layouts fit") if "rewards" in names else contextlib.nullcontext():
            readers.detect(path)
        return
    with pytest.raises(DatasetError, match="file.h5: two layouts fit, ") as caught:
        readers.detect(path)
    assert all(f"{layout}'s (" in str(caught.value) for layout in layouts)


@pytest.mark.parametrize(("names", "expected"), ARCHIVES)
def test_an_archive_of_keys_that_d4rl_and_ogbench_share(tmp_path, names, expected):
    save(tmp_path / "file.npz", **{name: np.zeros(3) for name in names})
    if expected != "both":
        assert readers.detect(tmp_path / "file.npz") == expected
        return
    with pytest.raises(DatasetError, match=r"two layouts fit, D4RL's .*OGBench's .*format=\"d4rl\", or format=\"ogben"):
        readers.detect(tmp_path / "file.npz")


def test_a_folder_of_two_layouts(tmp_path):
    for name, inside in (("hdf5", "data/main_data.hdf5"), ("arrow", "data/0/part-0.arrow")):
        for place in (inside, "meta/info.json", "data/metadata.json"):
            (tmp_path / name / place).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name / place).write_text("{}")
        with pytest.raises(DatasetError, match=r"two layouts fit, LeRobot's .meta/info.json. and Minari's"):
            readers.detect(tmp_path / name)


def test_own_files(tmp_path):
    Dataset.from_arrays(np.zeros((2, 1)), np.array([[0.0], [1.0]]), np.zeros(2), terminated=[False, True]).save(
        tmp_path / "own.csv"
    )
    assert readers.detect(tmp_path / "own.csv") == "odaf"
    with pytest.raises(DatasetError, match="own.csv: an odaf dataset; read it with Dataset.load"):
        readers.read(tmp_path / "own.csv")
    assert len(Dataset.load(tmp_path / "own.csv")) == 2


def test_folders(tmp_path):
    for name, inside, expected in (
        ("hdf5", "data/main_data.hdf5", "minari"),
        ("inner", "main_data.hdf5", "minari"),
        ("arrow", "data/0/part-0.arrow", "minari"),
        ("robot", "meta/info.json", "lerobot"),
    ):
        place = tmp_path / name / inside
        place.parent.mkdir(parents=True)
        place.write_bytes(b"")
        if name == "arrow":
            (tmp_path / name / "data" / "metadata.json").write_text("{}")
        assert readers.detect(tmp_path / name) == expected
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("")
    with pytest.raises(DatasetError, match=r"other: is a folder of no known layout: .*it has \['notes.txt'\]"):
        readers.detect(tmp_path / "other")


def archive(path, name, content):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(name, content)


def pickled(protocol):
    return lambda path: path.write_bytes(pickle.dumps({"observations": Bomb()}, protocol))


UNSAFE = {
    **{f"pickle {protocol}": pickled(protocol) for protocol in range(6)},
    "pickled object": lambda path: path.write_bytes(pickle.dumps(Bomb(), 0)),
    "pickled list": lambda path: path.write_bytes(pickle.dumps([Bomb()], 0)),
    "object array": lambda path: save(path, np.array([Bomb()], object)),
    "weights": lambda path: archive(path, "archive/data.pkl", pickle.dumps(Bomb())),
}


@pytest.mark.parametrize("name", UNSAFE)
def test_files_that_run_code_are_refused_with_the_reason_and_the_remedy(tmp_path, name):
    UNSAFE[name](tmp_path / "log.csv")
    ran.clear()
    with pytest.raises(DatasetError, match="log.csv: .*pickle.*would run code .*Dataset.from_arrays"):
        readers.detect(tmp_path / "log.csv")
    assert not ran


def test_object_array_inside_an_archive(tmp_path):
    fields = {"observations": np.array([Bomb()], object), "actions": np.zeros((1, 1)), "terminals": np.ones(1)}
    np.savez(tmp_path / "x.npz", **fields)
    ran.clear()
    with pytest.raises(DatasetError, match="x.npz: field 'observations' holds Python objects, .*would run code"):
        Dataset.load(tmp_path / "x.npz", reward="zero")
    assert not ran


UNKNOWN = {
    "one array": (lambda path: save(path, np.zeros(3)), "a single array .*Dataset.from_arrays"),
    "gzip": (lambda path: path.write_bytes(gzip.compress(b"a,b\n1,2\n")), "compressed with gzip; unpack it first"),
    "bzip2": (lambda path: path.write_bytes(bz2.compress(b"a,b\n1,2\n")), "compressed with bzip2; unpack it first"),
    "other hdf5": (lambda path: hdf5(path, "kernel", "bias"), r"nor d3rlpy's; the file has \['bias', 'kernel'\]"),
    "other npz": (lambda path: save(path, kernel=np.zeros(3)), r"neither in OGBench's .*\['kernel'\]"),
    "zip": (lambda path: archive(path, "notes.txt", "hello"), r"neither in OGBench's .*\['notes.txt'\]"),
    "excel": (lambda path: archive(path, "xl/workbook.xml", "<a/>"), "an Excel workbook; save its sheet as CSV"),
    "json": (lambda path: path.write_text('{"a": 1, "b": 2}'), "no known layout: .*first bytes"),
    "prose": (lambda path: path.write_text("Dear all\n"), "no known layout: .*first bytes"),
    "noise": (lambda path: path.write_bytes(bytes(range(255, 100, -1))), "no known layout: .*first bytes"),
    "arrow": (lambda path: path.write_bytes(b"ARROW1\0\0"), "a single Arrow file; give the folder"),
    "nothing": (lambda path: path.write_bytes(b""), "the file is empty"),
    "cut npz": (lambda path: path.write_bytes(b"PK\x03\x04" + bytes(40)), "the file is damaged"),
    "another claim": (
        claim,
        "says its format is 'odaf-run'",
    ),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_layouts_say_what_was_found(tmp_path, name):
    write, message = UNKNOWN[name]
    write(tmp_path / "file.dat")
    with pytest.raises(DatasetError, match=f"file.dat: .*{message}"):
        readers.detect(tmp_path / "file.dat")


def test_tables_need_to_be_told_which_column_means_what(tmp_path):
    (tmp_path / "log.csv").write_text("level,valve,profit\n1,2,3\n")
    with pytest.raises(DatasetError, match="log.csv: CSV table does not say .*; give observations=, actions=, reward="):
        Dataset.load(tmp_path / "log.csv")
    with pytest.raises(DatasetError, match="none.csv: there is no such file"):
        Dataset.load(tmp_path / "none.csv")
