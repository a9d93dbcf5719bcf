"""The one fit: its steps against NumPy, what batches are drawn from, early stopping, and what is compiled again."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from compilations import counted
from odaf.components import fitting
from odaf.components.fitting import EarlyStopping, bootstrap_rows, fit, of_rows
from odaf.errors import DivergenceError


class Line(eqx.Module):
    """y = weight * x + offset."""

    weight: jax.Array
    offset: jax.Array


def line(weight: float = 0.5, offset: float = 0.1) -> Line:
    """A model of two numbers."""
    return Line(jnp.asarray(weight), jnp.asarray(offset))


def squared_error(model: Line, batch, key):
    """The mean squared error, and how many distinct numbers the batch has on either end."""
    del key
    x, y = batch
    error = jnp.mean(jnp.square(model.weight * x + model.offset - y))
    return error, {"least": jnp.min(x), "most": jnp.max(x)}


def error_of_rows(model: Line, batch):
    """The squared error of each row."""
    return jnp.square(model.weight * batch[0] + model.offset - batch[1])


def chase(model: Line, batch, key, slow: Line):
    """Leads a weight away from its own slow copy."""
    del batch, key
    return jnp.square(model.weight - slow.weight - 1.0), {}


def members_mean(model: Line, batch, key):
    """The two members' batches, as figures."""
    del key
    return jnp.square(model.weight), {"first": jnp.mean(batch[0][0]), "second": jnp.mean(batch[0][1])}


def members_error(model: Line, batch, key):
    """The members' squared errors, each on its own batch."""
    del key
    x, y = batch
    return jnp.sum(jnp.mean(jnp.square(model.weight[:, None] * x + model.offset[:, None] - y), axis=1)), {}


SAME_ROWS = (jnp.full(8, 2.0), jnp.full(8, 3.0))  # so that it does not matter which are drawn
GIVEN = {"steps": 3, "batch_size": 4, "learning_rate": 0.1, "key": jr.key(0), "what": "line", "remedy": "lower it"}
QUIET = {**GIVEN, "progress": lambda done, steps: None}


def _adam(gradient, start, rates):
    """Adam by its definition, in NumPy."""
    value, first, second = np.array(start, float), 0.0, 0.0
    path = [value]
    for step, rate in enumerate(rates, start=1):
        slope = gradient(path)
        first, second = 0.9 * first + 0.1 * slope, 0.999 * second + 0.001 * slope**2
        value = value - rate * first / (1 - 0.9**step) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
        path.append(value)
    return value


@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_steps_are_adams_and_a_cosine_ends_at_zero(schedule):
    calls = []
    # three stretches, the last one shorter
    found = fit(
        line(),
        squared_error,
        SAME_ROWS,
        **{**GIVEN, "steps": 5},
        schedule=schedule,
        stretch=2,
        progress=lambda *done: calls.append(done),
    )
    rates = [0.1 * (0.5 * (1 + np.cos(np.pi * step / 5)) if schedule == "cosine" else 1.0) for step in range(5)]

    def gradient(path):
        error = 2.0 * path[-1][0] + path[-1][1] - 3.0
        return 2.0 * error * np.array([2.0, 1.0])

    np.testing.assert_allclose([found.model.weight, found.model.offset], _adam(gradient, [0.5, 0.1], rates), rtol=1e-5)
    before = _adam(gradient, [0.5, 0.1], rates[:4])
    assert found.means["loss"] == pytest.approx((2.0 * before[0] + before[1] - 3.0) ** 2, rel=1e-4), "of step 5 alone"
    assert calls == [(2, 5), (4, 5), (5, 5)] and found.steps == 5 and found.error is None


def test_only_what_is_trainable_moves_and_the_given_model_can_still_be_used():
    start = line()
    found = fit(start, squared_error, SAME_ROWS, trainable=Line(True, False), **QUIET).model  # type: ignore[arg-type]
    assert float(found.offset) == pytest.approx(0.1) and float(found.weight) > 0.7
    assert float(start.weight) == 0.5


def test_the_loss_sees_a_slow_copy_where_one_is_kept():
    found = fit(line(0.0, 0.0), chase, SAME_ROWS, slow_rate=0.25, **{**QUIET, "steps": 4}).model

    def gradient(path):
        slow = path[0]
        for value in path[1:]:
            slow = 0.75 * slow + 0.25 * value
        return 2.0 * (path[-1] - slow - 1.0)

    assert float(found.weight) == pytest.approx(_adam(gradient, 0.0, [0.1] * 4), rel=1e-4)


def test_weights_decay_apart_from_adam_and_what_is_returned_may_be_an_average():
    """AdamW by its definition; after step t the average keeps min( 0.9999, (1 + t) / (10 + t) ) of itself."""
    found = fit(
        line(), squared_error, SAME_ROWS, schedule="cosine", weight_decay=0.5, averages=True, stretch=2, **QUIET
    )
    rates = [0.1 * 0.5 * (1 + np.cos(np.pi * step / 3)) for step in range(3)]
    value, first, second = np.array([0.5, 0.1]), 0.0, 0.0
    average = value
    for step, rate in enumerate(rates, start=1):
        slope = 2.0 * (2.0 * value[0] + value[1] - 3.0) * np.array([2.0, 1.0])
        first, second = 0.9 * first + 0.1 * slope, 0.999 * second + 0.001 * slope**2
        adam = first / (1 - 0.9**step) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
        value = value - rate * 0.5 * value - rate * adam
        kept = min(0.9999, (1 + step) / (10 + step))
        average = kept * average + (1 - kept) * value
    np.testing.assert_allclose([found.model.weight, found.model.offset], average, rtol=1e-5)


