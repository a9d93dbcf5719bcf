"""Where a run's data lie: as they were named, seen from where the run was begun, or beside the run."""

import os
import shlex
from pathlib import Path
from typing import Any

from odaf.data import fingerprint
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError, DatasetError
from odaf.training.run_directory import RunDirectory


def data_place(path: str | os.PathLike[str] | None, directory: Path) -> dict[str, Any]:
    """What `data.json` says of the place of the data: their path as it was given, and what it is relative to."""
    if path is None:
        return {"path": None}
    given = os.fspath(path)
    try:
        beside = os.path.relpath(os.path.abspath(given), os.path.abspath(directory))
    except ValueError:  # on another drive
        beside = None
    return {"path": given, "begun_in": os.getcwd(), "from_run": beside}


def places(run: RunDirectory) -> list[Path]:
    """Where the run's data may lie, the likeliest first; empty if they came from memory."""
    record = run.data
    if record.get("path") is None:
        return []
    given = Path(record["path"])
    found = [Path(record["begun_in"]) / given] if record.get("begun_in") else []
    found.append(given)
    if record.get("from_run"):
        found.append(Path(os.path.normpath(run.path / record["from_run"])))
    found += [run.path.parent / given.name, run.path / given.name]
    return list({os.path.abspath(place): place for place in found}.values())


def find_data(run: RunDirectory) -> Path:
    """The file that the run's data are in.

    Raises:
        ConfigError: the data came from memory.
        DatasetError: none of the places holds a file; the message names all.
    """
    looked = places(run)
    if not looked:
        raise ConfigError(
            f"{run.path}: its data came from memory, not from a file; give them again as `dataset`, "
            "or save them with Dataset.save and train from the file"
        )
    for place in looked:
        if place.exists():
            return place
    raise DatasetError(
        f"{run.path}: its data are not where they were; looked for {', '.join(map(str, looked))}. Name their place: "
        f"`odaf resume {shlex.quote(str(run.path))} --data FILE`, or odaf.resume(..., dataset=FILE) in Python"
    )


def check_same_data(run: RunDirectory, dataset: Dataset, place: str | os.PathLike[str] | None = None) -> None:
    """Makes sure that `dataset` is what the run was begun with.

    Args:
        run: the run.
        dataset: what was found.
        place: the file it was read from, for the message.

    Raises:
        DatasetError: it is not.
    """
    different = fingerprint.differing(dataset, run.data)
    if different is not None:
        found, expected = different
        name = "dataset" if place is None else os.fspath(place)
        raise DatasetError(
            f"{name}: its fingerprint is {found[:12]}..., but {run.path} was begun with data of fingerprint "
            f"{expected[:12]}... ({run.data.get('path') or 'from memory'}); give the same data, or train into another "
            "directory"
        )
