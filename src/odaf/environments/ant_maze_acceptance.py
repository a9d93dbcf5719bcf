"""Is a generated ant-maze set what its name says? Do its ants reach their goals, on their feet, everywhere?"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odaf.environments.ant_maze import SUCCESS_RADIUS
from odaf.environments.ant_maze_map import AntMazeMap
from odaf.environments.ant_maze_recorder import Walk
from odaf.environments.ant_walker import uprightness

# Figure of the statistics: smallest and largest value.
LIMITS: Mapping[str, tuple[float, float]] = {
    "reached_share": (0.7, 1.0),
    "flipped_share": (0.0, 0.2),
    "visited_share": (0.99, 1.0),
    "goal_walks": (1, float("inf")),
    "shortest_walk": (10, float("inf")),
    "largest_action": (0.0, 1.0),
}
FEWEST_WALKS = 20  # fewer say too little of a share


def statistics_of(walks: Sequence[Walk], columns: Mapping[str, np.ndarray], maze: AntMazeMap) -> dict[str, Any]:
    """Figures of a recording.

    Args:
        walks: all of them, each to its own goal; the last may not be over.
        columns: the rows that were made of them.
        maze: what they went through; of it are the cells that walks may begin in and lead to.
    """
    rows = len(columns["rewards"])
    whole = [
        walk
        for walk, end in zip(walks, np.cumsum([walk.length for walk in walks]), strict=True)
        if walk.finished and end <= rows
    ]
    visited = {maze.cell((x, y)) for x, y in columns["observations"][:, :2].tolist()}
    figures: dict[str, Any] = {
        "transitions": rows,
        "walks": len(walks),
        "whole_walks": len(whole),
        "goal_walks": sum(walk.arrived for walk in whole),
        "visited_share": float(np.mean([cell in visited for cell in maze.free])),
        "largest_action": float(np.abs(columns["actions"]).max()),
    }
    if whole:
        steps = [steps_to_goal(walk) for walk in whole]
        reached = [step for step in steps if step is not None]
        figures |= {
            "reached_share": len(reached) / len(whole),
            "flipped_share": float(np.mean([flipped(walk) for walk in whole])),
            "shortest_walk": min(walk.length for walk in whole),
            "mean_walk": float(np.mean([walk.length for walk in whole])),
        }
        if reached:
            figures["steps_to_goal"] = float(np.mean(reached))
    return figures


def steps_to_goal(walk: Walk) -> int | None:
    """Steps until a walk was within 0.5 m of its goal, or at the place where walks end; None if it came to neither."""
    near = np.linalg.norm(walk.bodies[:, :2] - walk.goal, axis=1) <= SUCCESS_RADIUS
    if near.any():
        return int(np.argmax(near))
    return walk.length if walk.arrived else None


def flipped(walk: Walk) -> bool:
    """Whether it ended with the ant on its back."""
    return bool(uprightness(walk.bodies[-1]) < 0.0)


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
