"""Do two groups of episodes answer the same states with different actions?"""

from dataclasses import dataclass

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample
from odaf.data.checks.signs.neighbours import nearest, scaled, thinned

MOST_ROWS, MOST_EPISODES, NEIGHBOURS = 4_500, 200, 24
FEWEST_EPISODES = 3
OVERLAP = 0.2
"""Share of rows that must have neighbours of both groups."""
GAP = 1.2
"""How far apart the groups' actions lie, in spreads of one group: below, they are one cloud."""
MATERIAL = 0.6
"""The same in spreads of all actions: below, the two controllers are of one mind."""


@dataclass(frozen=True, eq=False)
class Conflict:
    """Two groups of episodes whose actions differ where their states do not.

    Attributes:
        action: the action that differs most.
        first: episodes of the one group, by their first rows in the log.
        second: those of the other.
        states: [rows] the observation column along which the picture is drawn.
        column: which one.
        taken: [rows] actions.
        of_second: [rows] whether the row is of the second group.
        apart: distance of the groups' actions in the same states, in the unit of the action.
        within: spread inside a group.
        overlap: share of the rows where both were.
        share: which rows were looked at, for messages.
    """

    action: int
    first: tuple[int, ...]
    second: tuple[int, ...]
    states: np.ndarray
    column: int
    taken: np.ndarray
    of_second: np.ndarray
    apart: float
    within: float
    overlap: float
    share: str

    def finding(self, names: tuple[str, ...], actions: tuple[str, ...]) -> Finding:
        """For actions of these names."""
        few = self.first if len(self.first) < len(self.second) else self.second
        return Finding(
            "controllers-conflict", "warning", "actions", len(few), few[:5],
            f"{len(few):,} of {len(self.first) + len(self.second):,} episodes answer the same states with other "
            f"actions than the rest: {actions[self.action]} lies {self.apart:.3g} apart, where each group spreads by "
            f"{self.within:.2g}{self.share}",
            "a sign or unit that changed, or two controllers of different minds: correct the one, or learn from one "
            "group; cloning answers with the middle, which neither did",
        )  # fmt: skip


def find(sample: Sample) -> Conflict | None:
    """The split of the episodes that tells their actions best apart, found in the one half of each episode and judged
    in the other: noise splits too, but not twice alike."""
    numbers = np.unique(sample.episode)
    among = np.flatnonzero(np.isin(sample.episode, numbers[thinned(len(numbers), MOST_EPISODES)]))
    rows = among[thinned(len(among), MOST_ROWS)]
    episodes, group = np.unique(sample.episode[rows], return_inverse=True)
    if len(episodes) < 2 * FEWEST_EPISODES or len(rows) < 500:
        return None
    points = scaled(sample)[rows]
    actions = sample.actions[rows]
    spread = actions.std(axis=0)
    live = spread > 0
    if not live.any() or points.shape[1] == 0:
        return None
    actions = actions[:, live] / spread[live]
    count = min(NEIGHBOURS, len(rows) // 4)
    near, _ = nearest(points, group, np.arange(len(rows)), np.arange(len(rows)), count)
    left = actions - actions[near].mean(axis=1)
    early = _early(group)
    second = _split(left, near, group, early, len(episodes))
    if second is None:
        return None
    return _judged(sample, rows, points, actions, np.flatnonzero(live), near, second[group], ~early, episodes, second)


def _early(group: np.ndarray) -> np.ndarray:
    """[rows] whether the row lies in the first half of its episode's rows."""
    starts = np.flatnonzero(np.append(True, group[1:] != group[:-1]))
    lengths = np.diff(np.append(starts, len(group)))
    place = np.arange(len(group)) - np.repeat(starts, lengths)
    return place < np.repeat(lengths, lengths) / 2


def _split(
    left: np.ndarray, near: np.ndarray, group: np.ndarray, chosen: np.ndarray, episodes: int
) -> np.ndarray | None:
    """[episodes] whether each belongs to the second group: the sign in the leading direction of the products of what
    neighbours' actions leave."""
    products = np.einsum("nk,nck->nc", left, left[near])
    usable = chosen[:, None] & chosen[near]
    one, other = np.broadcast_to(group[:, None], near.shape)[usable], group[near][usable]
    sums, counts = np.zeros((episodes, episodes)), np.zeros((episodes, episodes))
    np.add.at(sums, (one, other), products[usable])
    np.add.at(counts, (one, other), 1.0)
    sums, counts = sums + sums.T, counts + counts.T
    affinity = sums / np.sqrt(counts + 1.0)
    np.fill_diagonal(affinity, 0.0)
    direction = np.linalg.eigh(affinity)[1][:, -1]
    second = direction > 0
    if min(second.sum(), (~second).sum()) < FEWEST_EPISODES:
        return None
    return second


def _judged(
    sample: Sample, rows: np.ndarray, points: np.ndarray, actions: np.ndarray, live: np.ndarray, near: np.ndarray,
    second: np.ndarray, late: np.ndarray, episodes: np.ndarray, which: np.ndarray,
) -> Conflict | None:  # fmt: skip
    """Whether the split holds in rows that did not make it."""
    usable = late[near]
    ours = usable & second[near]
    theirs = usable & ~second[near]
    both = late & (ours.sum(axis=1) >= 3) & (theirs.sum(axis=1) >= 3)
    overlap = both.sum() / max(late.sum(), 1)
    if overlap < OVERLAP:
        return None
    means, variances = [], []
    for mask in (ours[both], theirs[both]):
        weights = mask[:, :, None] / mask.sum(axis=1)[:, None, None]
        mean = (weights * actions[near[both]]).sum(axis=1)
        spread = (weights * np.square(actions[near[both]] - mean[:, None])).sum(axis=1)
        counts = mask.sum(axis=1)[:, None]
        means.append(mean)
        variances.append(spread * counts / (counts - 1))
    noise = sum(v / m.sum(axis=1)[:, None] for v, m in zip(variances, (ours[both], theirs[both]), strict=True))
    apart = np.sqrt(np.maximum((np.square(means[1] - means[0]) - noise).mean(axis=0), 0.0))
    within = np.sqrt(np.maximum(*(value.mean(axis=0) for value in variances)))
    clear = (apart > GAP * within) & (apart > MATERIAL)
    if not clear.any():
        return None
    action = int(np.argmax(np.where(clear, apart, 0.0)))
    kept = sample.actions[:, live[action]].std()
    column, values = _widest(sample, rows)
    starts = sample.number[np.searchsorted(sample.episode, episodes)]
    return Conflict(
        int(live[action]), tuple(starts[~which].tolist()), tuple(starts[which].tolist()), values, column,
        sample.actions[rows, live[action]], second, float(apart[action] * kept), float(within[action] * kept),
        float(overlap), sample.share,
    )  # fmt: skip


def _widest(sample: Sample, rows: np.ndarray) -> tuple[int, np.ndarray]:
    """The observation column with most different values, to draw along."""
    counts = [len(np.unique(column)) for column in sample.observations[rows].T]
    column = int(np.argmax(counts))
    return column, sample.observations[rows, column]