def test_batches_come_from_the_first_rows_alone():
    columns = (jnp.arange(100.0), jnp.zeros(100))
    means = fit(line(0.0, 0.0), squared_error, columns, rows=3, **{**QUIET, "batch_size": 200}).means
    assert (means["least"], means["most"]) == (0.0, 2.0), "all of the first three and no other"
    means = fit(line(0.0, 0.0), squared_error, columns, **{**QUIET, "batch_size": 2000}).means
    assert (means["least"], means["most"]) == (0.0, 99.0), "all rows unless told otherwise"


def test_each_member_draws_from_its_own_rows():
    columns = (jnp.arange(6.0),)
    own = jnp.asarray([4, 4, 1, 1, -1, -1])  # two rows a member, and what is left over
    found = fit(line(), members_mean, columns, rows=2, bootstraps=own, members=2, **QUIET)
    assert (found.means["first"], found.means["second"]) == (4.0, 1.0)

    sample = np.asarray(bootstrap_rows(jr.key(0), 3, rows=50, among=60))
    assert sample.shape == (180,) and sample.min() >= 0 and sample.max() < 50
    parts = sample[:150].reshape(3, 50)
    # a sample with replacement of n rows has about 0.63 n different ones; 0.45 and 0.8 are five deviations away
    assert all(0.45 < len(set(part)) / 50 < 0.8 for part in parts)
    assert not np.array_equal(parts[0], parts[1])


def test_a_part_of_an_ensemble_is_fitted_as_among_all():
    members, rows = 4, 30
    columns = tuple(jr.normal(key, (rows,)) for key in jr.split(jr.key(1)))
    table = bootstrap_rows(jr.key(2), members, rows, rows)
    ensemble = Line(jnp.linspace(-1.0, 1.0, members), jnp.zeros(members))

    def fitted(first, last):
        some = jax.tree.map(lambda leaf: leaf[first:last], ensemble)
        settings = {**QUIET, "steps": 5, "bootstraps": table, "rows": rows, "members": last - first}
        return fit(some, members_error, columns, part_of=(first, members), **settings).model

    whole = fitted(0, members)
    for first, last in ((0, 1), (1, 3), (3, 4)):
        for part, known in zip(jax.tree.leaves(fitted(first, last)), jax.tree.leaves(whole), strict=True):
            np.testing.assert_allclose(part, known[first:last], rtol=1e-6)


def test_early_stopping_keeps_the_best_and_stops_after_so_many_checks_without_a_better_one():
    # the rows to train on want a weight of 1, those held out want 0.3; the weight grows by about 0.01 a step
    columns = (jnp.ones(6), jnp.asarray([1.0, 1.0, 1.0, 1.0, 0.3, 0.3]))
    stopping = EarlyStopping(error_of_rows, first=4, last=6, patience=3)
    trainable = Line(True, False)  # type: ignore[arg-type]
    calls = []
    found = fit(
        line(0.0, 0.0),
        squared_error,
        columns,
        rows=4,
        trainable=trainable,
        stopping=stopping,
        stretch=10,
        **{**GIVEN, "steps": 1000, "learning_rate": 0.01},
        progress=lambda *done: calls.append(done),
    )
    assert found.steps == 60, "the lowest error is met after 30 steps, and three checks are waited for"
    assert calls[-1] == (60, 1000)
    assert float(found.model.weight) == pytest.approx(0.3, abs=0.02)
    assert found.error == pytest.approx((float(found.model.weight) - 0.3) ** 2, rel=1e-4)


def test_a_function_of_rows_is_worked_through_in_blocks(monkeypatch):
    monkeypatch.setattr(fitting, "BLOCK", 7)
    columns = (jnp.arange(33.0), jnp.zeros(33))

    def value(model: Line, batch):
        return model.weight * batch[0]

    np.testing.assert_array_equal(of_rows(value, line(2.0), columns), 2.0 * np.arange(33.0))
    np.testing.assert_array_equal(of_rows(value, line(2.0), columns, 5, 32), 2.0 * np.arange(5.0, 32.0))


def test_a_loss_that_is_not_finite_is_an_error():
    with pytest.raises(DivergenceError, match="line: the training loss is not finite after 3 steps; lower it"):
        fit(line(), squared_error, (jnp.full(8, jnp.inf), jnp.zeros(8)), **QUIET)


def test_another_key_number_of_steps_and_of_rows_step_size_and_data_compile_nothing():
    def once(key: int, steps: int, rows: int, rate: float, factor: float) -> None:
        columns = tuple(factor * column for column in SAME_ROWS)
        own = bootstrap_rows(jr.key(key), 2, rows, 8)
        stopping = EarlyStopping(error_of_rows, first=rows, last=8, patience=2)
        given = {**QUIET, "steps": steps, "learning_rate": rate, "key": jr.key(key)}
        fit(line(), squared_error, columns, rows=rows, stopping=stopping, schedule="cosine", stretch=5, **given)
        fit(line(), squared_error, columns, rows=rows, bootstraps=own, members=2, stretch=5, **given)

    once(0, 10, 5, 0.1, 1.0)
    with counted() as programs:
        once(1, 15, 6, 0.2, 3.0)
    assert not programs
    with counted() as programs:  # the count can fail
        fit(line(), squared_error, tuple(jnp.ones(9) for _ in range(2)), **QUIET)
    assert programs
