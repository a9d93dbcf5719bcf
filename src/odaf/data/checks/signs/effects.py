"""What the actions change, and after how many rows."""

from dataclasses import dataclass

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample
from odaf.data.checks.signs.copied_actions import CopiedAction, echoes

MOST_LAG = 20
FEWEST = 1_000
HISTORY = 2
FREE = 0.003
"""Share of an action's variance that rows and actions before it must leave open: what follows from them changes nothing
that they do not change themselves."""
SEEN, CLEAR = 5.0, 8.0
"""Correlations are noise below the one, an effect above the other, in units of one over the root of the rows."""
QUIET = 1.2
"""An action changes nothing below so many times the noise, since the largest of many correlations counts."""
WEAK, FIRST = 0.25, 0.5
"""Before a dead time is over, effects are below the one share of the strongest; it is over at the other."""
MOST_COLUMNS = 64


@dataclass(frozen=True, eq=False)
class Effects:
    """How much each action says of what changes later and could not be foreseen from what was before it.

    Attributes:
        strength: [lags, actions] largest correlation, over the columns, of what is free in the action of a row with
            what changes unforeseen in the step from the row so many rows later.
        noise: what such a correlation is by chance, at most.
        free: [actions] share of the action's variance that is free.
        curved: [actions] the same as `strength` at lag 0 for squares of the action and its products with columns.
        rows: rows used.
        shown: first rows of the log that were used.
        held: by action, how many rows ago the actions were taken that columns hold.
        share: which rows were looked at, for messages.
    """

    strength: np.ndarray
    noise: float
    free: np.ndarray
    curved: np.ndarray
    rows: int
    shown: tuple[int, ...]
    held: dict[int, set[int]]
    share: str

    @property
    def judged(self) -> np.ndarray:
        """[actions] whether anything can be said."""
        return self.free > FREE

    @property
    def quiet(self) -> float:
        """What the strongest correlation of an action that changes nothing stays below."""
        return QUIET * self.noise

    def dead_time(self, action: int) -> int:
        """Rows until the action first changes something; 0 where it does at once, or nothing is seen of it."""
        course = self.strength[:, action]
        peak = course.max()
        if not self.judged[action] or peak < CLEAR / SEEN * self.noise:
            return 0
        first = int(np.flatnonzero(course >= FIRST * peak)[0])
        if first == 0 or course[:first].max() > max(WEAK * peak, 0.0) or self.curved[action] > FIRST * peak:
            return 0
        return first

    def nothing(self, action: int) -> bool:
        """Whether the action could have shown an effect, and showed none."""
        return bool(
            self.judged[action]
            and self.strength[:, action].max() < self.quiet
            and self.curved[action] < 1.3 * self.noise
        )

    def findings(self, actions: tuple[str, ...]) -> list[Finding]:
        """For actions of these names."""
        found = []
        late = {action: self.dead_time(action) for action in range(len(actions))}
        late = {a: lag for a, lag in late.items() if lag and not set(range(1, lag + 1)) <= self.held.get(a, set())}
        if late:
            lag = max(late.values())
            what = ", ".join(f"{actions[action]} after {rows}" for action, rows in list(late.items())[:8])
            example = next(iter(late))
            found.append(
                Finding(
                    "dead-time", "warning", "actions", self.rows, self.shown,
                    f"actions change something only some rows later: {what} (correlation with what changes then "
                    f"{self.strength[late[example], example]:.2f}, at once {self.strength[0, example]:.2f})"
                    f"{self.share}",
                    f"put the last actions among the observations: --lags {lag} of `odaf data import`",
                )
            )  # fmt: skip
        idle = [actions[action] for action in range(len(actions)) if self.nothing(action)]
        if idle:
            names = ", ".join(idle[:8]) + (", ..." if len(idle) > 8 else "")
            found.append(
                Finding(
                    "no-effect", "warning", "actions", self.rows, self.shown,
                    f"nothing that was observed depends on {names}, neither at once nor within {len(self.strength)} "
                    f"rows (correlations below {self.quiet:.2g} over {self.rows:,} rows){self.share}",
                    "check that the column is what really acted (a set point that was overridden, another unit's "
                    "actuator), that its rows belong to these observations, and that what it changes is observed",
                )
            )  # fmt: skip
        return found


