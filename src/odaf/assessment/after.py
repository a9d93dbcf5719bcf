"""What was promised of a policy, beside what happened once it ran: value, conditions, drift of the columns, alarms."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from odaf.assessment.actions import own_actions
from odaf.assessment.conditions import Condition, Kept, share_of
from odaf.data.dataset import Dataset
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.make_guard import parts_of
from odaf.errors import DatasetError
from odaf.estimation import Interval
from odaf.estimation.recorded import Recorded, resampled
from odaf.training.policy import Policy

Beside = Literal["as promised", "less than promised", "more than promised", "nothing was promised"]

RESAMPLES = 1_000
MOVED = 0.2  # standard deviations of the log
SAME_ACTION = 0.01  # of an action's range


@dataclass(frozen=True)
class Drift:
    """How far a column's mean lies from where it lay in the log.

    Attributes:
        name: of the column.
        shift: in standard deviations of the log's rows, with an interval over episodes of both logs.
        outside: share of the new rows beyond the log's smallest and largest value.
    """

    name: str
    shift: Interval
    outside: float

    @property
    def moved(self) -> bool:
        """Whether it surely moved, by more than a fifth of a standard deviation."""
        return abs(self.shift.value) > MOVED and not self.shift.low <= 0.0 <= self.shift.high


@dataclass(frozen=True)
class Happened:
    """A condition once the policy ran.

    Attributes:
        text: the condition.
        promised: what was expected of the policy; None where the log could not tell.
        broken: episodes that broke it.
        happened: their share, with an interval.
    """

    text: str
    promised: Interval | None
    broken: int
    happened: Interval

    @property
    def beside(self) -> Beside:
        return beside(self.promised, self.happened)


@dataclass(frozen=True)
class Aftermath:
    """The promise and what happened.

    Attributes:
        episodes: in the new log.
        own: share of its rows whose action is the policy's own, to a hundredth of the range.
        promised: value of an episode that was promised; None where the estimate was refused.
        value: what an episode of the new log earned, to the same horizon.
        kept: by condition.
        drift: by column of the observations.
        alarms: episodes in which the guard has an alarm; None without a guard.
    """

    episodes: int
    own: float
    promised: Interval | None
    value: Interval
    kept: tuple[Happened, ...]
    drift: tuple[Drift, ...]
    alarms: int | None

    @property
    def beside(self) -> Beside:
        return beside(self.promised, self.value)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, but for NaN."""
        kept = [asdict(each) | {"beside": each.beside} for each in self.kept]
        drift = [asdict(each) | {"moved": each.moved} for each in self.drift]
        return asdict(self) | {"beside": self.beside, "kept": kept, "drift": drift}

    def __str__(self) -> str:
        said = "-" if self.promised is None else str(self.promised)
        lines = [
            f"{self.episodes:,} episodes of the new log; {self.own:.0%} of its actions are the policy's own",
            f"value of an episode: promised {said}, happened {self.value}: {self.beside}",
        ]
        for each in self.kept:
            share = "-" if each.promised is None else f"{each.promised.low:.1%} to {each.promised.high:.1%}"
            lines.append(
                f"keep {each.text}: promised {share}, {each.broken:,} of {self.episodes:,} episodes broke it "
                f"({each.happened.low:.1%} to {each.happened.high:.1%}): {each.beside}"
            )
        moved = [f"{each.name} by {each.shift.value:+.2f}" for each in self.drift if each.moved]
        lines.append(f"columns that moved, in standard deviations of the log: {', '.join(moved) or 'none'}")
        if self.alarms is not None:
            lines.append(f"guard: an alarm in {self.alarms:,} of {self.episodes:,} episodes")
        if self.own < 0.5:
            lines.append("note: most actions are not the policy's own, so that this log says little of it")
        return "\n".join(lines)


