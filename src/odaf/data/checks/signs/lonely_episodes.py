"""Are there states that only one episode visits?"""

from dataclasses import dataclass

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample
from odaf.data.checks.signs.neighbours import nearest, scaled, thinned

QUERIES, REFERENCES = 3_000, 9_000
FEWEST_EPISODES = 8
FAR = 4.0
"""How much farther from all others an episode lies than nine tenths of the episodes do."""
LEAST = 1.25
"""The distance itself, for each column, in units of its spread."""
APART, LEAST_APART = 8.0, 0.25
"""The same where nothing lies between: so many times as far as the next episode, at a smaller distance."""


@dataclass(frozen=True, eq=False)
class LonelyEpisodes:
    """Episodes that went where no other did.

    Attributes:
        rows: their first rows in the log.
        of: episodes that were looked at.
        distance: of the middle row of the loneliest from the nearest row of another episode, in spreads of the columns.
        usual: the same for nine tenths of the episodes, at most.
        points: [rows, 2] observations along the two columns in which the loneliest differs most.
        columns: which these are.
        lonely: [rows] whether the row is of such an episode.
        share: which rows were looked at, for messages.
    """

    rows: tuple[int, ...]
    of: int
    distance: float
    usual: float
    points: np.ndarray
    columns: tuple[int, int]
    lonely: np.ndarray
    share: str

    def finding(self, names: tuple[str, ...], actions: tuple[str, ...]) -> Finding:
        """For columns of these names."""
        count = len(self.rows)
        where = " and ".join(dict.fromkeys(names[column] for column in self.columns))
        return Finding(
            "lonely-episode", "warning", "observations", count, self.rows[:5],
            f"{count:,} of {self.of:,} episodes {'goes' if count == 1 else 'go'} where no other does: "
            f"{self.distance / max(self.usual, 1e-9):.0f} times as far from the nearest other row as is usual, most in "
            f"{where}{self.share}",
            "nothing can be compared with what was done there: did a sensor or a unit change? Log more of it, or leave "
            "the episode out",
        )  # fmt: skip


def find(sample: Sample) -> LonelyEpisodes | None:
    """None where there are few episodes, or none is lonely."""
    episodes, group = np.unique(sample.episode, return_inverse=True)
    if len(episodes) < FEWEST_EPISODES:
        return None
    points = scaled(sample)
    if points.shape[1] == 0:
        return None
    rows = thinned(len(sample), QUERIES)
    _, distances = nearest(points, group, rows, thinned(len(sample), REFERENCES), 1)
    own = distances[:, 0] / np.sqrt(points.shape[1])
    middle = np.zeros(len(episodes))
    borders = np.flatnonzero(np.diff(group[rows])) + 1
    for number, part in zip(group[rows[np.append(0, borders)]], np.split(own, borders), strict=True):
        middle[number] = np.median(part)
    usual = float(np.quantile(middle, 0.9))
    lonely = np.flatnonzero(((middle > FAR * usual) & (middle > LEAST)) | (middle >= _apart_from(middle)))
    if not len(lonely) or len(lonely) > 0.1 * len(episodes):
        return None
    worst = int(lonely[np.argmax(middle[lonely])])
    columns = _columns(sample, group == worst)
    shown = thinned(len(sample), 3_000)
    shown = np.union1d(shown, np.flatnonzero(np.isin(group, lonely)))
    firsts = np.array([sample.number[np.argmax(group == index)] for index in lonely])
    return LonelyEpisodes(
        tuple(int(row) for row in firsts), len(episodes), float(middle[worst]), usual,
        sample.observations[shown][:, list(columns)], columns, np.isin(group[shown], lonely), sample.share,
    )  # fmt: skip


def _apart_from(middle: np.ndarray) -> float:
    """The distance from which on a few episodes stand apart from the rest, with nothing in between; else infinite."""
    ascending = np.sort(middle)
    upper = np.arange(len(middle) - max(1, len(middle) // 10), len(middle))
    alone = (ascending[upper] > APART * ascending[upper - 1]) & (ascending[upper] > LEAST_APART)
    return float(ascending[upper[np.argmax(alone)]]) if alone.any() else np.inf


def _columns(sample: Sample, chosen: np.ndarray) -> tuple[int, int]:
    """The two columns in which these rows differ most from the rest."""
    rest = sample.observations[~chosen]
    spread = rest.std(axis=0)
    shift = np.abs(sample.observations[chosen].mean(axis=0) - rest.mean(axis=0)) / np.where(spread > 0, spread, np.inf)
    order = np.argsort(-shift)
    return int(order[0]), int(order[min(1, len(order) - 1)])