def find(sample: Sample, copied: list[CopiedAction]) -> Effects | None:
    """None where there are too few rows that follow one another."""
    lags = MOST_LAG
    rows = sample.runs(HISTORY, lags + 1)
    while len(rows) < min(FEWEST, 0.5 * len(sample)) and lags > 4:
        lags //= 2
        rows = sample.runs(HISTORY, lags + 1)
    if len(rows) < FEWEST:
        return None
    held, echoing = echoes(sample, lags)
    holding = {entry.column for entry in copied} | echoing
    moving = np.flatnonzero(sample.observations.std(axis=0) > 0)
    columns = [column for column in moving.tolist() if column not in holding]
    columns = columns[:: max(1, -(-len(columns) // MOST_COLUMNS))]
    if not columns:
        return None
    seen = _standard(sample.observations[:, columns])
    actions = _standard(sample.actions)
    changes, predictable = _unforeseen(sample, seen)
    if predictable < 0.05:  # rows that do not follow from one another: what an action earns is all that it can change
        changes = np.concatenate([changes, _rewards(sample, seen)], axis=1)
    free, share = _free(seen, actions, rows)
    outcomes = (_unit(changes[rows + lag]) for lag in range(lags + 1))
    strength = np.stack([np.abs(free.T @ outcome).max(axis=1) for outcome in outcomes]) / len(rows)
    curved = _curved(free, seen[rows], _unit(changes[rows]))
    chance = np.sqrt(2 * np.log(len(strength) * changes.shape[1] + 1)) + 2.0
    return Effects(
        strength, max(chance, SEEN) / np.sqrt(len(rows)), share, curved, len(rows),
        tuple(int(row) for row in sample.number[rows[:5]]), held, sample.share,
    )  # fmt: skip


def _standard(values: np.ndarray) -> np.ndarray:
    spread = values.std(axis=0)
    return (values - values.mean(axis=0)) / np.where(spread > 0, spread, 1.0)


def _left(features: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """What a linear prediction leaves of the targets."""
    ridge = 1e-6 * len(features) * np.eye(features.shape[1])
    return targets - features @ np.linalg.solve(features.T @ features + ridge, features.T @ targets)


def _unforeseen(sample: Sample, seen: np.ndarray) -> tuple[np.ndarray, float]:
    """([rows, columns] what the step from each row leaves unforeseen by it and the row before, of unit spread, 0 where
    these are not in the sample; how much of the largest column can be foreseen)."""
    starts = sample.runs(1, 1)
    left = _left(np.concatenate([np.ones((len(starts), 1)), seen[starts], seen[starts - 1]], axis=1), seen[starts + 1])
    spread = left.std(axis=0)
    foreseen = 1 - np.square(spread) / np.maximum(seen[starts + 1].var(axis=0), 1e-12)
    full = np.zeros_like(seen)
    full[starts] = np.clip(left / np.where(spread > 1e-9, spread, np.inf), -8, 8)  # so that few leaps do not decide
    return full, float(foreseen.max())


def _unit(values: np.ndarray) -> np.ndarray:
    spread = values.std(axis=0)
    return (values - values.mean(axis=0)) / np.where(spread > 1e-9, spread, np.inf)


def _free(seen: np.ndarray, actions: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """([rows, actions] what is free in each action, of unit spread; [actions] its share of the variance)."""
    before = [seen[rows], seen[rows - 1], *(actions[rows - back] for back in range(1, HISTORY + 1))]
    left = _left(np.concatenate([np.ones((len(rows), 1)), *before], axis=1), actions[rows])
    return _unit(left), left.var(axis=0) / np.maximum(actions[rows].var(axis=0), 1e-12)


def _rewards(sample: Sample, seen: np.ndarray) -> np.ndarray:
    """[rows, 1] what rows leave unforeseen of the rewards."""
    return _left(np.concatenate([np.ones((len(seen), 1)), seen], axis=1), _standard(sample.rewards[:, None]))


def _curved(free: np.ndarray, seen: np.ndarray, outcome: np.ndarray) -> np.ndarray:
    """[actions] largest correlation of the squared action, or its product with a column, with what changes at once."""
    largest = []
    for action in free.T:
        products = _unit(np.concatenate([np.square(action)[:, None], action[:, None] * seen], axis=1))
        largest.append(float(np.abs(products.T @ outcome).max() / len(seen)))
    return np.array(largest)