def beside(promised: Interval | None, happened: Interval) -> Beside:
    """Whether two intervals meet, and which lies lower where they do not."""
    if promised is None or np.isnan(promised.low):
        return "nothing was promised"
    if happened.high < promised.low:
        return "less than promised"
    return "more than promised" if happened.low > promised.high else "as promised"


def happened(
    policy: Policy,
    guard: GuardedPolicy | None,
    log: Dataset,
    new: Dataset,
    horizon: int,
    discount: float,
    promised: Interval | None,
    conditions: Sequence[tuple[Condition, Kept]],
    confidence: float,
    seed: int,
) -> Aftermath:
    """What a log says that was written while the policy ran.

    Args:
        policy: what ran.
        guard: its guard, or None.
        log: the hold-out that the promise was made from.
        new: the new log.
        horizon: steps of an episode that count, as for the promise.
        discount: weight of a reward one step later, as for the promise.
        promised: value of an episode.
        conditions: each with what was promised of it.
        confidence: of all intervals.
        seed: of resampled episodes.

    Raises:
        DatasetError: the new log has other columns, or a single episode.
    """
    if (new.observation_names, new.action_names) != (log.observation_names, log.action_names):
        raise DatasetError(
            f"after: the new log has the columns {', '.join((*new.observation_names, *new.action_names))}, the one set "
            f"aside {', '.join((*log.observation_names, *log.action_names))}; read both in the same way"
        )
    if new.num_episodes < 2:
        raise DatasetError("after: the new log has a single episode, which has no spread; log at least two")
    rng = np.random.default_rng(seed)
    counts = resampled(new.num_episodes, RESAMPLES, rng)
    values, _ = Recorded.of(new, horizon, discount).values(counts)
    own = own_actions(policy, new)
    near = np.abs(own - new.actions) <= SAME_ACTION * (new.action_high - new.action_low)
    alarms = None
    if guard is not None:
        largest = np.maximum.reduceat(ratios(guard, new), new.episode_starts)
        alarms = int((~(largest <= 1.0)).sum())
    kept = []
    for condition, promise in conditions:
        broken = int(np.logical_or.reduceat(condition.broken(new), new.episode_starts).sum())
        share = share_of(broken, new.num_episodes, confidence)
        kept.append(Happened(condition.text, promise.policy, broken, share))
    return Aftermath(
        new.num_episodes,
        float(near.all(axis=1).mean()),
        promised,
        Interval.of_resamples(float(values[0]), values[1:], confidence),
        tuple(kept),
        drifts(log, new, confidence, rng),
        alarms,
    )


def drifts(log: Dataset, new: Dataset, confidence: float, rng: np.random.Generator) -> tuple[Drift, ...]:
    """Each column of the observations, by its mean over rows; episodes of both logs are resampled."""
    spread = np.maximum(log.observations.std(axis=0, dtype=np.float64), 1e-12)
    means = [_means(part, rng) for part in (log, new)]
    shifts = (means[1] - means[0]) / spread
    low, high = log.observations.min(axis=0), log.observations.max(axis=0)
    outside = ((new.observations < low) | (new.observations > high)).mean(axis=0)
    return tuple(
        Drift(name, Interval.of_resamples(float(column[0]), column[1:], confidence), float(share))
        for name, column, share in zip(log.observation_names, shifts.T, outside, strict=True)
    )


def _means(dataset: Dataset, rng: np.random.Generator) -> np.ndarray:
    """[1 + resamples, obs_dim], of the rows as they are, then of resampled episodes."""
    counts = resampled(dataset.num_episodes, RESAMPLES, rng)
    sums = np.add.reduceat(dataset.observations.astype(np.float64), dataset.episode_starts)
    return (counts @ sums) / (counts @ dataset.episode_lengths())[:, None]


def ratios(guard: GuardedPolicy, dataset: Dataset, *, own: bool = False) -> np.ndarray:
    """[N], the guard's score of each row beside its threshold: an alarm above 1."""
    return parts_of(guard.score, guard.policy, dataset, own=own).max(axis=1) / guard.calibration.threshold
