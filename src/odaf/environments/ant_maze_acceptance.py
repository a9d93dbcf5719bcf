"""Is a generated ant-maze set what its name says? Do its ants reach their goals, on their feet, everywhere?"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from odaf.environments.ant_maze import SUCCESS_RADIUS
from odaf.environments.ant_maze_map import AntMazeMap
from odaf.environments.ant_maze_recorder import Walks
from odaf.environments.ant_walker import uprightness

# Figure of the statistics: smallest and largest value.
LIMITS: Mapping[str, tuple[float, float]] = {
    "reached_share": (0.7, 1.0),
    "flipped_share": (0.0, 0.2),
    "visited_share": (0.99, 1.0),
    "goal_rows": (1, float("inf")),
    "largest_action": (0.0, 1.0),
}
FEWEST_WALKS = 20  # fewer say too little of a share


def statistics_of(walks: Walks, columns: Mapping[str, np.ndarray], maze: AntMazeMap) -> dict[str, Any]:
    """Figures of a recording.

    Args:
        walks: all of them, each to its own goal.
        columns: the rows that were made of them, told as attempts at one goal.
        maze: what they went through; of it are the cells that walks may begin in and lead to.
    """
    steps = walks.actions.shape[1]
    whole = len(columns["rewards"]) // steps
    near, (reached, flipped) = _near_goals(walks), reached_and_flipped(walks)
    visited = {maze.cell((x, y)) for x, y in columns["observations"][:, :2].tolist()}
    figures: dict[str, Any] = {
        "transitions": len(columns["rewards"]),
        "walks": len(walks.actions),
        "whole_walks": whole,
        "goal_rows": int(columns["terminated"].sum()),
        "goal_walks": len(np.unique(columns["walk"][columns["terminated"]])),
        "visited_share": float(np.mean([cell in visited for cell in maze.free])),
        "largest_action": float(np.abs(columns["actions"]).max()),
    }
    if whole:
        figures |= {
            "reached_share": float(reached[:whole].mean()),
            "flipped_share": float(flipped[:whole].mean()),
        }
        if reached[:whole].any():
            figures["steps_to_goal"] = float(np.argmax(near[:whole][reached[:whole]], axis=1).mean())
    return figures


def reached_and_flipped(walks: Walks) -> tuple[np.ndarray, np.ndarray]:
    """[W] whether a walk came within 0.5 m of its goal, and [W] whether it ended with the ant on its back."""
    return np.any(_near_goals(walks), axis=1), np.asarray(uprightness(walks.bodies[:, -1]) < 0.0)


def _near_goals(walks: Walks) -> np.ndarray:
    """[W, T + 1]."""
    return np.linalg.norm(walks.bodies[:, :, :2] - walks.goals[:, None], axis=2) <= SUCCESS_RADIUS


def acceptance_of(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Every check with its limits; `passed` is None where too few whole walks were recorded."""
    if figures["whole_walks"] < FEWEST_WALKS:
        return {"passed": None, "checks": []}
    checks = [
        {
            "figure": name,
            "value": figures[name],
            "lowest": low,
            "highest": high if np.isfinite(high) else None,
            "passed": bool(low <= figures[name] <= high),
        }
        for name, (low, high) in LIMITS.items()
    ]
    return {"passed": all(check["passed"] for check in checks), "checks": checks}


def findings_of(acceptance: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a reader of the file must be told: every check that was not passed."""
    if acceptance["passed"] is None:
        message = f"fewer than {FEWEST_WALKS} whole walks were recorded, so nothing is said of them; record more rows"
        return [{"finding": "acceptance-unknown", "count": 1, "message": message}]
    findings = []
    for check in acceptance["checks"]:
        if not check["passed"]:
            highest = "" if check["highest"] is None else f" to {check['highest']:g}"
            findings.append(
                {
                    "finding": "acceptance-failed",
                    "count": 1,
                    "message": f"{check['figure']} is {check['value']:.4g}, expected {check['lowest']:g}{highest}: too "
                    "few walks, another simulator, or a walker that is not as good as the shipped one",
                }
            )
    return findings
