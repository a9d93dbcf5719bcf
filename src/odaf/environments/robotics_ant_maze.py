"""Ant mazes of gymnasium-robotics, `AntMaze_UMaze-v5` and its like, as they are played for a score.

They are tasks of their own, not D4RL's: motors five times as strong (a torque of 150), half the step (0.05 s), success
within 0.45 m, noise of one metre to both sides around start and goal, and the plain ids draw start and goal from the
map's cells. So they have success rates under their own names, and no normalised score.
"""

import re
from collections.abc import Mapping
from typing import Any

_ID = re.compile(r"AntMaze_\w+-v([345])")
# As in D4RL's data: the torso's x and y, then the other 27 numbers; last the goal, for policies that are shown it.
ORDERS = (("achieved_goal", "observation"), ("achieved_goal", "observation", "desired_goal"))


def is_one(identity: Any) -> bool:
    """Whether a gymnasium id, with or without the module that registers it, is one of these mazes."""
    return isinstance(identity, str) and _ID.fullmatch(identity.rpartition(":")[2]) is not None


def evaluation_settings(identity: str) -> Mapping[str, Any]:
    """Arguments with which an id is made where none were given: the goal ends an episode, no contact forces are shown.

    Empty for every other environment.
    """
    match = _ID.fullmatch(identity.rpartition(":")[2])
    if match is None:
        return {}
    without_forces = {"include_cfrc_ext_in_observation": False} if match[1] == "5" else {}
    return {"continuing_task": False, **without_forces}


def reading_of_scores(identity: Any) -> str:
    """What must be known beside scores of one of these mazes; empty for every other environment."""
    if not is_one(identity):
        return ""
    return (
        f"{identity} is gymnasium-robotics' maze, not D4RL's: another body and other starts and goals, so its success "
        "rate has no place beside scores of antmaze-*; those are of odaf/AntMaze-UMaze-v0, -Medium-v0 and -Large-v0"
    )
