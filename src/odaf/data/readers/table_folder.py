"""Several tables of one form, one after another, as one: a folder with a file for each day, or for each part."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from odaf.data.readers.table_sources import Table, reading
from odaf.errors import DatasetError

# The column that every joined table has besides its own: the name of the file a row lies in.
FILE = "file"


def joined(folder: Path, files: Sequence[Path], read: Callable[[Path], Table]) -> Table:
    """The rows of all files, numbered from 0 through all of them; messages name the file too.

    A further column, `file`, tells the files apart, unless they have one of that name themselves.

    Args:
        folder: that holds them.
        files: in the order in which they follow each other.
        read: the table in one of them.

    Raises:
        DatasetError: a file cannot be read, or gives a column another unit than the first file does.
    """
    source = os.fspath(folder)
    tables = [read(file) for file in files]
    first = tables[0]
    for table, file in zip(tables, files, strict=True):
        for name in first.units.keys() & table.units.keys():
            if first.units[name] != table.units[name]:
                raise DatasetError(
                    f"{source}: column '{name}' is in {first.units[name]} in {files[0].name} and in "
                    f"{table.units[name]} in {file.name}; convert one of them"
                )
    starts = np.cumsum([0, *(table.rows for table in tables)])

    def fetch(name: str) -> pl.Series:
        if name == FILE and FILE not in first.names:
            return pl.concat([pl.Series([file.name]).new_from_index(0, table.rows) for file, table in pieces])
        parts = []
        for table, (file, _) in zip(tables, pieces, strict=True):
            table.require([name])
            with reading(os.fspath(file), f"column '{name}'"):
                parts.append(table.fetch(name))
        if first.parsed and len({part.dtype for part in parts}) > 1:
            parts = [part.cast(pl.String) for part in parts]
        with reading(source, f"column '{name}', whose type differs between files,"):
            frames = [pl.DataFrame({name: part}) for part in parts]
            return pl.concat(frames, how="vertical_relaxed").to_series()

    def place(row: int) -> str:
        index = int(np.searchsorted(starts, row, side="right")) - 1
        return f"row {int(tables[index].row_numbers[row - int(starts[index])])} of {files[index].name}"

    pieces = list(zip(files, tables, strict=True))
    names = first.names if FILE in first.names else (*first.names, FILE)
    facts: dict[str, Any] = {name: value for name, value in first.facts.items() if name != "empty_lines"}
    if any("empty_lines" in table.facts for table in tables):
        facts["empty_lines"] = sum(table.facts.get("empty_lines", 0) for table in tables)
    facts["files"] = [{"name": file.name, "rows": table.rows} for file, table in pieces]
    return Table(
        source,
        first.format,
        names,
        int(starts[-1]),
        fetch,
        parsed=first.parsed,
        decimal_comma=first.decimal_comma,
        units_row=first.units_row,
        missing_values=first.missing_values,
        facts=facts,
        units=first.units,
        place=place,
    )
