"""What a log says by itself: rewards and ends by step, and what whoever wrote it earned up to a horizon.

    V = sum_{t < H} gamma^t S_t r_t,     r_t = sum_e w_et r_et / sum_e w_et,
    S_0 = 1,     S_{t+1} = S_t ( 1 - sum_e w_et d_et / sum_e w_et )

Sums go over the episodes e with a logged row t; d_et is 1 where the task ended with that row. S_t is the share of
episodes that still run at step t. An episode whose recording was cut says nothing of later steps and leaves both sums;
one whose task ended is taken out by S. With weights w = 1 this is the behaviour's own value (Kaplan and Meier 1958 for
S), and where no recording was cut before step H it is the mean return. With the weights of `odaf.estimation.importance`
it is per-decision weighted importance sampling.
"""

import math
from dataclasses import dataclass

import numpy as np

from odaf.data.dataset import Dataset
from odaf.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Recorded:
    """E episodes of a log, cut at a horizon of H steps; entries without a logged row are 0.

    Attributes:
        rewards: [E, H] float64, in the log's unit.
        present: [E, H] bool, where there is a row.
        ended: [E, H] bool, where the task ended with the row.
        complete: [E] bool, episodes whose fate is known up to the horizon: their task ended, or they reach it.
        discount: gamma.
    """

    rewards: np.ndarray
    present: np.ndarray
    ended: np.ndarray
    complete: np.ndarray
    discount: float

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, discount: float) -> "Recorded":
        """The episodes of a data set."""
        lengths = np.minimum(dataset.episode_lengths(), horizon)
        present, rows = np.arange(horizon) < lengths[:, None], rows_within(dataset, horizon)
        ended = by_step(dataset.terminated[rows], present)
        rewards = by_step(dataset.rewards[rows].astype(np.float64), present)
        return cls(rewards, present, ended, ended.any(axis=1) | (lengths == horizon), discount)

    @property
    def episodes(self) -> int:
        """E."""
        return len(self.present)

    @property
    def horizon(self) -> int:
        """H."""
        return self.present.shape[1]

    @property
    def discounts(self) -> np.ndarray:
        """[H], gamma^t."""
        return self.discount ** np.arange(self.horizon)

    def values(self, counts: np.ndarray, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """V of resampled episodes, and what it is where every step earns 1: how long an episode lasts.

        Args:
            counts: [resamples, E], how often each episode was drawn.
            weights: [E, H], of the rows; None weighs all alike.

        Returns:
            Two arrays [resamples]. Where a resample holds no row of a step, the whole log's mean stands in.
        """
        weights = self.present.astype(np.float64) if weights is None else weights * self.present
        whole = np.ones((1, self.episodes))

        def means(column: np.ndarray) -> np.ndarray:
            tables = [each @ (weights * column) for each in (counts, whole)]
            sums = [each @ weights for each in (counts, whole)]
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (np.where(total > 0, top / total, np.nan) for top, total in zip(tables, sums, strict=True))
            return np.nan_to_num(np.where(np.isnan(one), other, one))

        running = np.cumprod(1.0 - means(self.ended.astype(np.float64)), axis=1)
        share = np.concatenate([np.ones((len(counts), 1)), running[:, :-1]], axis=1) * self.discounts
        return np.sum(share * means(self.rewards), axis=1), np.sum(share, axis=1)


def shown_horizon(dataset: Dataset) -> int:
    """Steps that the log shows: the median length of recordings that were cut, or the longest episode if none was."""
    lengths = dataset.episode_lengths()
    last = np.append(dataset.episode_starts[1:], len(dataset)) - 1
    cut = lengths[~dataset.terminated[last]]
    return int(np.median(cut)) if len(cut) else int(lengths.max())


def by_step(column: np.ndarray, present: np.ndarray) -> np.ndarray:
    """A column of the rows within the horizon as [E, H]; 0 where there is no row."""
    table = np.zeros(present.shape, column.dtype)
    table[present] = column
    return table


def rows_within(dataset: Dataset, horizon: int) -> np.ndarray:
    """Numbers of the rows before the horizon of their episodes, ascending."""
    lengths = dataset.episode_lengths()
    steps = np.arange(len(dataset)) - np.repeat(dataset.episode_starts, lengths)
    return np.flatnonzero(steps < horizon)


def resampled(episodes: int, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """[1 + resamples, E]: the log as it is, then how often a sample with replacement holds each episode."""
    drawn = rng.multinomial(episodes, np.full(episodes, 1.0 / episodes), size=resamples)
    return np.concatenate([np.ones((1, episodes)), drawn]).astype(np.float64)


def resampled_rows(
    episode_of_row: np.ndarray, episodes: int, members: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """For every member as many rows as there are, of episodes drawn with replacement; and how often each was drawn."""
    there, starts, lengths = np.unique(episode_of_row, return_index=True, return_counts=True)
    table, counts = [], np.zeros((members, episodes))
    for member in range(members):
        drawn = rng.integers(0, len(there), len(there))
        np.add.at(counts[member], there[drawn], 1.0)
        rows = np.concatenate([np.arange(int(lengths[each])) + starts[each] for each in drawn])
        table.append(np.resize(rng.permutation(rows), len(episode_of_row)))  # no chance but that of the episodes
    return np.concatenate(table), counts


def discounted_steps(horizon: int, discount: float) -> np.ndarray:
    """[H + 1]: the sum of gamma^k over k < h, for h from 0."""
    return np.concatenate([[0.0], np.cumsum(discount ** np.arange(horizon, dtype=np.float64))])


def check_horizon(horizon: int, discount: float) -> None:
    """Raises `ConfigError` unless there is a step to value, and a discount in (0, 1]."""
    if horizon < 1:
        raise ConfigError(f"horizon={horizon} must be at least 1; leave it out for the horizon that the log shows")
    if not (0.0 < discount <= 1.0 and math.isfinite(discount)):
        raise ConfigError(f"discount={discount} must lie above 0 and at most at 1, which is the plain sum of rewards")
