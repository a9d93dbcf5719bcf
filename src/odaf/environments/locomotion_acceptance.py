"""Is a generated locomotion set what its name says? Its figures beside those of the published set of that name."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from odaf.environments.locomotion import TIME_LIMIT, Task
from odaf.environments.reference_returns import REFERENCES

# Mean normalised return of the published sets' whole episodes, and the share of their rows that end one by a fall
# (episodes over rows; 0 where bodies do not fall).
PUBLISHED: dict[str, tuple[float, float]] = {
    "halfcheetah-random": (-0.07, 0.0),
    "halfcheetah-medium": (40.68, 0.0),
    "halfcheetah-medium-replay": (27.17, 0.0),
    "halfcheetah-medium-expert": (64.38, 0.0),
    "halfcheetah-expert": (88.09, 0.0),
    "hopper-random": (1.19, 0.045),
    "hopper-medium": (44.32, 0.0022),
    "hopper-medium-replay": (14.98, 0.0051),
    "hopper-medium-expert": (64.84, 0.0016),
    "hopper-expert": (108.51, 0.0010),
    "walker2d-random": (0.01, 0.049),
    "walker2d-medium": (62.09, 0.0012),
    "walker2d-medium-replay": (14.84, 0.0036),
    "walker2d-medium-expert": (82.67, 0.0011),
    "walker2d-expert": (107.15, 0.0010),
}
# Standard deviation of the returns of the published sets' whole episodes, as the statistics say that training programs
# log when they load the files (D4RL, v2).
PUBLISHED_SPREAD: dict[str, float] = {
    "halfcheetah-medium": 355.75,
    "halfcheetah-expert": 441.68,
    "hopper-medium": 378.95,
    "hopper-expert": 328.59,
    "walker2d-medium": 1095.44,
    "walker2d-expert": 136.39,
}
SPREAD_FACTOR = 1.5  # returns of a set may spread up to so many times as widely as the published one's
TOLERANCE = {"random": 3.0, "medium": 3.0, "expert": 3.0, "medium-replay": 8.0}
TERMINAL_FACTOR = 3.0  # a set may end episodes by a fall up to so many times as often as the published one
FAR_BELOW = 0.2  # an episode is far below the others if it earns so much less than their median, as a share of it
FEW_TERMINALS = 0.001  # below one fall in a thousand rows, fewer are as good


def statistics_of(columns: Mapping[str, np.ndarray], task: Task, version: str) -> dict[str, Any]:
    """Figures of a recording. Returns are those of episodes that fell or reached the time limit, never of cut ones."""
    ends = np.flatnonzero(columns["terminated"] | columns["truncated"])
    starts = np.concatenate([[0], ends[:-1] + 1])
    lengths = ends - starts + 1
    whole = columns["terminated"][ends] | (lengths == TIME_LIMIT)
    returns = np.add.reduceat(columns["rewards"].astype(np.float64), starts)[whole]
    reference = REFERENCES[task.family]
    points = 100.0 / (reference.expert - reference.random)  # of normalised score for a unit of return
    figures: dict[str, Any] = {
        "transitions": len(columns["rewards"]),
        "episodes": len(ends),
        "whole_episodes": int(whole.sum()),
        "terminal_row_share": float(columns["terminated"].mean()),
        "mean_length": float(lengths.mean()),
        "largest_action": float(np.abs(columns["actions"]).max()),
    }
    if len(returns):
        figures |= {
            "environment": task.environment_id(version),
            "mean": float(returns.mean()),
            "std": float(returns.std()),
            "best": float(returns.max()),
            "worst": float(returns.min()),
            "normalised_mean": reference.normalise(float(returns.mean())),
            "normalised_error": points * float(returns.std() / np.sqrt(len(returns))),
            "far_below": int(np.sum(returns < np.median(returns) - FAR_BELOW * np.abs(np.median(returns)))),
        }
    return figures


def acceptance_of(task: Task, kind: str, parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Every check with its limits; `passed` is None where no whole episode was recorded.

    Args:
        task: the task.
        kind: random, medium, medium-replay, medium-expert or expert.
        parts: figures of the recording under `kind`; of `medium-expert`, those of both halves instead, since the
            mean of a mixture depends on how many episodes the rows of each half make.
    """
    checks = []
    for part, figures in parts.items():
        target, share = PUBLISHED[f"{task.name}-{part}"]
        prefix = "" if part == kind else f"{part}/"
        if "normalised_mean" not in figures:
            return {"passed": None, "checks": []}
        tolerance = TOLERANCE[part]
        mean = _check(f"{prefix}normalised_mean", figures["normalised_mean"], target - tolerance, target + tolerance)
        checks.append(mean | {"standard_error": figures["normalised_error"]})
        checks.append(_check(f"{prefix}terminal_row_share", figures["terminal_row_share"], *terminal_limits(share)))
        if f"{task.name}-{part}" in PUBLISHED_SPREAD:
            std = _check(f"{prefix}std", figures["std"], 0.0, widest_spread(f"{task.name}-{part}"))
            checks.append(std | {"far_below": figures["far_below"], "whole_episodes": figures["whole_episodes"]})
        checks.append(_check(f"{prefix}largest_action", figures["largest_action"], 0.0, 1.0))
    return {"passed": all(check["passed"] for check in checks), "checks": checks}


def terminal_limits(share: float) -> tuple[float, float]:
    """Smallest and largest share of rows that end with a fall, for a published set with this one."""
    return 0.0 if share <= FEW_TERMINALS else share / TERMINAL_FACTOR, share * TERMINAL_FACTOR


def widest_spread(name: str) -> float:
    """Largest standard deviation of returns, for the published set of this name."""
    return SPREAD_FACTOR * PUBLISHED_SPREAD[name]


def findings_of(acceptance: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a reader of the file must be told: every check that was not passed."""
    if acceptance["passed"] is None:
        message = "no whole episode was recorded, so nothing can be said about returns; record more transitions"
        return [{"finding": "acceptance-unknown", "count": 1, "message": message}]
    return [
        {
            "finding": "acceptance-failed",
            "count": 1,
            "message": f"{check['figure']} is {check['value']:.4g}{_noted(check)}, the published set of this name asks "
            f"for [{check['lowest']:.4g}, {check['highest']:.4g}]",
        }
        for check in acceptance["checks"]
        if not check["passed"]
    ]


def _noted(check: Mapping[str, Any]) -> str:
    """What explains a figure that is not within its limits: chance, or a few episodes."""
    if "standard_error" in check:
        return f" (standard error {check['standard_error']:.2g})"
    if "far_below" in check:
        far = f"{check['far_below']} of {check['whole_episodes']} episodes"
        return f" ({far} earn {FAR_BELOW:.0%} less than the median, or worse)"
    return ""


def _check(figure: str, value: float, lowest: float, highest: float) -> dict[str, Any]:
    return {
        "figure": figure,
        "value": value,
        "lowest": lowest,
        "highest": highest,
        "passed": lowest <= value <= highest,
    }
