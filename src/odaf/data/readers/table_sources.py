"""Tables and where they come from: CSV files, Parquet files, data frames, mappings from names to columns."""

import csv
import difflib
import io
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from odaf.data.readers.table_cells import Cells
from odaf.errors import DatasetError

SEPARATORS = (",", ";", "\t", "|")
_HEAD_BYTES = 1 << 20


@dataclass(frozen=True)
class Table:
    """Columns by name, each fetched when it is asked for, so that few of them are in memory at once.

    Attributes:
        source: how messages name the table.
        format: the format's name in a `Log`.
        names: of all columns, in order.
        rows: how many there are.
        fetch: the cells of one of the columns.
        row_offset: number of the first row, as messages should give it.
        parsed: whether all cells are text, to be read as what they stand for.
        decimal_comma: whether that text writes 1,5 for one and a half.
        facts: what else is known of the source, for the provenance.
        units: by column name, where the headings gave them.
        parts: by the name of a column of lists, the names of the numbers in its lists, where the source has them.
    """

    source: str
    format: str
    names: tuple[str, ...]
    rows: int
    fetch: Callable[[str], pl.Series]
    row_offset: int = 0
    parsed: bool = False
    decimal_comma: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def numbers(self) -> range:
        """The rows' numbers in the source."""
        return range(self.row_offset, self.row_offset + self.rows)

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
        return Cells(self.source, name, values, self.numbers, self.parsed, self.decimal_comma)

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
    _require_file(path)
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


def csv_table(
    path: Path,
    wanted: Sequence[str],
    numeric: Sequence[str],
    *,
    separator: str | None = None,
    decimal_comma: bool = False,
    encoding: str = "utf-8",
    skip_rows: int = 0,
    units_in_headings: bool = False,
) -> Table:
    """The table in a CSV file with one row of headings; its rows are numbered as in a spreadsheet, from 2.

    Args:
        path: the file. Text may stand in double quotes; a byte order mark is skipped.
        wanted: the columns that will be asked for.
        numeric: those of them that hold numbers.
        separator: between cells. None takes that of comma, semicolon, tabulator and bar which finds most of the wanted
            headings, and of several the one that cuts the headings into most pieces.
        decimal_comma: 1,5 is one and a half; such cells stand in quotes where the separator is a comma.
        encoding: of the text, such as "utf-8", "latin-1" or "utf-16".
        skip_rows: lines in front of the headings.
        units_in_headings: part each heading into the column's name and its unit; `wanted` are names without units.

    Raises:
        DatasetError: the file is missing, empty, not text in this encoding, or its rows have more cells than headings.
    """
    source = os.fspath(path)
    _require_file(path)
    if separator is not None and len(separator.encode("utf-8", "replace")) != 1:
        raise DatasetError(f"{source}: separator is {separator!r}; it must be one character, such as ';'")
    if skip_rows < 0:
        raise DatasetError(f"{source}: skip_rows is {skip_rows}; give the number of lines before the headings")
    content, head = _text(path, source, encoding)
    lines = _lines(head, skip_rows)
    parts = split_unit if units_in_headings else lambda heading: (heading, "")
    chosen = _separator(lines, set(wanted), parts) if separator is None else separator
    headings = _first_record(lines, chosen)
    if not any(headings):
        raise DatasetError(
            f"{source}: row {skip_rows + 1} should hold the headings, but it is empty; "
            "pass skip_rows=, the number of lines in front of them"
        )
    names, units = zip(*map(parts, headings), strict=True)
    require(source, names, wanted)
    positions = {name: names.index(name) for name in wanted}
    numbers = {headings[positions[name]] for name in numeric}
    with reading(source):
        frame = _csv_frame(source, content, chosen, decimal_comma, skip_rows, headings, numbers)
    if len(frame.columns) != len(headings):
        raise DatasetError(
            f"{source}: row {skip_rows + 1} should hold the headings, and cannot be told from the rows around it; "
            "remove empty and quoted lines before it"
        )
    columns = {name: frame.columns[index] for name, index in positions.items()}
    frame = frame.select(list(dict.fromkeys(columns.values())))
    return Table(
        source,
        "csv",
        names,
        frame.height,
        lambda name: frame[columns[name]],
        row_offset=skip_rows + 2,
        parsed=True,
        decimal_comma=decimal_comma,
        facts={"separator": chosen, "encoding": encoding},
        units={name: unit for name, unit in zip(names, units, strict=True) if unit},
    )


def frame_table(frame: Any, source: str) -> Table:
    """The table in a polars or pandas frame, or in a mapping from names to arrays.

    Anything that lists its `columns` and gives each by its name, with `to_numpy`, is taken as pandas' frames are.

    Raises:
        DatasetError: it is none of these, or its columns differ in length.
    """
    if isinstance(frame, pl.LazyFrame):
        with reading(source):
            schema = frame.collect_schema()
            rows = int(frame.select(pl.len()).collect().item())
        return Table(source, "frame", tuple(schema), rows, lambda name: frame.select(name).collect().to_series())
    if isinstance(frame, pl.DataFrame):
        return Table(source, "frame", tuple(frame.columns), frame.height, frame.get_column)
    names = frame.keys() if isinstance(frame, Mapping) else getattr(frame, "columns", None)
    if names is None or not hasattr(frame, "__getitem__"):
        raise DatasetError(
            f"{source}: got {type(frame).__name__}; pass a polars or pandas frame, or a mapping from names to columns"
        )
    names = tuple(names)
    if not all(isinstance(name, str) for name in names):
        odd = next(name for name in names if not isinstance(name, str))
        raise DatasetError(f"{source}: column name {odd!r} is not a text; rename the columns")
    unique = [name for name in names if names.count(name) == 1]
    rows = len(_series(source, unique[0], frame[unique[0]])) if unique else 0
    return Table(source, "frame", names, rows, lambda name: _series(source, name, frame[name]))


