"""Which rows of a log a learner's batches are drawn from, and how often: all alike, or the better episodes more often.

Most rows of a poor log come from poor episodes. Any learner sees more of the good ones if rows are drawn by the return
of their episode, or by its return less what its start foretells (Hong et al. 2023), or from the best episodes alone.
Losses stay what they are.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from odaf.data.between_episodes import between_episodes
from odaf.data.dataset import Dataset
from odaf.data.start_values import start_values
from odaf.errors import ConfigError, DatasetError


@dataclass(frozen=True, kw_only=True)
class RowChoice:
    """How the rows of batches are chosen; every learner has these settings."""

    sampling: Literal["uniform", "return", "advantage", "best"] = "uniform"
    """Rows that batches hold: "uniform" all alike; "return" by exp(return of the row's episode, scaled to [0, 1] over
    the log, / return_temperature); "advantage" the same with the return less what a linear regression on the episode's
    first observation foretells of it, so that a bad start is forgiven; "best" only those of the best episodes."""
    return_temperature: Literal["auto"] | float = 0.1
    """Of sampling="return" and "advantage": the lower, the more the best episodes are preferred; in the share of the
    range of returns that makes a row e times as likely. "auto" takes it from the log: 0.1 where episodes differ in all
    that they earn, the higher the more alike they are."""
    best_share: float = 0.1
    """Of sampling="best": episodes are taken whole, by return from the best down, until they hold this share."""
    best_of: Literal["rows", "episodes"] = "rows"
    """What best_share is a share of: the rows of the log, or its episodes."""
    return_per: Literal["episode", "step"] = "episode"
    """What episodes are compared by: their sum of rewards, or its mean over their rows, for logs where the recorder
    decided how long an episode is."""
    critic_sampling: Literal["same", "uniform"] = "same"
    """Rows that critics learn from: those of `sampling`, or "uniform" all alike beside an actor that learns from those
    of `sampling`, so that critics see what is bad."""

    def row_choice(self) -> "RowChoice":
        """These settings alone, without those that do nothing, in their range.

        Raises:
            ConfigError: a number lies outside its range.
        """
        if self.sampling == "uniform":
            return UNIFORM
        if self.sampling not in ("return", "advantage", "best"):
            raise ConfigError(
                f"sampling={self.sampling!r} is not known; known are 'uniform', 'return', 'advantage', 'best'"
            )
        if self.critic_sampling not in ("same", "uniform"):
            raise ConfigError(f"critic_sampling={self.critic_sampling!r} is not known; known are 'same', 'uniform'")
        if self.return_per not in ("episode", "step"):
            raise ConfigError(f"return_per={self.return_per!r} is not known; known are 'episode', 'step'")
        kept = RowChoice(sampling=self.sampling, critic_sampling=self.critic_sampling, return_per=self.return_per)
        if self.sampling == "best":
            if not 0.0 < self.best_share <= 1.0:
                raise ConfigError(f"best_share={self.best_share} must lie in (0, 1]: the share that is learned from")
            return replace(kept, best_share=self.best_share, best_of=self.best_of)
        temperature = self.return_temperature
        if temperature != "auto" and (isinstance(temperature, str) or not 0.0 < temperature < math.inf):
            raise ConfigError(
                f"return_temperature={temperature} must be positive; a very large one is "
                "sampling='uniform', and 'auto' takes one from the log"
            )
        return replace(kept, return_temperature=temperature)


UNIFORM = RowChoice()
SHARPEST = 0.1
"""`return_temperature="auto"` where all variance of rewards lies between episodes: that of the paper."""
LEAST_BETWEEN = 1e-3
"""Share of that variance below which episodes count as alike."""
LEAST_ROWS, LEAST_SHARE = 2_560, 0.1
"""Effective rows that "auto" leaves: ten batches of 256, or a tenth of the log where that is less."""
ROUNDING = 1e-6
"""Share of the range of returns below which advantages are taken for rounding of single precision."""


def chosen_episodes(
    returns: Float[np.ndarray, " episodes"], lengths: Int[np.ndarray, " episodes"], choice: RowChoice
) -> Int[np.ndarray, " chosen"]:
    """Episodes that rows are drawn from, in the order of the log; of equal returns the earlier is the better."""
    if choice.sampling != "best":
        return np.arange(len(returns))
    ranked = np.argsort(-_finite(returns), kind="stable")
    sizes = lengths[ranked] if choice.best_of == "rows" else np.ones(len(ranked), np.int64)
    wanted = math.ceil(round(choice.best_share * int(sizes.sum()), 6))  # 0.1 * 30 is a little more than 3
    return np.sort(ranked[: int(np.searchsorted(np.cumsum(sizes), wanted)) + 1])


def compared_returns(dataset: Dataset, choice: RowChoice) -> Float[np.ndarray, " episodes"]:
    """The episodes' returns, or with return_per="step" what a row of each earned on average."""
    returns = dataset.episode_returns()
    return returns / dataset.episode_lengths() if choice.return_per == "step" else returns


