"""How many rows a run really learns from, where it does not draw all alike: recorded, and refused if they are few."""

from typing import Any

import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.data.dataset import Dataset
from odaf.data.row_choice import chosen_episodes, compared_returns, effective_rows, for_log
from odaf.data.sampling import row_weights
from odaf.data.start_values import start_values
from odaf.errors import ConfigError

DRAWN = "drawn"
"""The entry of `data.json`."""
FEWEST_BATCHES = 10
"""Effective rows, in batches, below which every update sees nearly the same rows."""


def drawn_rows(algorithm: Algorithm, dataset: Dataset) -> dict[str, Any]:
    """What `data.json` says of the rows that batches are drawn from; empty where all are drawn alike.

    Raises:
        ConfigError: a setting is out of its range, so few rows are left that a batch holds much of them, the data are
            mixed per batch, or critics are to draw apart in a learner that cannot do it.
        DatasetError: rows are chosen by returns that are no finite numbers.
    """
    view = algorithm.drawn_view()
    choice = view.choice
    if choice.sampling == "uniform":
        return {}
    weights = row_weights(dataset, view)
    chosen_by = for_log(dataset, choice)
    returns = compared_returns(dataset, choice)
    chosen = chosen_episodes(returns, dataset.episode_lengths(), choice)
    effective, least = effective_rows(weights), FEWEST_BATCHES * algorithm.batch_size
    if effective < least:
        setting = "best_share" if choice.sampling == "best" else "return_temperature"
        of = f" of the {choice.best_of}" if choice.sampling == "best" else ""
        raise ConfigError(
            f"sampling={choice.sampling!r}, {setting}={getattr(chosen_by, setting):.6g}{of}: batches are drawn from "
            f"{effective:,.0f} effective rows of {len(dataset):,}, fewer than {FEWEST_BATCHES} batches of "
            f"{algorithm.batch_size}; raise {setting}, lower batch_size, or take sampling='uniform'"
        )
    found = {
        "sampling": choice.sampling,
        "episodes": len(chosen),
        "rows": int(np.count_nonzero(weights)),
        "effective_rows": effective,
        "log_rows": len(dataset),
        "lowest_return": float(returns[chosen].min()),
    }
    if chosen_by != choice:
        found["return_temperature"] = chosen_by.return_temperature
    if choice.sampling == "advantage":
        found["explained_by_start"] = start_values(returns, dataset.observations[dataset.episode_starts]).explained
    if choice.return_per != "episode":
        found["return_per"] = choice.return_per
    if choice.critic_sampling != "same":
        found["critic_sampling"] = choice.critic_sampling
    return {DRAWN: found}


def in_words(drawn: dict[str, Any]) -> str:
    """What `drawn_rows` found, as a sentence for the user."""
    whose = "the actor's batches" if "critic_sampling" in drawn else "batches"
    beside = "; those of the critics from all rows alike" if "critic_sampling" in drawn else ""
    measure = "return per step" if "return_per" in drawn else "return"
    if drawn["sampling"] == "best":
        found = f"the {drawn['rows']:,} rows of the {drawn['episodes']:,} best episodes"
        return f"{whose} are drawn from {found} ({measure} at least {drawn['lowest_return']:,.4g}){beside}"
    by = measure
    if drawn["sampling"] == "advantage":
        share = drawn["explained_by_start"]
        by += (
            f" less what its start foretells ({share:.0%} of the variance)" if share else " (its start foretells none)"
        )
    rows = f"as various as {drawn['effective_rows']:,.0f} rows of {drawn['log_rows']:,}"
    return f"{whose} are drawn by {by}: {rows}{beside}"
