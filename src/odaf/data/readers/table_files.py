"""Which files of a folder hold the pieces of one table, and which only keep them company."""

import re
from pathlib import Path
from typing import Literal

from odaf.errors import DatasetError

Kind = Literal["csv", "parquet"]

_SUFFIXES: dict[str, Kind] = {".parquet": "parquet", ".pq": "parquet", ".csv": "csv", ".tsv": "csv"}
_STRAY_NAMES = ("thumbs.db", "ehthumbs.db", "desktop.ini", "icon\r")
_STRAY_SUFFIXES = (".crc", ".tmp", ".part", ".bak", ".lock")


def is_companion(name: str) -> bool:
    """Whether a file is left beside data by a program that wrote or showed them: `_SUCCESS`, `.DS_Store`, `.x.crc`."""
    low = name.lower()
    return low.startswith((".", "_", "~")) or low in _STRAY_NAMES or low.endswith(_STRAY_SUFFIXES)


def table_files(folder: Path) -> tuple[Kind, list[Path]] | None:
    """The pieces of a table in a folder, `part-2` before `part-10`, and their kind; None where there are none.

    Raises:
        DatasetError: there are both CSV and Parquet files.
    """
    found: dict[Kind, list[Path]] = {"csv": [], "parquet": []}
    for path in folder.iterdir():
        kind = _SUFFIXES.get(path.suffix.lower())
        if kind is not None and path.is_file() and not is_companion(path.name):
            found[kind].append(path)
    present: list[Kind] = [kind for kind, files in found.items() if files]
    if len(present) > 1:
        both = " and ".join(min(found[kind]).name for kind in present)
        raise DatasetError(f"{folder}: holds both CSV and Parquet files ({both}); name one of them, or part the folder")
    if not present:
        return None
    return present[0], sorted(found[present[0]], key=_natural)


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]
