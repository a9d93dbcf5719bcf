"""Which layout a file or folder is in, told from what it holds; its name never decides."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py

from odaf.data import storage
from odaf.data.readers import d4rl, hdf5, minari, numpy_files, ogbench, table_files
from odaf.errors import DatasetError

_UNPACK = ((b"\x1f\x8b", "gzip"), (b"BZh", "bzip2"), (b"\xfd7zXZ\x00", "xz"), (b"\x28\xb5\x2f\xfd", "zstd"))
# Protocol 2 and later start with their number; 0 and 1 with the opcodes of a collection or of a class to import.
_PICKLE = re.compile(rb"\x80[\x02-\x05]|\((?:[dlt]p?\d*\n|[dlt]q|i\w)|[\]}](?:q|p\d)|c[\w.]+\n[\w.]+\n")
TITLES = {
    "d4rl": "D4RL's",
    "minari": "Minari's",
    "ogbench": "OGBench's",
    "d3rlpy": "d3rlpy's",
    "lerobot": "LeRobot's",
}
_UNSAFE = (
    "loading it would run code from the file, so odaf does not. Load it where you trust it, and save the arrays with "
    "Dataset.from_arrays(...).save(...), as columns of a table, or with numpy.savez"
)


def detect(path: str | os.PathLike[str], *, text: bool = False) -> str:
    """The name of the layout: one of `FORMATS`, or `odaf` for a file that `Dataset.save` wrote.

    Args:
        path: file or folder.
        text: whether a file of no other layout is a text table even if its first line does not show it, as when lines
            stand in front of the headings or the letters are not those of UTF-8.

    Raises:
        DatasetError: there is nothing at `path`, loading it would run code, or no layout fits what was found.
    """
    source = os.fspath(path)
    place = Path(path)
    if place.is_dir():
        return _folder(place, source)
    if not place.exists():
        raise DatasetError(f"{source}: there is no such file; check the path, or make the data first")
    try:
        with open(place, "rb") as handle:
            head = handle.read(4096)
            handle.seek(-min(place.stat().st_size, 1), os.SEEK_END)
            tail = handle.read(1)
    except OSError as error:
        raise DatasetError(f"{source}: cannot be read ({error}); give a file that may be read") from error
    if not head:
        raise DatasetError(f"{source}: the file is empty; copy or generate it again")
    if h5py.is_hdf5(source):
        return _hdf5(place)
    if head.startswith(b"PK\x03\x04"):
        return _zip(place, source)
    if head.startswith(b"\x93NUMPY"):
        if numpy_files.holds_objects(path):
            raise DatasetError(f"{source}: a .npy file of Python objects, which are pickled; {_UNSAFE}")
        raise DatasetError(
            f"{source}: a single array without the names of its columns; load it with numpy.load and pass the arrays "
            "to Dataset.from_arrays"
        )
    if head.startswith(b"PAR1"):
        return "parquet"
    if _PICKLE.match(head) and (head[0] == 0x80 or tail == b"."):
        raise DatasetError(f"{source}: a Python pickle; {_UNSAFE}")
    for magic, name in _UNPACK:
        if head.startswith(magic):
            raise DatasetError(f"{source}: compressed with {name}; unpack it first")
    if head.startswith(b"ARROW1"):
        raise DatasetError(
            f"{source}: a single Arrow file; give the folder if Minari wrote it, or convert it to Parquet"
        )
    if text or _is_table(head):
        if place.suffix in (".h5", ".hdf5", ".hdf"):
            raise DatasetError(
                f"{source}: named like an HDF5 file, but it holds a text table; if that is meant, say so with "
                "format='csv', otherwise copy or generate it again"
            )
        return "csv"
    raise DatasetError(
        f"{source}: no known layout: neither HDF5, .npz, Parquet nor a text table (its first bytes are {head[:16]!r}); "
        "convert it to one of these, or build the data with Dataset.from_arrays; if it is a text table, say so with "
        "format='csv', encoding= or skip_rows="
    )


def _hdf5(path: Path) -> str:
    with storage.opened(path) as (file, source):
        if storage.is_own(file, source):
            return "odaf"
        with storage.reading(source):
            keys = hdf5.keys(file)
        marks = _hdf5_marks(keys)
        if len(marks) > 1:
            spoken = [] if "minari" in marks else [f'give format="{name}"' for name in marks]
            raise _two_fit(source, marks, *spoken, "write the one that counts into a file of its own")
        if marks:
            return next(iter(marks))
        raise DatasetError(
            f"{source}: neither an odaf dataset (no attribute 'format') nor in the D4RL layout (no fields "
            f"{', '.join(d4rl.REQUIRED)}), and neither Minari's nor d3rlpy's; the file has {hdf5.shown(keys)}"
        )


def _hdf5_marks(keys: Sequence[str]) -> dict[str, str]:
    """What only one layout has, by the layout's name."""
    groups = [key for key in keys if minari.EPISODE.fullmatch(key)]
    d3rlpy = [key for key in ("columns", "num_episodes", "episode_terminals", "discrete_action") if key in keys]
    flat = [name for name in d4rl.REQUIRED if name in keys]
    own = [name for name in ("timeouts", "infos", "metadata") if name in keys]
    if {"columns", "num_episodes"} & set(d3rlpy):
        own = own or flat  # d3rlpy's current files hold no flat arrays, its older ones the same as D4RL's
    marks = {
        "d4rl": f"flat arrays with {', '.join(own)}" if own and flat else "flat arrays" if flat and not d3rlpy else "",
        "minari": f"episodes as groups ({groups[0]}, ...)" if groups else "",
        "d3rlpy": ", ".join(d3rlpy),
    }
    return {name: mark for name, mark in marks.items() if mark}


