"""How a policy's actions look beside those of a log, in the same states: their range, and how they jump."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.data.dataset import Dataset
from odaf.training.policy import Policy

USUAL = 0.99  # share of the logged changes that count as usual


@dataclass(frozen=True, eq=False)
class ActionColumn:
    """One action, in the log's unit.

    Attributes:
        name: of the column.
        unit: empty where none is known.
        logged_low: the smallest logged value.
        logged_high: the largest.
        outside: share of the policy's actions beyond them.
        logged_change: median, usual (99 %) and largest change from a row to the next in the log.
        policy_change: the same three of the policy, asked in the logged states one after another.
        jumps: share of the policy's changes above the largest logged one.
    """

    name: str
    unit: str
    logged_low: float
    logged_high: float
    outside: float
    logged_change: tuple[float, float, float]
    policy_change: tuple[float, float, float]
    jumps: float


def own_actions(policy: Policy, dataset: Dataset) -> np.ndarray:
    """[N, act_dim] float32, what a policy without memory does in each logged state, in the log's units."""
    return np.asarray(policy.without_derivation()(dataset.observations), np.float32)


def action_columns(dataset: Dataset, actions: np.ndarray) -> tuple[ActionColumn, ...]:
    """Each action of the policy beside the log's.

    Args:
        dataset: the log.
        actions: [N, act_dim] of `own_actions`.
    """
    within = np.ones(len(dataset), bool)
    within[dataset.episode_starts] = False  # nothing comes before an episode's first row
    units = dataset.action_units or ("",) * dataset.act_dim
    made = []
    for index, name in enumerate(dataset.action_names):
        logged, own = dataset.actions[:, index], actions[:, index]
        steps = [np.abs(np.diff(column, prepend=column[:1]))[within] for column in (logged, own)]
        largest = float(steps[0].max(initial=0.0))
        made.append(
            ActionColumn(
                name,
                units[index],
                float(logged.min()),
                float(logged.max()),
                float(np.mean((own < logged.min()) | (own > logged.max()))),
                _three(steps[0]),
                _three(steps[1]),
                float(np.mean(steps[1] > largest)) if len(steps[1]) else 0.0,
            )
        )
    return tuple(made)


def _three(steps: np.ndarray) -> tuple[float, float, float]:
    """Median, usual and largest."""
    if not len(steps):
        return 0.0, 0.0, 0.0
    median, usual = np.quantile(steps, [0.5, USUAL])
    return float(median), float(usual), float(steps.max())


def to_dict(column: ActionColumn) -> dict[str, Any]:
    """Plain JSON types."""
    names = ("median", "usual", "largest")
    return {
        **{name: getattr(column, name) for name in ("name", "unit", "logged_low", "logged_high", "outside", "jumps")},
        "logged_change": dict(zip(names, column.logged_change, strict=True)),
        "policy_change": dict(zip(names, column.policy_change, strict=True)),
    }
