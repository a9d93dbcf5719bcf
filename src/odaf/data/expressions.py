"""Formulas over the columns of a table, such as `1 - abs(level - setpoint)`.

They are written as SQL writes them and computed by polars in double precision, row by row. Only numbers, column names,
arithmetic, comparisons, `case when` and a list of functions exist: a formula runs no code, opens no file, and sees no
other row than its own.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from odaf.errors import DatasetError

FUNCTIONS = (
    *("abs", "sign", "sqrt", "cbrt", "exp", "ln", "log", "log2", "log10", "log1p", "pow", "power", "mod"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "degrees", "radians", "pi"),
    *("floor", "ceil", "ceiling", "round", "greatest", "least", "if"),
)
KEYWORDS = ("case", "when", "then", "else", "end", "and", "or", "not", "between", "in", "true", "false")

_OVER_ROWS = {"max": "greatest(a, b)", "min": "least(a, b)"}
_LONGEST = 1_000
_TOKEN = re.compile(
    r"""\s*(?:
    (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w"`]))
    |(?P<name>[^\W\d]\w*)
    |"(?P<quoted>(?:[^"]|"")+)"
    |`(?P<ticked>[^`]+)`
    |(?P<mark><=|>=|<>|!=|==|[-+*/%(),<>=])
    )""",
    re.VERBOSE,
)
_NAMED = re.compile(r"\s*([^\W\d]\w*)\s*=(?!=)(.+)", re.DOTALL)


def looks_like_one(text: str) -> bool:
    """Whether a text that is no column's name is meant as a formula, and not as the name of a column."""
    return re.search(r"""[-+*/%()<>=`"]""", text) is not None or re.fullmatch(r"\s*case\s.*", text, re.I) is not None


def named(text: str) -> tuple[str, str] | None:
    """("level_error", "level - setpoint") for `level_error = level - setpoint`; None for what has no such form."""
    match = _NAMED.fullmatch(text)
    return None if match is None else (match[1], match[2].strip())


@dataclass(frozen=True)
class Expression:
    """A formula that was read and found to be one.

    Attributes:
        text: as the user wrote it.
        columns: names of the columns it takes, each once.
        query: as polars reads it, every column in quotes.
    """

    text: str
    columns: tuple[str, ...]
    query: str

    def __call__(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """[rows] float64; NaN in rows where a column it takes is NaN.

        Args:
            values: [rows] float64 by column, equally long.

        Raises:
            DatasetError: it cannot be computed, as where a text stands for a number.
        """
        frame = pl.DataFrame({name: np.asarray(values[name], np.float64) for name in self.columns})
        try:
            # Not lazily, and without another expression for nulls: one row at work takes a third of the time so.
            result = frame.select(pl.sql_expr(self.query).cast(pl.Float64).alias("result"))["result"]
        except pl.exceptions.PolarsError as error:
            first = str(error).strip().partition("\n")[0]
            raise DatasetError(f"expression '{self.text}': cannot be computed ({first[:120]}); correct it") from error
        array = result.to_numpy()  # nulls become NaN
        missing = np.logical_or.reduce([np.isnan(values[name]) for name in self.columns])
        return np.where(missing, np.nan, array)


def parse(text: str, columns: Sequence[str] | None = None) -> Expression:
    """The formula in a text.

    Args:
        text: such as `1 - abs(level - setpoint)`; names that are no plain words stand in double quotes.
        columns: the names there are; None takes every name for one.

    Raises:
        DatasetError: it is no formula, or names a column or a function that there is not.
    """
    if len(text) > _LONGEST:
        raise DatasetError(f"expression '{text[:40]}...': is {len(text):,} characters long; {_LONGEST:,} are allowed")
    taken: dict[str, None] = {}
    words, place, operand = [], 0, False
    around: list[str] = []  # the functions whose brackets are open
    tokens: list[re.Match[str]] = []
    while text[place:].strip():
        match = _TOKEN.match(text, place)
        if match is None:
            raise DatasetError(
                f"expression '{text}': cannot be read from '{text[place:].strip()[:20]}' on; write numbers, columns "
                "(in double quotes where the name is no plain word), + - * / % ( ), comparisons and "
                f"{', '.join(FUNCTIONS[:4])}, ..."
            )
        tokens.append(match)
        place = match.end()
    for index, token in enumerate(tokens):
        name = token["name"]
        called = index + 1 < len(tokens) and tokens[index + 1]["mark"] == "("
        follows, operand = operand, token["mark"] is None and (name or "").lower() not in KEYWORDS
        if follows and operand:
            raise DatasetError(
                f"expression '{text}': nothing stands between '{tokens[index - 1][0].strip()}' and "
                f"'{token[0].strip()}'; put names that hold blanks in double quotes"
            )
        if name is not None and (name.lower() in KEYWORDS or (called and name.lower() in FUNCTIONS)):
            words.append(name.lower())
        elif name is not None and called:
            _refuse_function(text, name)
        elif token["number"]:
            # 1 / 2 is a half, not the whole number 0; only digits to round to must stay whole.
            whole = token["number"].isdigit() and around[-1:] != ["round"]
            words.append(f"{token['number']}.0" if whole else token["number"])
        elif token["mark"]:
            words.append(token["mark"])
            if token["mark"] == "(":
                around.append((tokens[index - 1]["name"] or "").lower() if index else "")
            elif token["mark"] == ")" and around:
                around.pop()
        else:
            column = name or token["ticked"] or token["quoted"].replace('""', '"')
            if columns is not None and column not in columns:
                _refuse_column(text, column, columns)
            taken[column] = None
            words.append('"' + column.replace('"', '""') + '"')
    if not taken:
        raise DatasetError(
            f"expression '{text}': names no column; write a reward that is the same in every row as reward=0.0"
        )
    query = " ".join(words)
    try:
        pl.sql_expr(query)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        first = str(error).strip().partition("\n")[0]
        raise DatasetError(f"expression '{text}': is not complete ({first[:120]}); correct it") from error
    return Expression(text, tuple(taken), query)


def _refuse_function(text: str, name: str) -> None:
    instead = _OVER_ROWS.get(name.lower())
    hint = f"it would look at other rows; for the larger or smaller of several numbers write {instead}"
    if instead is None:
        nearest = difflib.get_close_matches(name.lower(), FUNCTIONS, n=1)
        hint = (f"did you mean {nearest[0]}? " if nearest else "") + f"there are {', '.join(FUNCTIONS)}"
    raise DatasetError(f"expression '{text}': function {name} is unknown; {hint}")


def _refuse_column(text: str, column: str, columns: Sequence[str]) -> None:
    nearest = difflib.get_close_matches(column, columns, n=1)
    hint = f"did you mean '{nearest[0]}'? " if nearest else ""
    shown = ", ".join(repr(other) for other in columns[:40]) + (", ..." if len(columns) > 40 else "")
    raise DatasetError(f"expression '{text}': column '{column}' not found; {hint}the table has {shown or 'no columns'}")
