"""Files in the layouts that people have, each read by a module of its own into a `Log`.

A module offers `read(path, *, ...) -> Log` with keyword options, and never runs code from a file. This file tells which
layout a file is in and hands the options on.
"""

import inspect
import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from odaf.data.log import Log
from odaf.data.readers.detection import detect
from odaf.errors import DatasetError, OdafError

__all__ = ["FORMATS", "Format", "detect", "read"]


@dataclass(frozen=True)
class Format:
    """One layout: its name on the command line, what people call it, and the module that reads it."""

    name: str
    title: str
    module: str


FORMATS: dict[str, Format] = {
    entry.name: entry
    for entry in (
        Format("d4rl", "D4RL HDF5", "odaf.data.readers.d4rl"),
        Format("minari", "Minari folder (HDF5 or Arrow)", "odaf.data.readers.minari"),
        Format("ogbench", "OGBench .npz", "odaf.data.readers.ogbench"),
        Format("d3rlpy", "d3rlpy's buffer file", "odaf.data.readers.d3rlpy"),
        Format("lerobot", "LeRobot folder of Parquet files", "odaf.data.readers.lerobot"),
        Format("parquet", "Parquet table", "odaf.data.readers.tables"),
        Format("csv", "CSV table", "odaf.data.readers.tables"),
    )
}

# Who gives one of these says that the file is a text table.
_TEXT_OPTIONS = frozenset({"separator", "decimal_comma", "encoding", "skip_rows", "units_row"})


def read(path: str | os.PathLike[str], format: str | None = None, **options: Any) -> Log:
    """The log in a file or folder.

    Args:
        path: file or folder.
        format: a name in `FORMATS`; None tells it from the contents.
        options: of the layout's own reader, such as `observations=[...]` for tables. None counts as not given, and so
            does False for an option that is not set by itself.

    Raises:
        DatasetError: there is nothing at `path`, its layout is unknown or unsafe, an option does not belong to the
            layout, or the reader refuses the contents.
    """
    name = detect(path, text=not _TEXT_OPTIONS.isdisjoint(options)) if format is None else format
    if name == "odaf":
        raise DatasetError(f"{os.fspath(path)}: an odaf dataset; read it with Dataset.load")
    if name not in FORMATS:
        raise DatasetError(f"{os.fspath(path)}: format {name!r} is unknown; known are {', '.join(FORMATS)}")
    function = import_module(FORMATS[name].module).read
    parameters = [p for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY]
    known = [parameter.name for parameter in parameters]
    unset = {p.name for p in parameters if p.default is None}
    options = {
        name: value for name, value in options.items() if value is not None and not (value is False and name in unset)
    }
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise DatasetError(
            f"{os.fspath(path)}: option {unknown[0]}= does not apply to {FORMATS[name].title}; "
            f"it takes {', '.join(f'{option}=' for option in known) or 'none'}"
        )
    missing = [p.name for p in parameters if p.default is p.empty and p.name not in options]
    if missing:
        raise DatasetError(
            f"{os.fspath(path)}: {FORMATS[name].title} does not say which column means what",
            remedies=[f"give {', '.join(f'{option}=' for option in missing)}"],
        )
    try:
        return function(Path(path), **options)
    except OdafError as error:
        error.offer(known)
        raise
