"""Formulas: what they compute, and what is none."""

import math

import numpy as np
import pytest

from odaf.data import expressions
from odaf.errors import DatasetError

NAMES = ("level", "setpoint", "flow rate", 'say "x"', "end", "select")
VALUES = {
    "level": np.array([1.0, 2.5, -3.0]),
    "setpoint": np.array([2.0, 2.0, 2.0]),
    "flow rate": np.array([0.5, 1.0, 4.0]),
    'say "x"': np.array([7.0, 8.0, 9.0]),
    "end": np.array([0.0, 0.0, 1.0]),
    "select": np.array([5.0, 6.0, 7.0]),
}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 - abs(level - setpoint)", [0.0, 0.5, -4.0]),
        ("-level", [-1.0, -2.5, 3.0]),
        ("level -- 1", [2.0, 3.5, -2.0]),
        ("level * 1e-3 + .5", [0.501, 0.5025, 0.497]),
        ('"flow rate" / 2', [0.25, 0.5, 2.0]),
        ("`flow rate` * 1 / 2", [0.25, 0.5, 2.0]),
        ("1/2 * level", [0.5, 1.25, -1.5]),
        ('"say ""x""" - 7', [0.0, 1.0, 2.0]),
        ('"end" + select', [5.0, 6.0, 8.0]),
        ("case when level > 2 then -1 else 0 end", [0.0, -1.0, 0.0]),
        ("CASE WHEN level >= 1 AND NOT level > 2 THEN 1 WHEN level < 0 THEN -1 END", [1.0, math.nan, -1.0]),
        ("level between 0 and 2", [1.0, 0.0, 0.0]),
        ("level in (1, -3)", [1.0, 0.0, 1.0]),
        ("level = 1 or level <> 2.5", [1.0, 0.0, 1.0]),
        ("greatest(level, 0) + least(setpoint, 1, level)", [2.0, 3.5, -3.0]),
        ("if(level > 0, sqrt(`flow rate`), 0)", [math.sqrt(0.5), 1.0, 0.0]),
        ("pow(level, 2) + power(setpoint, 3)", [9.0, 14.25, 17.0]),
        ("exp(ln(`flow rate`))", [0.5, 1.0, 4.0]),
        ("log(`flow rate`, 2) - log2(`flow rate`)", [0.0, 0.0, 0.0]),
        ("round(level / 3, 1)", [0.3, 0.8, -1.0]),
        ("floor(level) + ceil(level) + ceiling(level)", [3.0, 8.0, -9.0]),
        ("sin(pi() * level / 2)", [1.0, math.sin(1.25 * math.pi), 1.0]),
        ("atan2(level, setpoint)", [math.atan2(1, 2), math.atan2(2.5, 2), math.atan2(-3, 2)]),
        ("sign(level) * mod(setpoint, 3) % 2", [0.0, 0.0, 0.0]),
        ("level > setpoint", [0.0, 1.0, 0.0]),
    ],
)
def test_what_formulas_compute(text: str, expected: list[float]):
    formula = expressions.parse(text, NAMES)
    np.testing.assert_allclose(formula(VALUES), expected, atol=1e-12)
    for row in range(3):  # a row alone gives the same bits
        alone = formula({name: values[row : row + 1] for name, values in VALUES.items()})
        np.testing.assert_array_equal(alone[0], formula(VALUES)[row])


@pytest.mark.parametrize("function", [name for name in expressions.FUNCTIONS if name != "pi"])
def test_every_function_looks_at_its_own_row_alone(function: str):
    arguments = {"log": 2, "pow": 2, "power": 2, "mod": 2, "atan2": 2, "greatest": 2, "least": 2, "if": 3}
    given = ["a > 0.5", "b", "c"] if function == "if" else ["a", "b"][: arguments.get(function, 1)]
    text = f"{function}({', '.join(given)})"
    rng = np.random.default_rng(0)
    values = {name: rng.uniform(0.1, 0.9, 40) for name in "abc"}
    formula = expressions.parse(text, ("a", "b", "c"))
    order = rng.permutation(40)
    shuffled = formula({name: column[order] for name, column in values.items()})
    np.testing.assert_array_equal(shuffled, formula(values)[order])
    assert np.isfinite(shuffled).all()