def _archive_marks(names: Sequence[str]) -> dict[str, str]:
    """The same for arrays in an archive; those of D4RL and OGBench share most of their names."""
    own = [name for name in names if name == "timeouts" or name.startswith(("infos/", "metadata/"))]
    ogbench_own = [name for name in ("masks", "valids", "qpos", "qvel", "button_states") if name in names]
    if "next_observations" in names and "rewards" in names and not ogbench_own:
        own.append("next_observations")
    if "rewards" not in names and not own:
        ogbench_own.append("no rewards")
    marks = {"d4rl": ", ".join(own[:3]), "ogbench": ", ".join(ogbench_own)}
    return {name: mark for name, mark in marks.items() if mark}


def _two_fit(source: str, marks: Mapping[str, str], *remedies: str) -> DatasetError:
    found = " and ".join(f"{TITLES[name]} ({mark})" for name, mark in marks.items())
    return DatasetError(f"{source}: two layouts fit, {found}", remedies=remedies)


def _zip(path: Path, source: str) -> str:
    names = numpy_files.member_names(path)
    pickles = [name for name in names if name.endswith((".pkl", ".pickle"))]
    if pickles:
        raise DatasetError(f"{source}: an archive with a Python pickle ({pickles[0]}); {_UNSAFE}")
    arrays = [name.removesuffix(".npy") for name in names if name.endswith(".npy")]
    if any(name in arrays for name in ogbench.REQUIRED):
        marks = _archive_marks(arrays)
        if len(marks) == 1:
            return next(iter(marks))
        raise _two_fit(
            source,
            marks or {"d4rl": "whose terminals end the task", "ogbench": "whose terminals end a trajectory"},
            'give format="d4rl"',
            'format="ogbench"',
            "pass the arrays to Dataset.from_arrays and say which rows are terminated and which truncated",
        )
    if "xl/workbook.xml" in names:
        raise DatasetError(f"{source}: an Excel workbook; save its sheet as CSV and give that")
    raise DatasetError(
        f"{source}: an archive that is neither in OGBench's layout nor in D4RL's (no fields "
        f"{', '.join(ogbench.REQUIRED)}); it has "
        f"{hdf5.shown(arrays or names)}: load it with numpy.load and pass the arrays to Dataset.from_arrays"
    )


def _folder(path: Path, source: str) -> str:
    data = minari.data_folder(path)
    numbered = any(entry.name.isdigit() for entry in data.iterdir() if entry.is_dir())
    marks = {}
    if (path / "meta" / "info.json").is_file():
        marks["lerobot"] = "meta/info.json"
    if (data / minari.MAIN_FILE).is_file():
        marks["minari"] = minari.MAIN_FILE
    elif (data / "metadata.json").is_file() and numbered:
        marks["minari"] = "metadata.json and folders 0, 1, ..."
    if len(marks) > 1:
        raise _two_fit(source, marks, 'give format="lerobot"', 'format="minari"', "move one into a folder of its own")
    if marks:
        return next(iter(marks))
    entries = sorted(entry.name for entry in path.iterdir())
    if (tables := table_files.table_files(path)) is not None:
        return tables[0]
    raise DatasetError(
        f"{source}: is a folder of no known layout: neither Minari's (data/{minari.MAIN_FILE} or data/metadata.json "
        "with folders 0, 1, ...) nor LeRobot's (meta/info.json), nor with CSV or Parquet files in it; it has "
        f"{hdf5.shown(entries)}: name the file inside it"
    )


def _is_table(head: bytes) -> bool:
    """Whether the first bytes are text in at least two columns."""
    try:
        text = head.decode("utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4 or head[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return False
        text = head[: error.start].decode("utf-8")
    lines: Sequence[str] = text.lstrip("\ufeff \r\n").splitlines()
    if "\x00" in text or not lines or lines[0].startswith(("{", "[", "<")):
        return False
    return any(mark in lines[0] for mark in ",;\t|")
