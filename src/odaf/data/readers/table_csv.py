"""CSV files as tables: where headings and rows begin, what parts the cells, and which lines count."""

import csv
import io
import itertools
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from odaf.data.readers.table_sources import Table, reading, require, require_file, split_unit
from odaf.errors import DatasetError

SEPARATORS = (",", ";", "\t", "|")
_HEAD_BYTES = 1 << 20
_LARGEST_DOUBLE = 2.0**53  # whole numbers up to here are exact in double precision
# Excel's own first line, which says what parts the cells.
_EXCEL_SEPARATOR = re.compile(r'"?sep=(.)"?[;,\s]*', re.IGNORECASE | re.DOTALL)

# Given the names of all columns: those that are needed, and those of them that a learner sees as numbers.
Resolve = Callable[[tuple[str, ...]], tuple[Sequence[str], Sequence[str]]]


@dataclass(frozen=True)
class Dialect:
    """How a CSV file is written; see `odaf.data.readers.tables.read` for each."""

    separator: str | None = None
    decimal_comma: bool = False
    encoding: str = "utf-8"
    skip_rows: int = 0
    units_row: bool = False

    def check(self, source: str) -> None:
        """Raises where a setting makes no sense."""
        if self.separator is not None and len(self.separator.encode("utf-8", "replace")) != 1:
            raise DatasetError(f"{source}: separator is {self.separator!r}; it must be one character, such as ';'")
        if self.skip_rows < 0:
            raise DatasetError(f"{source}: skip_rows is {self.skip_rows}; give the number of lines before the headings")


def csv_table(
    path: Path, hints: Sequence[str], resolve: Resolve, dialect: Dialect, *, units_in_headings: bool = False
) -> Table:
    """The table in a CSV file with one row of headings; its rows are numbered as in a spreadsheet, from 2.

    Lines without anything in their cells are left out; they count in the numbers of those after them.

    Args:
        path: the file. Text may stand in double quotes; a byte order mark and Excel's line `sep=;` are skipped.
        hints: names that may be columns. Of comma, semicolon, tabulator and bar that one parts the cells which finds
            most of them among the headings, and of several the one that cuts the headings into most pieces.
        resolve: which columns are needed.
        dialect: how the file is written.
        units_in_headings: part each heading into the column's name and its unit.

    Raises:
        DatasetError: the file is missing, empty, not text in this encoding, or its rows have more cells than headings.
    """
    source = os.fspath(path)
    require_file(path)
    dialect.check(source)
    content, head = _text(path, source, dialect.encoding)
    skip_rows, separator = _beginning(head, dialect)
    lines = _lines(head, skip_rows)
    parts = split_unit if units_in_headings else lambda heading: (heading, "")
    chosen = _separator(lines, set(hints), parts) if separator is None else separator
    headings = _first_record(lines, chosen)
    if not any(headings):
        raise DatasetError(f"{source}: row {skip_rows + 1} should hold the headings, but the file is empty there")
    names, units = zip(*map(parts, headings), strict=True)
    wanted, numeric = resolve(names)
    require(source, names, wanted)
    positions = {name: names.index(name) for name in wanted}
    numbers = {headings[positions[name]] for name in numeric}
    with reading(source):
        # With a decimal comma the parser takes 1.234 for a fraction, and units are no numbers: then all is text.
        text_only = dialect.decimal_comma or dialect.units_row
        frame = _frame(source, content, chosen, skip_rows, headings, set() if text_only else numbers)
    if [name.strip(' "') for name in frame.columns] != [name.strip(' "') for name in headings] and len(
        set(headings)
    ) == len(headings):
        raise DatasetError(
            f"{source}: row {skip_rows + 1} should hold the headings, and cannot be told from the rows around it; "
            "remove quoted lines before it"
        )
    kept = np.flatnonzero(~_empty(frame))
    columns = {name: frame.columns[index] for name, index in positions.items()}
    frame = frame.select(list(dict.fromkeys(columns.values())))
    units_by_name = {name: unit for name, unit in zip(names, units, strict=True) if unit}
    facts: dict[str, Any] = {"separator": chosen, "encoding": dialect.encoding}
    if len(kept) < frame.height:
        facts["empty_lines"] = frame.height - len(kept)
        frame = frame[kept]
    row_numbers: range | np.ndarray = range(skip_rows + 2, skip_rows + 2 + frame.height)
    if "empty_lines" in facts:
        row_numbers = kept + skip_rows + 2
    if dialect.units_row and frame.height:
        row = {name: frame[column][0] for name, column in columns.items()}
        units_by_name |= _units(source, row, numeric, int(row_numbers[0]))
        frame, row_numbers = frame[1:], row_numbers[1:]
    return Table(
        source,
        "csv",
        names,
        frame.height,
        lambda name: frame[columns[name]],
        numbers=row_numbers,
        parsed=True,
        decimal_comma=dialect.decimal_comma,
        units_row=not dialect.units_row,
        facts=facts,
        units=units_by_name,
    )


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


