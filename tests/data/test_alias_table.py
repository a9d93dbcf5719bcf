"""Tables of aliases: what they draw by is the weights, in whole numbers, for ten million rows too."""

import numpy as np
import pytest

from odaf.data.alias_table import CELL, alias_table, drawn_units, units_of


def test_a_worked_example():
    """Weights 1, 3, 0, 4: cells of size 2. Row 1 fills row 0's cell, row 3 all of row 2's."""
    units = units_of(np.array([1.0, 3.0, 0.0, 4.0]))
    np.testing.assert_array_equal(units, np.array([1, 3, 0, 4]) * CELL // 2)
    kept, alias = alias_table(units)
    np.testing.assert_array_equal(kept, [CELL // 2, 0, 0, 0])  # full cells keep 0 and lead to themselves
    np.testing.assert_array_equal(alias, [1, 1, 3, 3])
    kept, alias = alias_table(units_of(np.array([0.5, 0.5, 0.75, 2.25])))
    np.testing.assert_array_equal(kept, [CELL // 2, CELL // 2, CELL // 4 * 3, 0])
    np.testing.assert_array_equal(alias, [3, 3, 3, 3])


@pytest.mark.parametrize("rows", [1, 2, 3, 10, 1000])
def test_a_table_draws_by_the_weights_to_the_unit(rows):
    rng = np.random.default_rng(rows)
    draws = [
        *(np.exp(spread * rng.normal(size=rows)) for spread in (0.1, 1.0, 3.0, 8.0)),
        rng.integers(1, 3, rows) * 1.0,
        np.repeat([1.0, 1e-3, 0.0], rows),
        np.repeat(1.0, rows),
    ]
    for weights in draws:
        units = units_of(weights)
        assert units.sum() == len(weights) * CELL
        exact = weights / weights.sum() * len(weights) * CELL
        np.testing.assert_allclose(units, exact, rtol=1e-12, atol=2.5)
        assert not units[weights == 0.0].any() and units[exact >= 1.0].all()
        kept, alias = alias_table(units)
        np.testing.assert_array_equal(drawn_units(kept, alias), units)


def test_equal_weights_fill_every_cell():
    kept, alias = alias_table(units_of(np.full(7, 0.1)))
    assert not kept.any()
    np.testing.assert_array_equal(alias, np.arange(7))


def test_ten_million_rows_are_all_within_reach():
    """One row in ten is eleven times as likely as the others; a random number in float32 has but 8 million values."""
    rows = 10_000_000
    units = np.full(rows, CELL // 2, np.int64)
    units[::10] = CELL // 2 * 11
    kept, alias = alias_table(units)
    np.testing.assert_array_equal(drawn_units(kept, alias), units)
