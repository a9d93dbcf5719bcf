"""What the text in a cell stands for: a number, a word for yes or no, a date, a time of day, a duration."""

import re

import polars as pl

from odaf.data.readers.table_cells import MISSING, Cells, mask_of, refuse

# Excel writes yes and no in the language it is set to.
TRUE = ("true", "t", "yes", "y", "on", "wahr", "vrai")
FALSE = ("false", "f", "no", "n", "off", "falsch", "faux")

# 1.234 and 1.234.567,8: with a decimal comma the points part thousands, without one they do not.
_THOUSANDS = r"^[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?$"
_NUMBER = r"[+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?"
_NUMBER_WITH_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
# `3 days 01:02:03.5` as data frames write it, `01:02:03.5`, `01:02`, and `PT1H2M3.5S` as in ISO 8601.
_CLOCK = r"^([+-])?(?:(\d+) days?,? ?)?(\d+):(\d\d)(?::(\d\d(?:\.\d*)?))?$"
_ISO_DURATION = r"^([+-])?P(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?(?:(\d+(?:\.\d*)?)S)?)?$"
_DATE_PARTS = re.compile(r"%[YyCGgmbBhdejUWVuDFxcs+]")


def text_of(cells: Cells) -> pl.Series:
    """The cells without blanks around them; null where they hold a word for a missing value."""
    text = cells.values.str.strip_chars()
    return text.set(text.str.to_lowercase().is_in(MISSING), None)


def numbers_of(cells: Cells, meaning: str = "number") -> pl.Series:
    """Text as Float64; words for yes and no count as 1 and 0 in a column that holds nothing but these and 0 and 1.

    Raises:
        DatasetError: a cell is neither a number nor missing, or with a decimal comma it may be read in two ways.
    """
    text = text_of(cells)
    result = floats_of(text, cells.decimal_comma)
    wrong = result.is_null() & text.is_not_null()
    if wrong.any():
        flags = flags_of(cells)
        if (flags.is_not_null() | text.is_null()).all():
            return flags.cast(pl.Float64)
        _refuse_numbers(cells, text, wrong, meaning)
    if cells.decimal_comma:
        doubtful = text.str.contains(_THOUSANDS).fill_null(False)
        if doubtful.any():
            refuse(
                cells,
                mask_of(doubtful),
                "is written with a point although the decimal mark is a comma",
                "remove points between thousands",
                "leave out decimal_comma=True if the point is the decimal mark",
            )
    return result


def whole_of(cells: Cells) -> pl.Series | None:
    """Text as Int64 where every cell is a whole number without a decimal mark, or missing; None elsewhere."""
    text = text_of(cells)
    whole = text.cast(pl.Int64, strict=False)
    return whole if bool((whole.is_not_null() | text.is_null()).all()) and not whole.is_null().all() else None


def flags_of(cells: Cells) -> pl.Series:
    """Text as Boolean: words for yes and no, and numbers that are 1 or 0; null elsewhere."""
    text = text_of(cells)
    low = text.str.to_lowercase()
    number = floats_of(text, cells.decimal_comma)
    yes = (low.is_in(TRUE) | (number == 1.0).fill_null(False)).fill_null(False)
    no = (low.is_in(FALSE) | (number == 0.0).fill_null(False)).fill_null(False)
    return yes.set(~(yes | no), None)


def moments_of(cells: Cells, format: str | None) -> pl.Series:
    """Text as Int64 or Float64 seconds where one of its first two cells is a number, else as dates, times, durations.

    Raises:
        DatasetError: a cell is written in another way than the first.
    """
    text = text_of(cells)
    if format is None and floats_of(text.drop_nulls().head(2), cells.decimal_comma).is_not_null().any():
        whole = whole_of(cells)
        return numbers_of(cells, "number of seconds, as others are") if whole is None else whole
    # A comma in front of the fraction, as in 08:00:00,5, is good ISO 8601; the parser knows the point alone.
    text = text.str.replace(r"(:\d\d),(\d)", "${1}.${2}")
    if format is None and (durations := _durations(text)) is not None:
        return durations
    try:
        result = _dates(text, format)
    except pl.exceptions.PolarsError:  # no format fits the first rows
        result = pl.Series([None], dtype=pl.Datetime("us")).new_from_index(0, len(text))
    wrong = result.is_null() & text.is_not_null()
    if wrong.any():
        fact = "cannot be read as a date in ISO 8601" if format is None else f"does not follow time_format {format!r}"
        remedies = ['say how it is written, as in time_format="%d.%m.%Y %H:%M:%S"', "correct the cells"]
        refuse(cells, mask_of(wrong), fact, *remedies)
    return result


def begins_with_a_unit(cells: Cells) -> bool:
    """Whether a number stands in the second row, in whatever spelling, and none in the first, of text."""
    if not cells.units_row or cells.values.dtype != pl.String:
        return False
    first = [re.fullmatch(_NUMBER, (text or "").strip()) for text in cells.values.head(2).to_list()]
    return len(first) == 2 and not first[0] and bool(first[1])


def floats_of(text: pl.Series, decimal_comma: bool) -> pl.Series:
    """Text as Float64; null where it is no number."""
    point = text.str.replace(",", ".", literal=True) if decimal_comma else text
    return point.cast(pl.Float64, strict=False)


def _dates(text: pl.Series, format: str | None) -> pl.Series:
    unit = "ns" if bool(text.str.contains(r"\.\d{7}").any()) else "us"
    if format is None:
        return text.str.to_datetime(strict=False, time_unit=unit)
    # Python's %f is a fraction of a second; the parser's is a count of nanoseconds.
    own = re.sub(r"[.,]%f", "%.f", format).replace("%S,%.f", "%S%.f")
    if _DATE_PARTS.search(own) is None:
        return text.str.to_time(own, strict=False)
    return text.str.to_datetime(own, strict=False, time_unit=unit)


def _durations(text: pl.Series) -> pl.Series | None:
    """Float64 seconds of times of day and durations; None where a cell is neither."""
    for pattern in (_CLOCK, _ISO_DURATION):
        if len(text.drop_nulls()) and bool((text.str.contains(pattern) | text.is_null()).all()):
            parts = [text.str.extract(pattern, group).cast(pl.Float64, strict=False) for group in range(2, 6)]
            days, hours, minutes, seconds = (part.fill_null(0.0) for part in parts)
            total = ((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds
            total = total * (1.0 - 2.0 * text.str.starts_with("-").cast(pl.Float64))
            return total.set(text.is_null(), None)
    return None


def _refuse_numbers(cells: Cells, text: pl.Series, wrong: pl.Series, meaning: str) -> None:
    """Raises with the remedy that fits what stands in the first cell that is no number."""
    first = str(text.filter(wrong)[0])
    remedies = ["correct the cells", "leave the column out"]
    if first.startswith(("[", "(")) and "," in first:
        remedies = ["it looks like a list: write one column for each number, or a Parquet file with a column of lists"]
    elif _NUMBER_WITH_COMMA.fullmatch(first) and not cells.decimal_comma:
        remedies.insert(0, "it looks like a decimal comma: pass decimal_comma=True")
    elif wrong[0] and begins_with_a_unit(cells):
        remedies.insert(0, "pass units_row=True if that row holds units")
    elif re.fullmatch(r"[^\W\d][\w /.#-]*|#\S+", first):
        remedies.insert(1, f'pass missing_values=["{first}"] if it stands for a missing value')
    refuse(cells, mask_of(wrong), f"is not a {meaning}", *remedies)