def test_a_value_that_is_missing_leaves_nothing_to_compute():
    values = {"a": np.array([1.0, np.nan, 3.0]), "b": np.array([1.0, 2.0, np.nan])}
    for text in ("a + b", "greatest(a, b)", "case when a > 0 then b else 1 end", "a in (1, 2) or b > 0"):
        np.testing.assert_array_equal(np.isnan(expressions.parse(text)(values)), [False, True, True])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "1 - abs(levle)",
            r"expression '1 - abs\(levle\)': column 'levle' not found; did you mean 'level'\? the table has",
        ),
        ("level - Setpoint", "column 'Setpoint' not found; did you mean 'setpoint'"),
        ("(select max(level) from log)", "column 'select' not found"),
        ("level - (select 1)", "column 'select' not found"),
        ("level from secrets", "nothing stands between 'level' and 'from'"),
        ("read_csv(level)", "function read_csv is unknown; there are abs"),
        ("max(level)", r"function max is unknown; it would look at other rows; .* write greatest\(a, b\)"),
        ("read_csv('/etc/passwd')", "cannot be read from"),
        ("level + 'text'", "cannot be read from ''text'' on"),
        ("sum(level)", "function sum is unknown"),
        ("lag(level)", "function lag is unknown; did you mean log"),
        ("min(level, 1)", r"function min is unknown; .* write least\(a, b\)"),
        ("row_number() over ()", "function row_number is unknown"),
        ("count(*)", "function count is unknown"),
        ("level; drop", "cannot be read from '; drop' on"),
        ("level::int", "cannot be read from '::int' on"),
        ("level ** 2", "is not complete"),
        ("level ^ 2", "cannot be read from"),
        ("level -", "is not complete"),
        ("abs(level", "is not complete"),
        (
            "level setpoint",
            "nothing stands between 'level' and 'setpoint'; put names that hold blanks in double quotes",
        ),
        ("level, setpoint", "is not complete"),
        ("*", "names no column"),
        ("1 + 1", "names no column; write a reward that is the same in every row as reward=0.0"),
        ("", "names no column"),
        ("level is null", "nothing stands between"),
        ("cast(level as int)", "function cast is unknown"),
        ("12level", "cannot be read from '12level' on"),
        ("level -- " + "x" * 2000, "is 2,0.. characters long; 1,000 are allowed"),
        ("(" * 400 + "level" + ")" * 400, "is not complete|recursion"),
    ],
)
def test_what_is_no_formula(text: str, message: str):
    with pytest.raises(DatasetError, match=message):
        expressions.parse(text, ("level", "setpoint"))


def test_random_texts_are_formulas_or_our_errors():
    rng = np.random.default_rng(0)
    pieces = [
        "level",
        "setpoint",
        "1",
        ".5e3",
        "+",
        "-",
        "*",
        "/",
        "%",
        "(",
        ")",
        ",",
        "abs",
        "case",
        "when",
        "then",
        "end",
    ]
    pieces += [
        "else",
        "and",
        "in",
        "<",
        "=",
        "select",
        "from",
        "max",
        '"',
        "`",
        "'",
        ";",
        "[",
        "é",
        "if",
        "pow",
        "::",
        "\n",
    ]
    computed = 0
    for _ in range(1_500):
        text = " ".join(rng.choice(pieces, rng.integers(1, 9)))
        try:
            values = expressions.parse(text, ("level", "setpoint"))({n: VALUES[n] for n in ("level", "setpoint")})
        except DatasetError as error:
            assert "expression '" in str(error)
            continue
        assert values.shape == (3,) and values.dtype == np.float64
        computed += 1
    assert computed > 10


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("error = level - setpoint", ("error", "level - setpoint")),
        ("error=level=1", ("error", "level=1")),
        ("level", None),
        ("level == 1", None),
        ("level >= 1", None),
        ("2x = level", None),
    ],
)
def test_formulas_with_a_name(text: str, expected: tuple[str, str] | None):
    assert expressions.named(text) == expected