def episode_merits(dataset: Dataset, choice: RowChoice) -> Float[np.ndarray, " episodes"]:
    """What episodes are chosen by: their returns, or with sampling="advantage" G - V(s_0) of `start_values`.

    Advantages that are only what rounding left of the returns are all 0: then a start says the whole return.
    """
    returns = compared_returns(dataset, choice)
    if choice.sampling != "advantage":
        return returns
    merits = _finite(returns) - start_values(returns, dataset.observations[dataset.episode_starts]).values
    return merits if np.ptp(merits) > ROUNDING * np.ptp(returns) else np.zeros(len(returns))


def episode_weights(merits: Float[np.ndarray, " episodes"], choice: RowChoice) -> Float[np.ndarray, " episodes"]:
    """The weight of each row by its episode's merit: 1 in the best episode; all 1 where merits are equal. "auto" must
    have been resolved (`for_log`)."""
    merits = _finite(merits)
    low, high = merits.min(), merits.max()
    if choice.sampling not in ("return", "advantage") or low == high:
        return np.ones(len(merits))
    return np.exp((merits - high) / (high - low) / _number(choice.return_temperature))


def for_log(dataset: Dataset, choice: RowChoice) -> RowChoice:
    """The choice with `return_temperature="auto"` resolved: T = 0.1 / b, b = `between_episodes`.

    Episodes of one controller earn much alike in every row, and what tells them apart is mostly luck: b is 0.03 of a
    mediocre policy's log, and rows are drawn nearly uniformly. Where a good controller's episodes lie among poor ones,
    b nears 1 and the good ones are drawn almost alone. Where episodes differ by their length alone b is 0, and long
    ones have more rows as it is. T is raised by quarters until `LEAST_ROWS` effective rows are left.
    """
    if choice.sampling not in ("return", "advantage") or choice.return_temperature != "auto":
        return choice
    lengths = dataset.episode_lengths()
    returns = _finite(dataset.episode_returns())
    share = between_episodes(returns, lengths.astype(np.float64), float(np.var(dataset.rewards, dtype=np.float64)))
    merits, least = episode_merits(dataset, choice), min(LEAST_ROWS, LEAST_SHARE * len(dataset))
    found = replace(choice, return_temperature=SHARPEST / max(share, LEAST_BETWEEN))
    while effective_rows(np.repeat(episode_weights(merits, found), lengths)) < least:
        found = replace(found, return_temperature=1.25 * _number(found.return_temperature))
    return found


def log_weights(dataset: Dataset, choice: RowChoice) -> Float[np.ndarray, " rows"]:
    """How often each row of a log is drawn, as a multiple of one of the best episode; 0 where the choice leaves its
    episode out."""
    choice = for_log(dataset, choice)
    merits, lengths = episode_merits(dataset, choice), dataset.episode_lengths()
    weights = episode_weights(merits, choice)
    if choice.sampling == "best":
        weights[np.setdiff1d(np.arange(len(merits)), chosen_episodes(merits, lengths, choice))] = 0.0
    return np.repeat(weights, lengths)


def effective_rows(weights: Float[np.ndarray, " rows"]) -> float:
    """(sum w)^2 / sum w^2: as many rows, drawn uniformly, would be as various."""
    return float(weights.sum() ** 2 / np.square(weights).sum())


def has_table(choice: RowChoice) -> bool:
    """Whether rows are drawn by a table of weights, instead of all alike from those that there are."""
    return choice.sampling in ("return", "advantage") or choice.critic_sampling == "uniform"


def drawn_from(dataset: Dataset, choice: RowChoice) -> Dataset:
    """The episodes that rows are drawn from, by critics at least; the data set itself where these are all.

    Raises:
        ConfigError: the data say themselves how batches are drawn.
    """
    if choice.sampling != "uniform" and dataset.mixture is not None:
        raise ConfigError(
            f"sampling={choice.sampling!r}: the data are mixed per batch, which says already how rows are drawn; take "
            "sampling='uniform', or mix without --per-batch (odaf.data.mixing.mix in Python)"
        )
    if choice.sampling != "best" or choice.critic_sampling == "uniform":
        return dataset
    return dataset.select(chosen_episodes(compared_returns(dataset, choice), dataset.episode_lengths(), choice))


def _number(temperature: str | float) -> float:
    assert not isinstance(temperature, str)  # `row_choice` lets "auto" pass alone, `for_log` resolves it
    return temperature


def _finite(returns: np.ndarray) -> np.ndarray:
    wrong = np.flatnonzero(~np.isfinite(returns))
    if len(wrong):
        raise DatasetError(
            f"sampling by return: the returns of {len(wrong)} episodes are no finite numbers (first: episode "
            f"{wrong[0]}); mend their rewards, or take sampling='uniform'"
        )
    return np.asarray(returns, np.float64)