def _beginning(head: str, dialect: Dialect) -> tuple[int, str | None]:
    """Lines in front of the headings, empty ones and Excel's `sep=;` included; and the separator, where known."""
    skip_rows, separator = dialect.skip_rows, dialect.separator
    lines = list(itertools.islice(io.StringIO(head, newline=None), 1 + skip_rows + 1_000))
    for place in dict.fromkeys((0, skip_rows)):
        match = _EXCEL_SEPARATOR.fullmatch(lines[place].rstrip("\n")) if place < len(lines) else None
        if match is not None:
            separator = separator or match[1]
            skip_rows += place == skip_rows
            break
    blank = "".join(SEPARATORS) + ' "\r\n'
    while skip_rows < len(lines) and not lines[skip_rows].strip(blank):
        skip_rows += 1
    return skip_rows, separator


def _lines(head: str, skip_rows: int) -> list[str]:
    return list(itertools.islice(io.StringIO(head, newline=None), skip_rows, skip_rows + 100))


def _separator(lines: Sequence[str], hints: set[str], parts: Callable[[str], tuple[str, str]]) -> str:
    def merit(separator: str) -> tuple[int, int]:
        headings = _first_record(lines, separator)
        return len(hints & {parts(heading)[0] for heading in headings}), len(headings)

    return max(SEPARATORS, key=merit)


def _first_record(lines: Sequence[str], separator: str) -> list[str]:
    try:
        return [heading.strip() for heading in next(csv.reader(lines, delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def _frame(
    source: str,
    content: Path | io.BytesIO,
    separator: str,
    skip_rows: int,
    headings: Sequence[str],
    numbers: set[str],
) -> pl.DataFrame:
    """All columns: `numbers` parsed where each of their cells allows it, else everything as text."""
    options: dict[str, Any] = {"separator": separator, "skip_lines": skip_rows, "infer_schema": False, "glob": False}
    overrides = {"schema_overrides": dict.fromkeys(numbers, pl.Float64)}
    attempts: list[dict[str, Any]] = [overrides, {}] if numbers else [{}]
    for attempt in attempts:
        if isinstance(content, io.BytesIO):
            content.seek(0)
        try:
            frame = pl.read_csv(content, **options, **attempt)
            if attempt is attempts[-1] or all(_is_exact(frame[name]) for name in attempt["schema_overrides"]):
                return frame
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            if attempt is attempts[-1]:
                _explain(source, content, separator, skip_rows, len(headings))
                raise
    raise AssertionError("the last attempt returns or raises")


def _is_exact(column: pl.Series) -> bool:
    """Whether float64 holds what the column's cells may have written, however many digits."""
    return column.len() == column.null_count() or float(column.abs().max() or 0.0) <= _LARGEST_DOUBLE  # type: ignore[arg-type]


def _empty(frame: pl.DataFrame) -> np.ndarray:
    """[rows] bool: nothing but blanks in any cell."""
    empty = np.ones(frame.height, bool)
    for column in frame.iter_columns():
        blank = column.is_null()
        if column.dtype == pl.String:
            blank |= (column.str.strip_chars() == "").fill_null(True)
        empty &= blank.to_numpy().astype(bool)
        if not empty.any():
            break
    return empty


def _units(source: str, row: dict[str, Any], numeric: Sequence[str], number: int) -> dict[str, str]:
    """The unit of each column by name, from the row under the headings; its brackets are left away."""
    read = [name for name in numeric if _is_number(row.get(name))]
    if read and len(read) == len(numeric):
        raise DatasetError(
            f"{source}: row {number} should hold the units, but it holds a number in each column "
            f"({', '.join(map(repr, read[:5]))}); leave out units_row=True"
        )
    texts = {name: str(text or "").strip() for name, text in row.items()}
    return {name: re.sub(r"^[\[(](.*)[\])]$", r"\1", text) for name, text in texts.items() if text}


def _is_number(text: str | None) -> bool:
    try:
        float((text or "").replace(",", "."))
    except ValueError:
        return False
    return True


def _explain(source: str, content: Path | io.BytesIO, separator: str, skip_rows: int, width: int) -> None:
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
