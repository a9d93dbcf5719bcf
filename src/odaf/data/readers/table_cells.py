"""The cells of one column as its source holds them, and how what is wrong with them is said.

Each refusal names the table, the column, the rows and the remedy.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, NoReturn

import numpy as np
import polars as pl

from odaf.data.validation import RowNumbers, name_rows
from odaf.errors import DatasetError

OnMissing = Literal["error", "break", "nan"]

# Text that stands for a missing value in every text table, in small letters.
MISSING = ("", "na", "n/a", "null", "none", "nan")


@dataclass(frozen=True)
class Cells:
    """One column as its source holds it.

    Attributes:
        source: how messages name the table.
        name: the column's name.
        values: the cells; those that hold a word of `missing_values` are null.
        numbers: the rows' numbers in the source, as messages give them.
        parsed: whether text may stand for numbers, flags and times, as in CSV.
        decimal_comma: whether such text writes 1,5 for one and a half.
        units_row: whether the first row may turn out to hold units, which the message then says.
        place: names a row by its file too, given its place in the column.
    """

    source: str
    name: str
    values: pl.Series
    numbers: RowNumbers
    parsed: bool = False
    decimal_comma: bool = False
    units_row: bool = False
    place: Callable[[int], str] | None = None


@dataclass
class Holes:
    """Rows in which a value is missing.

    Attributes:
        rows: how many rows there are.
        by_column: [rows] bool by column, for those columns that miss some value.
    """

    rows: int
    by_column: dict[str, np.ndarray] = field(default_factory=dict)

    def mark(self, name: str, missing: np.ndarray) -> None:
        """Notes the rows in which a column has no value."""
        if missing.any():
            self.by_column[name] = self.by_column.get(name, np.zeros(self.rows, bool)) | missing

    def mask(self) -> np.ndarray:
        """[rows] bool: whether any column misses its value."""
        return np.logical_or.reduce([np.zeros(self.rows, bool), *self.by_column.values()])


def without(values: pl.Series, missing_values: Sequence[str]) -> pl.Series:
    """`values` with null in place of what the caller says stands for a missing value.

    Text is compared without regard to case and surrounding blanks, and words that are numbers with numbers too.
    """
    if not missing_values:
        return values
    words = [word.strip().lower() for word in missing_values]
    marks = pl.Series(words, dtype=pl.String).cast(pl.Float64, strict=False).drop_nulls().implode()
    if values.dtype in (pl.Categorical, pl.Enum):
        values = values.cast(pl.String)
    if values.dtype == pl.String:
        text = values.str.strip_chars().str.to_lowercase()
        return values.set((text.is_in(words) | text.cast(pl.Float64, strict=False).is_in(marks)).fill_null(False), None)
    if is_plain(values.dtype) and values.dtype != pl.Boolean:
        return values.set(values.cast(pl.Float64).is_in(marks).fill_null(False), None)
    return values


def is_plain(dtype: object) -> bool:
    """Whether cells of this type are numbers or bool."""
    return isinstance(dtype, pl.DataType) and (dtype.is_numeric() or dtype == pl.Boolean)


def is_wide(dtype: object) -> bool:
    """Whether cells are whole numbers of 128 bits, which NumPy does not have."""
    return str(dtype) in ("Int128", "UInt128")


def mask_of(marked: pl.Series) -> np.ndarray:
    """[rows] bool."""
    return marked.to_numpy().astype(bool)


def missing_in(values: pl.Series) -> np.ndarray:
    """[rows] bool: null or NaN, told from the values themselves and not from what a file says of them."""
    missing = mask_of(values.is_null())
    if values.dtype.is_float():
        missing |= np.isnan(values.to_numpy())
    return missing


def refuse_missing(cells: Cells, values: pl.Series, remedy: str, holes: Holes | None = None) -> np.ndarray:
    """[rows] bool: which values are missing. Raises where some are, unless `holes` takes note of them."""
    missing = missing_in(values)
    if missing.any():
        if holes is None:
            refuse(cells, missing, "has no value", remedy, 'pass on_missing="break" to leave such rows out')
        holes.mark(cells.name, missing)
    return missing


def refuse_type(cells: Cells, rule: str = "convert the column to numbers, or leave it out") -> NoReturn:
    """Raises because the column's type is none that its meaning allows."""
    kind = (
        "text" if cells.values.dtype in (pl.String, pl.Categorical, pl.Enum) else f"cells of type {cells.values.dtype}"
    )
    known = cells.values.is_not_null().to_numpy().astype(bool)
    marked = known if known.any() else ~known
    refuse(cells, marked, f"holds {kind}, not numbers", rule)


def refuse(cells: Cells, rows: np.ndarray, fact: str, *remedies: str) -> NoReturn:
    """Raises `DatasetError` with the first of the marked rows and what stands there."""
    index = int(np.flatnonzero(rows)[0])
    value = cells.values[index]
    if isinstance(value, pl.Series):
        value = value.to_list()
    details = [] if value is None else [_short(repr(value))]
    details += [] if cells.place is None else [cells.place(index)]
    shown = f" ({', '.join(details)})" if details else ""
    raise DatasetError(
        f"{cells.source}: column '{cells.name}' {fact} in {name_rows(rows, cells.numbers)}{shown}", remedies=remedies
    )


def _short(text: str, limit: int = 40) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."
