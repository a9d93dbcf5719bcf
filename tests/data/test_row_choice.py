"""Rows drawn by the return of their episode, or from the best episodes alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy import stats

from odaf.algorithms.numbers import changed
from odaf.data import Dataset, Normaliser, Transitions, sample, training_columns
from odaf.data.between_episodes import between_episodes
from odaf.data.mixture import Mixture
from odaf.data.row_choice import (
    RowChoice,
    chosen_episodes,
    effective_rows,
    episode_merits,
    episode_weights,
    for_log,
    log_weights,
)
from odaf.data.sampling import Slab, WeightedColumns, row_weights, training_column_shapes
from odaf.data.view import View
from odaf.errors import ConfigError, DatasetError

BY_RETURN = RowChoice(sampling="return", return_temperature=0.5)


def log(returns, lengths, **fields):
    """Episodes of these returns; the observation of row i says i."""
    rows = int(np.sum(lengths))
    count = np.arange(rows, dtype=np.float32)
    last = np.cumsum(lengths) - 1
    ends = np.isin(np.arange(rows), last)
    rewards = np.repeat(np.divide(returns, lengths), lengths)
    return Dataset.from_arrays(
        count[:, None], np.zeros((rows, 1)), rewards, count[:, None] + 0.5, truncated=ends, action_bounds=(-1.0, 1.0),
        **fields,
    )  # fmt: skip


def columns_of(dataset, choice, **view):
    return training_columns(dataset, Normaliser.identity(1), View(choice=choice, **view))


def rows_of(batch):
    return np.asarray(batch.observations)[:, 0].astype(int)


@pytest.mark.parametrize(
    ("share", "of", "chosen"),
    [
        # returns 5, 9, 9, -1 with 4, 2, 3, 1 rows: by return 1, 2 (a tie: the earlier first), 0, 3
        (0.1, "rows", [1]),
        (0.2, "rows", [1]),
        (0.21, "rows", [1, 2]),
        (0.5, "rows", [1, 2]),
        (0.51, "rows", [0, 1, 2]),
        (0.9, "rows", [0, 1, 2]),
        (1.0, "rows", [0, 1, 2, 3]),
        (0.1, "episodes", [1]),
        (0.5, "episodes", [1, 2]),
        (0.51, "episodes", [0, 1, 2]),
    ],
)
def test_the_best_episodes_are_taken_whole_until_they_hold_the_share(share, of, chosen):
    choice = RowChoice(sampling="best", best_share=share, best_of=of)
    found = chosen_episodes(np.array([5.0, 9.0, 9.0, -1.0]), np.array([4, 2, 3, 1]), choice)
    np.testing.assert_array_equal(found, chosen)
    columns = columns_of(log([5.0, 9.0, 9.0, -1.0], [4, 2, 3, 1]), choice)
    assert isinstance(columns, Transitions)
    starts = [0, 4, 6, 9, 10]
    expected = np.concatenate([np.arange(starts[episode], starts[episode + 1]) for episode in chosen])
    np.testing.assert_array_equal(columns.observations[:, 0], expected)


def test_weights_by_return_are_those_of_the_formula():
    """exp(g / 0.5) with g = 0, 1/4, 1 of returns -3, -2, 1, and 1 for the best."""
    expected = np.exp([-2.0, -1.5, 0.0])
    np.testing.assert_allclose(episode_weights(np.array([-3.0, -2.0, 1.0]), BY_RETURN), expected, rtol=1e-14)
    weights = row_weights(log([-3.0, -2.0, 1.0], [2, 1, 3]), View(choice=BY_RETURN))
    np.testing.assert_allclose(weights, np.repeat(expected, [2, 1, 3]), rtol=1e-6)
    assert effective_rows(np.array([1.0, 1.0, 0.0])) == 2.0
    assert effective_rows(np.array([3.0, 1.0])) == pytest.approx(1.6)


def test_returns_are_compared_per_step_where_the_recorder_decided_how_long_episodes_are():
    """Costs of 1, 3 and 2 a row: the fragment of one row has the highest return, a long episode the best rows."""
    dataset = log([-10.0, -3.0, -10.0], [10, 1, 5])
    by_step = RowChoice(sampling="return", return_temperature=0.5, return_per="step")
    expected = np.repeat(np.exp([0.0, -2.0, -1.0]), [10, 1, 5])
    np.testing.assert_allclose(row_weights(dataset, View(choice=by_step)), expected, rtol=1e-6)
    best_fragment = RowChoice(sampling="best", best_share=0.05)
    for choice, rows in ((best_fragment, [10]), (replace(best_fragment, return_per="step"), range(10))):
        best = columns_of(dataset, choice)
        assert isinstance(best, Transitions)
        np.testing.assert_array_equal(best.observations[:, 0], rows)


def starting_at(starts, returns) -> Dataset:
    """Episodes of two rows each, from these first observations on."""
    starts = np.asarray(starts, np.float32)
    rows = np.repeat(starts, 2, axis=0)
    rows[1::2] = -77.0
    ends = np.arange(len(rows)) % 2 == 1
    return Dataset.from_arrays(
        rows, np.zeros((len(rows), 1)), np.repeat(np.divide(returns, 2), 2), rows, truncated=ends,
        action_bounds=(-1.0, 1.0),
    )  # fmt: skip


BY_ADVANTAGE = RowChoice(sampling="advantage", return_temperature=0.5)


def test_weights_by_advantage_forgive_a_bad_start():
    """Returns are 10 x + e over starts x: by return the far starts win, by advantage those of e = 1, wherever."""
    x = np.linspace(-2.0, 2.0, 40)
    bonus = np.tile([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 5)
    dataset = starting_at(np.stack([x, np.ones(40)], axis=1), 10.0 * x + bonus)
    slope, base = np.polyfit(x, 10.0 * x + bonus, 1)
    merits = 10.0 * x + bonus - slope * x - base
    np.testing.assert_allclose(
        episode_merits(dataset, BY_ADVANTAGE), merits, atol=5e-3
    )  # the ridge moves them a little
    expected = np.exp((merits - merits.max()) / np.ptp(merits) / 0.5)
    np.testing.assert_allclose(row_weights(dataset, View(choice=BY_ADVANTAGE)), np.repeat(expected, 2), rtol=2e-2)
    assert expected[bonus == 1.0].min() > expected[bonus == 0.0].max()
    by_return = row_weights(dataset, View(choice=BY_RETURN))
    assert by_return[-1] > by_return[2 * 4]  # the last has no bonus and the best start


def test_returns_that_the_start_says_wholly_draw_all_alike():
    x = np.linspace(-3.0, 5.0, 30)
    dataset = starting_at(x[:, None], 2.0 * x - 1.0)
    np.testing.assert_array_equal(row_weights(dataset, View(choice=BY_ADVANTAGE)), 1.0)


@pytest.mark.parametrize("columns", [3, 60])
def test_starts_that_say_nothing_leave_the_weights_by_return(columns):
    """Of twelve episodes least squares with 60 columns would explain every return, and no row would be preferred."""
    rng = np.random.default_rng(0)
    dataset = starting_at(rng.normal(size=(12, columns)), rng.normal(size=12))
    by_return, by_advantage = (row_weights(dataset, View(choice=choice)) for choice in (BY_RETURN, BY_ADVANTAGE))
    np.testing.assert_allclose(by_advantage, by_return, rtol=1e-12)


BY_LOG = RowChoice(sampling="return", return_temperature="auto")


def within(returns, lengths, spread: float):
    """Episodes of these returns whose rewards go up and down by `spread` from row to row."""
    dataset = log(returns, lengths)
    sign = np.where(np.arange(len(dataset)) % 2 == 0, spread, -spread).astype(np.float32)
    return replace(dataset, rewards=dataset.rewards + sign)


def test_the_temperature_taken_from_the_log_is_a_tenth_over_the_share_of_variance_between_episodes():
    # Rewards 0 and 2 by episode, and 1 up or down by row: a variance of 1 between episodes and of 1 within them.
    dataset = within([0.0, 20.0] * 600, [10] * 1200, 1.0)
    assert between_episodes(dataset.episode_returns(), np.full(1200, 10.0), 2.0) == pytest.approx(0.5)
    found = for_log(dataset, BY_LOG)
    assert found.return_temperature == pytest.approx(0.2, rel=1e-6)
    np.testing.assert_allclose(
        log_weights(dataset, BY_LOG), np.tile(np.repeat([np.exp(-5.0), 1.0], 10), 600), rtol=1e-5
    )
    np.testing.assert_array_equal(row_weights(dataset, View(choice=BY_LOG)), log_weights(dataset, found))
    assert for_log(dataset, BY_RETURN) is BY_RETURN


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_the_more_episodes_differ_the_sharper_and_the_unit_of_the_reward_does_not_matter(scale):
    shares = []
    for spread in (0.0, 1.0, 30.0):
        dataset = within(scale * np.linspace(0.0, 20.0, 1200), [10] * 1200, scale * spread)
        shares.append(effective_rows(row_weights(dataset, View(choice=BY_LOG))) / len(dataset))
    assert shares[0] == pytest.approx(0.2, rel=0.01)  # of returns spread evenly, at 0.1
    assert shares[0] < shares[1] < shares[2] and shares[2] > 0.99


def test_a_tenth_of_a_small_log_is_left_even_if_one_episode_is_far_better():
    dataset = log([0.0] * 99 + [20.0], [10] * 100)
    found = for_log(dataset, BY_LOG)
    assert isinstance(found.return_temperature, float) and found.return_temperature > 0.1
    sharper = replace(found, return_temperature=found.return_temperature / 1.25)
    assert effective_rows(log_weights(dataset, found)) >= 100.0 > effective_rows(log_weights(dataset, sharper))


def test_episodes_that_differ_by_their_length_alone_are_drawn_alike():
    lengths = [5, 50, 500]
    dataset = log(lengths, lengths)
    assert np.ptp(row_weights(dataset, View(choice=BY_LOG))) < 0.02


@pytest.mark.parametrize("returns", [[4.0], [2.0, 2.0, 2.0], [-1e30, -1e30]])
def test_equal_returns_and_a_single_episode_draw_all_alike(returns):
    lengths = [4] * len(returns)
    np.testing.assert_array_equal(row_weights(log(returns, lengths), View(choice=BY_RETURN)), 1.0)
    best = columns_of(log(returns, lengths), RowChoice(sampling="best"))
    assert isinstance(best, Transitions) and best.rewards.shape == (4,)  # of equal ones the first


def test_rows_come_as_often_as_their_weights_say():
    """Chi-square over 60 rows and 60,000 draws at a fixed key; the limit is the 1e-6 quantile on both sides."""
    dataset = log([-5.0, 0.0, 3.0, 5.0, 4.0], [5, 20, 10, 15, 10])
    columns = columns_of(dataset, BY_RETURN)
    rows = rows_of(jax.jit(lambda key: sample(columns, key, 60_000))(jr.key(2)))
    weights = row_weights(dataset, View(choice=BY_RETURN))
    expected = weights / weights.sum() * len(rows)
    statistic = float((np.square(np.bincount(rows, minlength=60) - expected) / expected).sum())
    assert 1e-6 < stats.chi2.sf(statistic, 59) < 1 - 1e-6
    many = jax.vmap(lambda key: sample(columns, key, 16).observations)(jr.split(jr.key(5), 3))
    np.testing.assert_array_equal(many[1], sample(columns, jr.split(jr.key(5), 3)[1], 16).observations)


@pytest.mark.parametrize("choice", [BY_RETURN, RowChoice(sampling="best", best_share=0.6)])
def test_rows_without_a_successor_so_many_steps_later_are_never_drawn(choice):
    dataset = log([1.0, 5.0, 3.0], [4, 6, 5])
    columns = columns_of(dataset, choice, return_steps=3, discount=0.9)
    shapes = training_column_shapes(dataset, View(3, 0.9, choice=choice))
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), columns) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), shapes
    )
    rows = rows_of(sample(columns, jr.key(0), 4000))
    whole = {0, 1} if choice is BY_RETURN else set()
    assert set(rows.tolist()) == {*whole, 4, 5, 6, 7, 10, 11, 12}
    if choice is BY_RETURN:
        assert len(row_weights(dataset, View(3, 0.9, choice=choice))) == 9


APART = {
    "return": RowChoice(sampling="return", return_temperature=0.5, critic_sampling="uniform"),
    "best": RowChoice(sampling="best", best_share=0.3, critic_sampling="uniform"),
}


@pytest.mark.parametrize("sampling", APART)
def test_critics_that_draw_apart_have_the_rows_of_a_uniform_run_and_the_actor_those_chosen(sampling):
    """The actor's rows by chi-square, as above, at 30,000 draws; a row of weight 0 never comes."""
    dataset = log([-5.0, 0.0, 3.0, 5.0, 4.0], [5, 20, 10, 15, 10])
    columns = columns_of(dataset, APART[sampling])
    shapes = training_column_shapes(dataset, View(choice=APART[sampling]))
    assert jax.tree.structure(columns) == jax.tree.structure(shapes)
    batch = jax.jit(lambda key: sample(columns, key, 30_000))(jr.key(2))
    np.testing.assert_array_equal(rows_of(batch), rows_of(sample(columns_of(dataset, RowChoice()), jr.key(2), 30_000)))
    assert batch.actor is not None and batch.for_actor is batch.actor
    rows, weights = rows_of(batch.actor), row_weights(dataset, View(choice=APART[sampling]))
    assert set(rows.tolist()) == set(np.flatnonzero(weights))
    if sampling == "best":
        np.testing.assert_array_equal(weights, np.repeat([0.0, 0.0, 0.0, 1.0, 1.0], [5, 20, 10, 15, 10]))
    seen = weights > 0
    expected = (weights / weights.sum() * len(rows))[seen]
    statistic = float((np.square(np.bincount(rows, minlength=60)[seen] - expected) / expected).sum())
    assert 1e-6 < stats.chi2.sf(statistic, seen.sum() - 1) < 1 - 1e-6
    assert np.corrcoef(rows, rows_of(batch))[0, 1] < 0.05  # of a draw of their own
    assert isinstance(columns, WeightedColumns)
    slab = Slab(jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), columns), jnp.asarray(60), jnp.asarray(60))
    again = sample(slab, jr.key(2), 64)
    alone = sample(columns, jr.key(2), 64)
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(alone), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_best_episodes_without_so_many_steps_are_refused_beside_critics_that_have_them():
    dataset = log([9.0, 1.0], [2, 8])
    with pytest.raises(DatasetError, match="return_steps=3: none of the best episodes has so many steps"):
        columns_of(dataset, RowChoice(sampling="best", critic_sampling="uniform"), return_steps=3, discount=0.9)


