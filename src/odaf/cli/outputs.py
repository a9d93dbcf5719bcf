"""What a command may write to: never what it reads, never two results to one place, and nothing foreign unasked.

Every command that takes names of results calls `check_outputs` before it reads anything.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from odaf.errors import ConfigError, DatasetError


@dataclass(frozen=True)
class Kind:
    """A kind of result, and how an earlier one is told from other people's files.

    Attributes:
        name: with its article, as messages say it.
        earlier: whether a file (or folder) that is there is such a result, so that nothing is lost with it.
        folder: the result is a folder; one that is there is replaced only with --force.
        makes_parents: the folders above are made where they are missing.
        streams: may go to a pipe or a device, such as /dev/stdout.
    """

    name: str
    earlier: Callable[[Path], bool]
    folder: bool = False
    makes_parents: bool = False
    streams: bool = False


def _is_dataset(path: Path) -> bool:
    from odaf.data import storage

    try:
        return storage.is_own_file(path)
    except DatasetError:  # HDF5, but damaged or of another kind
        return False


def _is_d4rl_of_ours(path: Path) -> bool:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "metadata/odaf" in file
    except (OSError, RuntimeError):
        return False


def _is_page(path: Path) -> bool:
    content = path.read_bytes()
    return b"<!doctype html" in content[:4096].lower() and b"Page made by odaf" in content[-4096:]


def _is_picture(path: Path) -> bool:
    with open(path, "rb") as file:
        start = file.read(4096)
    return start.startswith(b"\x89PNG") if path.suffix == ".png" else b"<svg" in start


def _starts_with(words: bytes) -> Callable[[Path], bool]:
    def earlier(path: Path) -> bool:
        with open(path, "rb") as file:
            return file.read(len(words)) == words

    return earlier


def _is_json_with(*fields: str) -> Callable[[Path], bool]:
    def earlier(path: Path) -> bool:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError):
            return False
        return isinstance(content, dict) and set(fields) <= set(content)

    return earlier


def _is_tensors_of(form: str) -> Callable[[Path], bool]:
    """Whether a file in the layout of safetensors says that it is of this form."""

    def earlier(path: Path) -> bool:
        with open(path, "rb") as file:
            length = int.from_bytes(file.read(8), "little")
            text = file.read(min(length, 100_000_000))
        try:
            return json.loads(text)["__metadata__"]["format"] == form
        except (ValueError, RecursionError, LookupError, TypeError):
            return False

    return earlier


DATASET = Kind("an odaf data set", _is_dataset)
D4RL = Kind("a D4RL file that odaf wrote", _is_d4rl_of_ours)
MINARI = Kind("a Minari folder", lambda path: (path / "data" / "metadata.json").is_file(), folder=True)
PAGE = Kind("a page that odaf made", _is_page, makes_parents=True)
PICTURE = Kind("a picture of its format", _is_picture, makes_parents=True)
TABLE_CSV = Kind("a table of `odaf report`", _starts_with(b"name,preset,directory,"), makes_parents=True, streams=True)
TABLE_JSON = Kind("a table of `odaf report`", _is_json_with("table", "statistic"), makes_parents=True, streams=True)
TABLE_LATEX = Kind("a table of `odaf report`", _starts_with(b"% Table made by odaf"), makes_parents=True, streams=True)
DEMO_SUMMARY = Kind("a summary of `odaf demo`", _is_json_with("dataset", "methods"))
CHECK_REPORT = Kind("a report of `odaf data check`", _is_json_with("usable", "findings"), streams=True)
SCORES = Kind("scores of `odaf evaluate`", _is_json_with("seeds", "mean_return"), streams=True)
COMPARISON = Kind("a comparison of `odaf compare`", _is_json_with("runs", "pairs", "statistics"), streams=True)
VALUATION = Kind("estimates of `odaf estimate`", _is_json_with("behaviour", "estimates"), streams=True)
ASSESSMENT = Kind("an assessment of `odaf assess`", _is_json_with("verdict", "reservations"), streams=True)
ARTEFACT = Kind(
    "an artefact of `odaf export`",
    lambda path: (path / "contract.json").is_file() and _is_json_with("odaf", "not_promised")(path / "contract.json"),
    folder=True,
)
GUARD = Kind("a guarded policy that odaf wrote", _is_tensors_of("odaf-guard"))
GUARD_RECORD = Kind("a record of `odaf guard`", _is_json_with("calibration", "levels"), streams=True)
SELECTION = Kind("a choice of `odaf select`", _is_json_with("best_run", "candidates"), streams=True)
ATTACK_SCORES = Kind("scores of `odaf evaluate --attack`", _is_json_with("attack", "budgets"), streams=True)


def check_outputs(
    outputs: Mapping[str, tuple[Path | None, Kind]], inputs: Iterable[Path | None], force: bool | None = None
) -> None:
    """Raises `ConfigError` unless every result can be written without destroying anything.

    Links, hard links and other spellings of one place are that place. An earlier result of the same kind may be written
    over, as when a command is given again; anything else only with `force`, and what the command reads not even then.

    Args:
        outputs: by option: the place, or None where none was asked for, and the kind of what comes there.
        inputs: files and folders that the command reads; None where one was not given.
        force: whether files of another kind may be written over; None if the command has no such option.
    """
    asked = {option: (path, kind) for option, (path, kind) in outputs.items() if path is not None}
    given = [path for path in inputs if path is not None]
    for option, (path, kind) in asked.items():
        _check_place(option, path, kind)
        for source in given:
            _keep_source(option, path, kind, source)
        if not force:
            _keep_foreign(option, path, kind, "" if force is None else ", or give --force to write over it")
        elif kind.folder and path.exists() and not kind.earlier(path):
            raise ConfigError(f"{option} {path}: is not {kind.name}; remove it yourself, or name another place")
    options = list(asked)
    for place, option in enumerate(options):
        for other in options[:place]:
            if _same(asked[option][0], asked[other][0]):
                raise ConfigError(f"{other} and {option}: are one file, {asked[option][0]}; name two")


def _check_place(option: str, path: Path, kind: Kind) -> None:
    """The result can be made there: no folder in its place, and one above it that can be written to."""
    if path.is_dir() and not kind.folder:
        raise ConfigError(f"{option} {path}: is a folder; name a file in it, for example {path / 'NAME'}")
    if path.exists() and not path.is_dir() and (kind.folder or not (path.is_file() or kind.streams)):
        raise ConfigError(f"{option} {path}: is no {'folder' if kind.folder else 'file'}; name another place")
    parent = Path(os.path.realpath(path)).parent
    if kind.makes_parents:
        while not parent.exists():
            parent = parent.parent
    if not parent.exists():
        raise ConfigError(f"{option} {path}: there is no folder {parent}; make it first, or name another place")
    if not parent.is_dir() or (not (path.exists() and not path.is_file()) and not os.access(parent, os.W_OK)):
        raise ConfigError(f"{option} {path}: cannot be written in {parent}; choose a folder that is writable")


def _keep_source(option: str, path: Path, kind: Kind, source: Path) -> None:
    """The result is neither the source, nor a file that belongs to it, nor a folder that holds it."""
    if _same(path, source):
        raise ConfigError(f"{option} {path}: is what the command reads; name another place")
    if kind.folder and path.exists() and _inside(source, path):
        raise ConfigError(f"{option} {path}: holds {source}, which the command reads; name another place")
    if source.is_dir() and path.is_file() and _inside(path, source) and not (_is_empty(path) or kind.earlier(path)):
        raise ConfigError(f"{option} {path}: is a file of {source}, which the command reads; name another place")


def _keep_foreign(option: str, path: Path, kind: Kind, otherwise: str) -> None:
    """Nothing is there, or an earlier result of the kind, or an empty file."""
    if kind.folder and path.exists():
        raise ConfigError(f"{option} {path}: exists already; name a new folder{otherwise}")
    if path.is_file() and not (_is_empty(path) or kind.earlier(path)):
        raise ConfigError(f"{option} {path}: is there, and is not {kind.name}; name another place{otherwise}")


def _is_empty(path: Path) -> bool:
    return path.stat().st_size == 0


def _same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one of them is not there yet
        return os.path.realpath(one) == os.path.realpath(other)


def _inside(path: Path, folder: Path) -> bool:
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))
