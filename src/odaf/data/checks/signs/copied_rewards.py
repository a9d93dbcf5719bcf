"""Can the reward be computed from one column alone?"""

from dataclasses import dataclass

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample

UNSAID = 3e-4
"""Share of the reward's variance that the column may leave unsaid: noise of 1.7 % of its spread."""
STRAIGHT = 1e-6
"""The same where no value of the column comes back, so that only a straight line can be told."""
FEWEST_PAIRS, FEWEST_REWARDS = 200, 20


@dataclass(frozen=True, eq=False)
class CopiedReward:
    """A column that says the reward.

    Attributes:
        field: "observations", "actions" or "next_observations".
        column: which of its columns.
        straight: whether the reward is that column but for unit and offset.
        values: [rows] some values of the column.
        rewards: [rows] the rewards that belong to them.
        count: rows that were looked at.
        rows: the first of them whose reward is not the usual one.
        share: which rows were looked at, for messages.
    """

    field: str
    column: int
    straight: bool
    values: np.ndarray
    rewards: np.ndarray
    count: int
    rows: tuple[int, ...]
    share: str

    def finding(self, names: tuple[str, ...], actions: tuple[str, ...]) -> Finding:
        """For columns and actions of these names."""
        name = (actions if self.field == "actions" else names)[self.column]
        what = {"observations": f"column {name}", "actions": f"action {name}", "next_observations": f"the next {name}"}
        how = "is a straight line in" if self.straight else "can be computed from"
        return Finding(
            "reward-from-one-column", "warning", "rewards", self.count, self.rows,
            f"the reward {how} {what[self.field]} alone{self.share}: whatever else matters is not in it",
            "fine if that is the whole goal; otherwise compute a reward from all that matters "
            "(--reward \"1 - abs(level - setpoint)\" of `odaf data import`)",
        )  # fmt: skip


def find(sample: Sample) -> CopiedReward | None:
    """The column that says most, if it says all. Rows of one piece are never compared with each other."""
    rewards = sample.rewards
    usual = np.median(rewards)
    if np.count_nonzero(rewards != usual) < FEWEST_REWARDS or len(np.unique(sample.piece)) < 2:
        return None
    scaled = (rewards - rewards.mean()) / rewards.std()
    best: tuple[float, str, int] | None = None
    fields = {"observations": sample.observations, "actions": sample.actions, "next_observations": sample.following}
    for field, values in fields.items():
        for column in range(values.shape[1]):
            left = _unsaid(values[:, column], scaled, sample.piece)
            if left < UNSAID and (best is None or left < best[0]):
                best = left, field, column
    if best is None:
        return None
    _, field, column = best
    values = fields[field][:, column]
    known = np.flatnonzero(np.isfinite(values))
    straight, shown = _straight(values[known], scaled[known]) < UNSAID, known[:3_000]
    return CopiedReward(
        field, column, straight, values[shown], rewards[shown], len(known),
        tuple(int(row) for row in sample.number[np.flatnonzero(rewards != usual)[:5]]), sample.share,
    )  # fmt: skip


def _unsaid(column: np.ndarray, rewards: np.ndarray, piece: np.ndarray) -> float:
    """Share of the rewards' variance that no smooth function of the column can say; 1 where that cannot be told.

    From errors of straight lines between the two neighbours in the order of the column (Gasser, Sroka and
    Jennen-Steinmetz 1986), of other pieces: inside one, reward and column may both merely go on from row to row.
    """
    shuffled = np.random.default_rng(0).permutation(len(column))  # so that equal values stand in no order
    order = shuffled[np.argsort(column[shuffled], kind="stable")]
    order = order[np.isfinite(column[order])]
    if len(order) < 3 or column[order[0]] == column[order[-1]]:
        return 1.0
    before, here, after = order[:-2], order[1:-1], order[2:]
    apart = (piece[before] != piece[here]) & (piece[here] != piece[after])
    before, here, after = before[apart], here[apart], after[apart]
    variance = rewards[here].var() if len(here) else 0.0
    if len(here) < FEWEST_PAIRS or variance < 1e-6:
        left = _straight(column[order], rewards[order])
        return left if left < STRAIGHT else 1.0
    width = column[after] - column[before]
    weight = np.where(width > 0, (column[after] - column[here]) / np.where(width > 0, width, 1.0), 0.5)
    errors = rewards[here] - weight * rewards[before] - (1 - weight) * rewards[after]
    return float((np.square(errors) / (1 + weight**2 + (1 - weight) ** 2)).mean() / variance)


def _straight(column: np.ndarray, rewards: np.ndarray) -> float:
    """Share of the rewards' variance that a straight line in the column leaves; 1 where either is constant."""
    first, second = column - column.mean(), rewards - rewards.mean()
    squares = float(np.square(first).sum() * np.square(second).sum())
    return 1 - float(first @ second) ** 2 / squares if squares > 0 else 1.0