def _series(source: str, name: str, column: Any) -> pl.Series:
    """A column of any kind; pandas' marks for missing values become null."""
    if isinstance(column, pl.Series):
        return column
    if not hasattr(column, "__len__"):
        raise DatasetError(f"{source}: column '{name}' is {column!r:.40}; give a sequence with one entry per step")
    try:
        array = np.asarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
    except ValueError:  # lists of different lengths
        array = np.empty(len(column), object)
        array[:] = list(column)
    if array.dtype != object:
        return pl.Series(name, array)
    if hasattr(column, "isna"):
        array = array.copy()
        array[np.asarray(column.isna(), bool)] = None
    values = [value.item() if isinstance(value, np.generic) else value for value in array.tolist()]
    kinds = [_kind(value) for value in values]
    known = set(kinds) - {"nothing"}
    if len(known) > 1:
        common = max(known, key=kinds.count)
        row = next(index for index, kind in enumerate(kinds) if kind not in (common, "nothing"))
        raise DatasetError(
            f"{source}: column '{name}' mixes {' and '.join(sorted(known))}, for instance {values[row]!r} "
            f"in row {row}; convert it to one type"
        )
    return pl.Series(name, values, dtype=pl.Float64 if known == {"numbers"} else None)


def _kind(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, (bool, int, float)):
        return "numbers"
    if isinstance(value, str):
        return "text"
    return "lists" if isinstance(value, (list, tuple, np.ndarray)) else type(value).__name__


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise DatasetError(f"{path}: is a folder, not a file; name one of its files")
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file")


def _text(path: Path, source: str, encoding: str) -> tuple[Path | io.BytesIO, str]:
    """What the CSV parser reads, and the beginning of the file as text."""
    with reading(source), path.open("rb") as file:
        begin = file.read(_HEAD_BYTES)
        if encoding.lower().replace("_", "-") in ("utf-8", "utf8"):
            if begin[:2] in (b"\xff\xfe", b"\xfe\xff"):
                raise DatasetError(f'{source}: is text in UTF-16; pass encoding="utf-16"')
            return path, begin.decode("utf-8-sig", "replace")
        try:
            text = (begin + file.read()).decode(encoding)
        except LookupError as error:
            raise DatasetError(f"{source}: encoding {encoding!r} is unknown; try 'utf-8' or 'latin-1'") from error
        except UnicodeError as error:
            raise DatasetError(f"{source}: is not text in {encoding} ({error}); name its true encoding") from error
    return io.BytesIO(text.encode("utf-8")), text.removeprefix("\ufeff")


def _lines(head: str, skip_rows: int) -> list[str]:
    return list(itertools.islice(io.StringIO(head, newline=None), skip_rows, skip_rows + 100))


def _separator(lines: Sequence[str], wanted: set[str], parts: Callable[[str], tuple[str, str]]) -> str:
    def merit(separator: str) -> tuple[int, int]:
        headings = _first_record(lines, separator)
        return len(wanted & {parts(heading)[0] for heading in headings}), len(headings)

    return max(SEPARATORS, key=merit)


def _first_record(lines: Sequence[str], separator: str) -> list[str]:
    try:
        return [heading.strip() for heading in next(csv.reader(lines, delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def _csv_frame(
    source: str,
    content: Path | io.BytesIO,
    separator: str,
    decimal_comma: bool,
    skip_rows: int,
    headings: Sequence[str],
    numbers: set[str],
) -> pl.DataFrame:
    """All columns: `numbers` parsed where each of their cells allows it, else everything as text."""
    options: dict[str, Any] = {"separator": separator, "skip_rows": skip_rows, "infer_schema": False, "glob": False}
    overrides = {"schema_overrides": dict.fromkeys(numbers, pl.Float64), "decimal_comma": decimal_comma}
    attempts: list[dict[str, Any]] = [overrides, {}]
    for attempt in attempts:
        if isinstance(content, io.BytesIO):
            content.seek(0)
        try:
            return pl.read_csv(content, **options, **attempt)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            if attempt is attempts[-1]:
                _explain_csv(source, content, separator, skip_rows, len(headings))
                raise
    raise AssertionError("the last attempt returns or raises")


def _explain_csv(source: str, content: Path | io.BytesIO, separator: str, skip_rows: int, width: int) -> None:
    """Raises with the row that has too many cells, or that is not text; returns where neither is the trouble."""
    binary = content.open("rb") if isinstance(content, Path) else content
    binary.seek(0)
    with binary, io.TextIOWrapper(binary, encoding="utf-8-sig", newline="") as text:
        try:
            lines = itertools.islice(text, skip_rows, None)
            for number, record in enumerate(csv.reader(lines, delimiter=separator), skip_rows + 1):
                if len(record) > width:
                    raise DatasetError(
                        f"{source}: row {number} has {len(record)} cells, there are {width} headings; quote cells that "
                        f"hold the separator {separator!r}, or pass separator= if it is another one"
                    )
        except UnicodeDecodeError as error:
            raise DatasetError(
                f'{source}: is not text in UTF-8 (byte {error.object[error.start]:#04x}); pass encoding="latin-1" '
                "if it comes from an older program"
            ) from error
        except csv.Error:
            return
