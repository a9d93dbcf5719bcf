"""Tables: columns by name, fetched one at a time, from Parquet files or from where a sibling module has them."""

import difflib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import polars as pl

from odaf.data.readers.table_cells import Cells, without
from odaf.data.validation import RowNumbers
from odaf.errors import DatasetError


@dataclass(frozen=True)
class Table:
    """Columns by name, each fetched when it is asked for, so that few of them are in memory at once.

    Attributes:
        source: how messages name the table.
        format: the format's name in a `Log`.
        names: of all columns, in order.
        rows: how many there are.
        fetch: the cells of one of the columns.
        numbers: [rows] what messages call each row; None counts from 0.
        parsed: whether all cells are text, to be read as what they stand for.
        decimal_comma: whether that text writes 1,5 for one and a half.
        units_row: whether the first row may turn out to hold units.
        missing_values: what stands for a missing value in any cell, see `table_cells.without`.
        facts: what else is known of the source, for the provenance.
        units: by column name, where the headings gave them.
        place: names a row by its file too, given its place in the table; None where the number says enough.
        parts: by the name of a column of lists, the names of the numbers in its lists, where the source has them.
    """

    source: str
    format: str
    names: tuple[str, ...]
    rows: int
    fetch: Callable[[str], pl.Series]
    numbers: RowNumbers | None = None
    parsed: bool = False
    decimal_comma: bool = False
    units_row: bool = False
    missing_values: tuple[str, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    place: Callable[[int], str] | None = None
    parts: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def row_numbers(self) -> RowNumbers:
        """[rows] the rows' numbers in the source."""
        return range(self.rows) if self.numbers is None else self.numbers

    def cells(self, name: str) -> Cells:
        """One column.

        Raises:
            DatasetError: its cells cannot be read.
        """
        with reading(self.source, f"column '{name}'"):
            values = self.fetch(name)
        if len(values) != self.rows:
            raise DatasetError(
                f"{self.source}: column '{name}' has {len(values):,} rows, there should be {self.rows:,}; "
                "every column needs one entry per step"
            )
        with reading(self.source, f"column '{name}'"):
            values = without(values, self.missing_values)
        # Text in which the caller expects words for missing values is text that stands for something else.
        parsed = self.parsed or bool(self.missing_values)
        return Cells(
            self.source, name, values, self.row_numbers, parsed, self.decimal_comma, self.units_row, self.place
        )

    def require(self, wanted: Iterable[str]) -> None:
        """Raises unless every name is that of exactly one column; the message lists those there are."""
        require(self.source, self.names, wanted)


def require(source: str, names: Sequence[str], wanted: Iterable[str]) -> None:
    """As `Table.require`."""
    for name in wanted:
        if name not in names:
            nearest = difflib.get_close_matches(name, names, n=1) or [
                other for other in names if other.strip().lower() == name.strip().lower()
            ]
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            shown = ", ".join(repr(other) for other in names[:40]) + (", ..." if len(names) > 40 else "")
            raise DatasetError(f"{source}: column '{name}' not found; {hint}the table has {shown or 'no columns'}")
        if names.count(name) > 1:
            raise DatasetError(f"{source}: {names.count(name)} columns are called '{name}'; rename all but one of them")


@contextmanager
def reading(source: str, part: str = "the table") -> Iterator[None]:
    """Turns what the table library raises on unreadable bytes into a `DatasetError`."""
    try:
        yield
    except DatasetError:
        raise
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, MemoryError) as error:
        first = str(error).strip().partition("\n")[0]
        raise DatasetError(
            f"{source}: {part} cannot be read ({type(error).__name__}: {first[:200]}); "
            "the file is damaged, incomplete or of another format: copy or export it again"
        ) from error
    except (TypeError, OverflowError) as error:
        raise DatasetError(f"{source}: {part} mixes types ({error}); convert it to one type") from error


def split_unit(heading: str) -> tuple[str, str]:
    """("level", "m") for `level [m]` or `level (m)`; the unit is empty where the heading ends otherwise."""
    match = re.fullmatch(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", heading)
    return (match[1], (match[2] or match[3] or "").strip()) if match else (heading, "")


def with_units(table: Table) -> Table:
    """The table with each heading parted into the column's name and its unit."""
    parts = [split_unit(name) for name in table.names]
    originals = {name: heading for (name, _), heading in zip(parts, table.names, strict=True)}
    fetch = table.fetch
    names, units = tuple(name for name, _ in parts), {name: unit for name, unit in parts if unit}
    return replace(table, names=names, units=units, fetch=lambda name: fetch(originals[name]))


def parquet_table(path: Path) -> Table:
    """The table in a Parquet file; only columns that are asked for are read.

    Raises:
        DatasetError: the file is missing or no readable Parquet file.
    """
    source = os.fspath(path)
    require_file(path)
    with reading(source):
        with path.open("rb") as file:
            begin = file.read(4)
            end = file.seek(0, os.SEEK_END)
            file.seek(max(end - 4, 0))
            last = file.read(4)
        if begin != b"PAR1" or last != b"PAR1":
            raise DatasetError(
                f"{source}: is no complete Parquet file: its {'first' if begin != b'PAR1' else 'last'} four bytes are "
                f"not the signature PAR1 ({end:,} bytes in all); copy it again"
            )
        options: dict[str, Any] = {"glob": False, "hive_partitioning": False}
        names = tuple(pl.read_parquet_schema(path))
        rows = int(pl.scan_parquet(path, **options).select(pl.len()).collect().item())

    def fetch(name: str) -> pl.Series:
        return pl.read_parquet(path, columns=[name], **options).to_series()

    return Table(source, "parquet", names, rows, fetch)


def require_file(path: Path) -> None:
    """Raises where there is no file."""
    if path.is_dir():
        raise DatasetError(f"{path}: is a folder, not a file; name one of its files")
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file")
