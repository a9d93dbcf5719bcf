"""Is there a column that already holds the action?"""

from dataclasses import dataclass

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample

UNSAID = 1e-3
"""Share of a column's variance that the action may leave unsaid: noise of 3 % of its spread."""
BETTER = 0.2
"""The action of that row must leave at most this share of what its neighbours in time leave."""
UNITS = (1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3)
CLOSE = 0.02


@dataclass(frozen=True, eq=False)
class CopiedAction:
    """A column that holds an action.

    Attributes:
        column: observation column.
        action: action column.
        lead: 0 if it holds the action of its own row, 1 if that of the next.
        held: [rows] some of its values.
        taken: [rows] the actions that belong to them.
        count: rows that were looked at.
        rows: the first of them where the action changes.
        share: which rows were looked at, for messages.
    """

    column: int
    action: int
    lead: int
    held: np.ndarray
    taken: np.ndarray
    count: int
    rows: tuple[int, ...]
    share: str

    def finding(self, names: tuple[str, ...], actions: tuple[str, ...]) -> Finding:
        """For columns and actions of these names."""
        column, which = names[self.column], ("its own", "the next")[self.lead]
        return Finding(
            "action-in-observations", "warning", "observations", self.count, self.rows,
            f"column {column} already holds the action {actions[self.action]} of {which} row{self.share}: a policy "
            "learns to read it off there, and at work it is what the policy itself should say",
            f"leave {column} out of the observations, or log it one row later, as the action of the row before "
            "(--lags 1 of `odaf data import` adds that)",
        )  # fmt: skip


def find(sample: Sample) -> list[CopiedAction]:
    """Every column that holds an action, once."""
    rows = sample.runs(1, 1)
    if len(rows) < 100:
        return []
    observations, (before, own, after) = sample.observations[rows], (sample.actions[rows + by] for by in (-1, 0, 1))
    left = np.stack([_unsaid(observations, actions) for actions in (before, own, after)])  # [3, columns, actions]
    found = []
    for lead in (0, 1):
        others = np.delete(left, 1 + lead, axis=0)
        holds = (left[1 + lead] < UNSAID) & (left[1 + lead] < BETTER * others.min(axis=0))
        for column, action in np.argwhere(holds):
            taken = (own, after)[lead][:, action]
            if lead == 0 and not _natural(observations[:, column], taken, sample.actions[:, action]):
                continue
            if any(entry.column == column for entry in found):
                continue
            changed = np.flatnonzero(np.append(False, np.diff(taken) != 0))[:5]
            found.append(
                CopiedAction(
                    int(column), int(action), lead, observations[:3_000, column], taken[:3_000],
                    len(rows),
                    tuple(int(row) for row in sample.number[rows[changed]]), sample.share,
                )
            )  # fmt: skip
    return found


def echoes(sample: Sample, most: int) -> tuple[dict[int, set[int]], set[int]]:
    """(by action, how many rows ago the actions were taken that columns hold; these columns). 1 is the row before."""
    held: dict[int, set[int]] = {}
    columns: set[int] = set()
    for lag in range(1, most + 1):
        rows = sample.runs(lag, 0)
        if len(rows) < 100:
            break
        same = _unsaid(sample.observations[rows], sample.actions[rows - lag]) < UNSAID
        columns |= set(np.flatnonzero(same.any(axis=1)).tolist())
        for action in np.flatnonzero(same.any(axis=0)):
            held.setdefault(int(action), set()).add(lag)
    return held, columns


def _unsaid(columns: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """[columns, actions] share of a column's variance that a straight line in an action leaves; 1 for constants."""
    first, second = columns - columns.mean(axis=0), actions - actions.mean(axis=0)
    squares = np.square(first).sum(axis=0)[:, None] * np.square(second).sum(axis=0)[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = 1 - np.square(first.T @ second) / squares
    return np.where(squares > 0, np.nan_to_num(left, nan=1.0), 1.0)


def _natural(column: np.ndarray, action: np.ndarray, all_actions: np.ndarray) -> bool:
    """Whether one is the other in another unit, or as a share of its range: a controller's gain would be any number."""
    slope, offset = np.polyfit(action, column, 1)
    spread = column.std()
    if any(abs(slope / unit - 1) < CLOSE and abs(offset) < CLOSE * (spread + abs(column.mean())) for unit in UNITS):
        return True
    low, high = all_actions.min(), all_actions.max()
    ends = slope * np.array([low, high]) + offset
    return any(
        np.allclose(ends, wanted, atol=CLOSE * (wanted[1] - wanted[0])) for wanted in ((0, 1), (-1, 1), (0, 100))
    )
