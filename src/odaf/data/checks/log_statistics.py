"""What a log shows of itself before anything is learned: how good its episodes are, and whether that can be compared.

Nothing here depends on the unit of the reward; nor, where all episodes are equally long, on a constant that every row
earns beside.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from odaf.data.between_episodes import between_episodes
from odaf.data.checks.parting import compared, equal, part
from odaf.data.checks.sample import Sample
from odaf.data.start_values import start_values

FEWEST_STARTS = 20
"""Episodes in the sample below which nothing is said of goals and starts."""
HALF = 0.6
"""Share of episodes and rows that a better half of the log may be, a little more than half."""


@dataclass(frozen=True)
class LogStatistics:
    """Figures that advice is given by.

    Attributes:
        rows: of the log.
        episodes: whole ones; fragments, cut by the recording before half the usual length, are left out.
        columns: numbers in an observation.
        actions: numbers in an action.
        per_step: whether episodes are compared by return per step, as where the recorder decided how long they are.
        terminated: share of the whole episodes that the task ended.
        best: mean merit (return, or return per step; units of the reward) of the best tenth of the rows.
        middle: merit of the episode of the middle row.
        worst: mean merit of the worst tenth of the rows.
        good_episodes: of the better part, where one lies far above the rest; else 0.
        good_rows: share of the rows in that part.
        good_from: its lowest merit, or None.
        between: share of the variance of rewards that lies between episodes instead of within them.
        rewarded: share of the rows whose reward is not the commonest one, in the sample.
        return_rows: (sum w)^2 / sum w^2 of the weights of `sampling="return"` at its usual temperature.
        goals: names of observation columns that never change within an episode and differ between episodes.
        start_says: share of the variance of returns that the first observation foretells of left-out episodes.
        free: share of the actions' variance that a linear function of the observation does not say.
        mixed: whether the log is mixed per batch.
    """

    rows: int
    episodes: int
    columns: int
    actions: int
    per_step: bool
    terminated: float
    best: float
    middle: float
    worst: float
    good_episodes: int
    good_rows: float
    good_from: float | None
    between: float
    rewarded: float
    return_rows: float
    goals: tuple[str, ...] = ()
    start_says: float = 0.0
    free: float = 1.0
    mixed: bool = False

    @property
    def lift(self) -> float:
        """Where the middle lies between worst and best: 0.5 of a symmetric spread, 1 where only the best stand out."""
        span = self.best - self.worst
        return (self.best - self.middle) / span if span > 0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON types, `lift` among them; None for what is no finite number."""
        found = {**asdict(self), "goals": list(self.goals), "lift": self.lift}
        return {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in found.items()}


def measure(
    episodes: np.ndarray,
    reward_variance: float,
    rows: int,
    names: tuple[str, ...],
    actions: int,
    sample: Sample | None,
    mixed: bool = False,
) -> LogStatistics:
    """The figures of a log that was passed over.

    Args:
        episodes: [4, episodes] first row, return, length and whether it terminated.
        reward_variance: over all rows.
        rows: of the log.
        names: of the observations' columns.
        actions: numbers in an action.
        sample: rows of some episodes, or None.
        mixed: whether the log is mixed per batch.
    """
    firsts, returns, lengths, terminated = episodes
    merits = compared(returns, lengths, terminated)
    values, sizes = merits.values[merits.whole], lengths[merits.whole]
    best, middle, worst = _levels(values, sizes)
    parting = part(values, sizes, HALF)
    return LogStatistics(
        rows=rows,
        episodes=len(values),
        columns=len(names),
        actions=actions,
        per_step=merits.per_step,
        terminated=float((terminated[merits.whole] > 0).mean()),
        best=best,
        middle=middle,
        worst=worst,
        good_episodes=0 if parting is None else parting.episodes,
        good_rows=0.0 if parting is None else parting.rows,
        good_from=None if parting is None else parting.least,
        between=between_episodes(returns, lengths, reward_variance),
        rewarded=1.0 if sample is None else _rewarded(sample),
        return_rows=_return_rows(merits.values, lengths),
        goals=() if sample is None else _goals(sample, names),
        start_says=0.0 if sample is None else _start_says(sample, firsts, merits.values),
        free=1.0 if sample is None else _free(sample),
        mixed=mixed,
    )


def _levels(values: np.ndarray, sizes: np.ndarray) -> tuple[float, float, float]:
    """Mean merit of the best tenth of the rows, merit of the middle row, mean merit of the worst tenth."""
    if equal(values):
        level = float(values[0])
        return level, level, level
    order = np.argsort(-values, kind="stable")
    values, edges = values[order], np.cumsum(sizes[order]) / sizes.sum()
    starts = np.append(0.0, edges[:-1])

    def mean(low: float, high: float) -> float:
        held = np.clip(np.minimum(edges, high) - np.maximum(starts, low), 0.0, None)
        return float((held * values).sum() / held.sum())

    return mean(0.0, 0.1), float(values[np.searchsorted(edges, 0.5)]), mean(0.9, 1.0)


def _return_rows(values: np.ndarray, lengths: np.ndarray, temperature: float = 0.1) -> float:
    span = np.ptp(values)
    weights = np.exp((values - values.max()) / (span if span > 0 else 1.0) / temperature)
    return float((weights * lengths).sum() ** 2 / (np.square(weights) * lengths).sum())


def _rewarded(sample: Sample) -> float:
    counts = np.unique(sample.rewards, return_counts=True)[1]
    return float(1.0 - counts.max() / len(sample))


def _goals(sample: Sample, names: tuple[str, ...]) -> tuple[str, ...]:
    """Columns that stand still in each of many episodes, and elsewhere in each."""
    if len(np.unique(sample.episode)) < FEWEST_STARTS or not sample.goes_on.any():
        return ()
    moves = sample.observations[1:] != sample.observations[:-1]
    still = ~(moves & sample.goes_on[:-1, None]).any(axis=0)
    differs = moves.any(axis=0)
    return tuple(name for name, goal in zip(names, still & differs, strict=True) if goal)


def _start_says(sample: Sample, firsts: np.ndarray, values: np.ndarray) -> float:
    """See `odaf.data.start_values`; of those episodes whose first row is in the sample."""
    places = np.searchsorted(firsts, sample.number)
    begins = places < len(firsts)
    begins[begins] = firsts[places[begins]] == sample.number[begins]
    if np.count_nonzero(begins) < FEWEST_STARTS:
        return 0.0
    return start_values(values[places[begins]], sample.observations[begins]).explained


def _free(sample: Sample) -> float:
    """By least squares over the sample; 1 where actions do not vary or rows are few."""
    spread = sample.observations.std(axis=0)
    moving = spread > 0
    if len(sample) < 20 * (1 + np.count_nonzero(moving)):
        return 1.0
    seen = (sample.observations[:, moving] - sample.observations[:, moving].mean(axis=0)) / spread[moving]
    taken = sample.actions - sample.actions.mean(axis=0)
    total = np.square(taken).sum()
    if total == 0.0:
        return 1.0
    taken = taken / np.where(taken.std(axis=0) > 0, taken.std(axis=0), 1.0)  # each action counts alike
    left = taken - seen @ np.linalg.lstsq(seen, taken, rcond=None)[0]
    return float(np.square(left).sum() / np.square(taken).sum())
