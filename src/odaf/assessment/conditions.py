"""Conditions that a process must keep, such as `level < 3`: how often an episode breaks one, logged and to be expected.

An episode breaks a condition with the first row whose action leads to a state that breaks it, or, where the condition
names actions, that holds such an action. Rows after that one are left out and it earns 1, all others nothing, so that
the sum of an episode's rewards is whether it breaks the condition, and its expectation is the probability: an estimate
from that log says what the policy would do (`odaf.estimation`), and its episodes what whoever wrote it did.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import beta

from odaf.data.dataset import Dataset
from odaf.data.expressions import Expression, parse
from odaf.errors import ConfigError
from odaf.estimation import Interval


@dataclass(frozen=True)
class Condition:
    """A comparison of a log's columns that shall hold in every row.

    Attributes:
        text: as the user wrote it.
        expression: 1 where it holds, 0 where it does not.
        names_actions: whether it takes a column of the actions.
    """

    text: str
    expression: Expression
    names_actions: bool

    @classmethod
    def parse(cls, text: str, dataset: Dataset) -> "Condition":
        """The condition in a text, over the columns of a log.

        Raises:
            DatasetError: it is no formula, or names a column that the log has not.
            ConfigError: it is a number and no comparison.
        """
        expression = parse(text, (*dataset.observation_names, *dataset.action_names))
        values = expression(_columns(dataset, dataset.observations))
        if not np.isin(values, (0.0, 1.0)).all():
            raise ConfigError(f"keep: {text!r} gives numbers, not true or false; compare them, as in {text!r} < 3")
        return cls(text, expression, bool(set(expression.columns) & set(dataset.action_names)))

    def broken(self, dataset: Dataset) -> np.ndarray:
        """[N] bool, rows whose action breaks it: by itself, or by the state that it leads to."""
        here = self.expression(_columns(dataset, dataset.observations)) == 0.0
        if self.names_actions:
            return here
        after = self.expression(_columns(dataset, dataset.next_observations)) == 0.0
        first = np.zeros(len(dataset), bool)
        first[dataset.episode_starts] = here[dataset.episode_starts]
        return after | first

    def as_log(self, dataset: Dataset) -> Dataset:
        """The log whose rewards are 1 in the first row of an episode that breaks the condition, which ends it."""
        broken = self.broken(dataset)
        starts, lengths = dataset.episode_starts, dataset.episode_lengths()
        place = np.arange(len(dataset)) - np.repeat(starts, lengths)
        first = np.minimum.reduceat(np.where(broken, place, len(dataset)), starts)
        kept = place <= np.repeat(first, lengths)
        ends = broken & (place == np.repeat(first, lengths))
        left = np.minimum(lengths, first + 1)
        columns = {name: getattr(dataset, name)[kept] for name in ("observations", "actions", "next_observations")}
        return replace(
            dataset,
            **columns,
            rewards=ends[kept].astype(np.float32),
            terminated=(dataset.terminated | ends)[kept],
            truncated=(dataset.truncated & ~ends)[kept],
            episode_starts=np.concatenate([[0], np.cumsum(left)[:-1]]).astype(np.int64),
            infos={},
            mixture=None,
            source=self.text,
        )


@dataclass(frozen=True)
class Kept:
    """How often episodes break a condition.

    Attributes:
        text: the condition.
        episodes: in the log.
        broken: of them, how many broke it.
        logged: the share, with Clopper and Pearson's interval.
        policy: the probability that an episode of the policy does; None where the log cannot tell.
        reason: why it cannot, else an empty text.
    """

    text: str
    episodes: int
    broken: int
    logged: Interval
    policy: Interval | None
    reason: str

    @property
    def worse(self) -> bool:
        """Whether the policy surely breaks it more often than whoever wrote the log: the intervals do not meet."""
        return self.policy is not None and self.policy.low > self.logged.high

    def __str__(self) -> str:
        said = f"keep {self.text}: {self.broken:,} of {self.episodes:,} logged episodes broke it, {_share(self.logged)}"
        return f"{said}; the policy: {self.reason if self.policy is None else _share(self.policy)}"


def share_of(broken: int, episodes: int, confidence: float) -> Interval:
    """A share of episodes with Clopper and Pearson's interval, which holds for few of them and for none.

    Args:
        broken: how many.
        episodes: of how many.
        confidence: of the interval.
    """
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if broken == 0 else float(beta.ppf(tail, broken, episodes - broken + 1))
    high = 1.0 if broken == episodes else float(beta.ppf(1.0 - tail, broken + 1, episodes - broken))
    return Interval(broken / episodes, low, high)


def conditions_of(texts: Sequence[str], dataset: Dataset) -> tuple[Condition, ...]:
    """Each text as a condition; raises as `Condition.parse`, and `ConfigError` where one is given twice."""
    if len(set(texts)) < len(texts):
        raise ConfigError("keep: one condition stands there twice; give each once")
    return tuple(Condition.parse(text, dataset) for text in texts)


def _columns(dataset: Dataset, states: np.ndarray) -> dict[str, np.ndarray]:
    table = np.concatenate([states, dataset.actions], axis=1).astype(np.float64)
    return dict(zip((*dataset.observation_names, *dataset.action_names), table.T, strict=True))


def _share(interval: Interval) -> str:
    return f"{interval.value:.1%} ({interval.low:.1%} to {interval.high:.1%})"