def test_a_set_behind_another_is_drawn_from_as_if_it_were_alone():
    sets = [log([1.0, 3.0], [4, 5]), log([7.0, 2.0, 4.0], [3, 2, 6])]
    alone = [columns_of(dataset, BY_RETURN) for dataset in sets]
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), *alone)
    assert isinstance(together, WeightedColumns)
    for columns, first, rows in zip(alone, (0, 9), (9, 11), strict=True):
        slab = Slab(together, jnp.asarray(first), jnp.asarray(rows))
        for ours, theirs in zip(
            jax.tree.leaves(sample(slab, jr.key(3), 200)), jax.tree.leaves(sample(columns, jr.key(3), 200)), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)


def test_uniform_rows_are_the_draws_that_they_were():
    """The golden rows are those of `jax.random.randint` itself."""
    columns = columns_of(log([1.0, 2.0], [6, 7]), RowChoice())
    assert isinstance(columns, Transitions)
    rows = jr.randint(jr.key(11), (32,), 0, 13)
    np.testing.assert_array_equal(rows_of(sample(columns, jr.key(11), 32)), rows)


@pytest.mark.parametrize("sampling", ["return", "advantage", "best"])
def test_returns_that_are_no_numbers_and_mixed_batches_are_refused(sampling):
    choice = RowChoice(sampling=sampling)
    returns = np.array([1.0, np.nan, np.inf])
    with pytest.raises(DatasetError, match=r"2 episodes are no finite numbers \(first: episode 1\)"):
        episode_weights(returns, choice)
        chosen_episodes(returns, np.array([1, 1, 1]), choice)
    dataset = log([1.0, 2.0], [4, 4])
    mixed = Dataset(**{**vars(dataset), "mixture": Mixture(4, 0.5)})
    for build in (lambda: columns_of(mixed, choice), lambda: training_column_shapes(mixed, View(choice=choice))):
        with pytest.raises(ConfigError, match=f"sampling='{sampling}': the data are mixed per batch.*--per-batch"):
            build()


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"sampling": "return", "return_temperature": 0.0}, "return_temperature=0.0 must be positive"),
        ({"sampling": "return", "return_temperature": float("nan")}, "return_temperature=nan must be positive"),
        ({"sampling": "return", "return_temperature": "hot"}, "return_temperature=hot must be positive"),
        ({"sampling": "best", "best_share": 0.0}, r"best_share=0.0 must lie in \(0, 1\]"),
        ({"sampling": "best", "best_share": 1.5}, "best_share=1.5"),
        ({"sampling": "advantage", "return_temperature": -1.0}, "return_temperature=-1.0 must be positive"),
        ({"sampling": "worst"}, "sampling='worst' is not known"),
        ({"sampling": "return", "return_per": "row"}, "return_per='row' is not known"),
        ({"sampling": "best", "critic_sampling": "best"}, "critic_sampling='best' is not known"),
    ],
)
def test_settings_out_of_range_are_refused(fields, match):
    with pytest.raises(ConfigError, match=match):
        changed(RowChoice(), fields).row_choice()


def test_numbers_that_do_nothing_tell_no_two_choices_apart():
    assert RowChoice(best_share=0.3, return_temperature=9.0).row_choice() == RowChoice()
    assert RowChoice(critic_sampling="uniform").row_choice() == RowChoice()
    assert RowChoice(sampling="best", return_temperature=9.0).row_choice() == RowChoice(sampling="best")
    assert RowChoice(sampling="return", best_share=0.3).row_choice() == RowChoice(sampling="return")
