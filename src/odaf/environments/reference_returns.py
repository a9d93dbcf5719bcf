"""Normalised scores: of the locomotion tasks, where 0 is a random policy's return and 100 an expert's, and of the ants
in mazes, where they are the share of episodes, in percent, that reach the goal.

The constants are those of the D4RL benchmark, measured once with its own simulator. They stay fixed for every
environment version, so that scores can be laid beside published ones, and every score names the version it was played
in and keeps the raw return beside it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Reference:
    """Undiscounted returns that define 0 and 100, and what these two are, in words."""

    random: float
    expert: float
    meaning: str = "0 random, 100 expert"

    def normalise(self, raw_return: float) -> float:
        """100 (R - random) / (expert - random)."""
        return 100.0 * (raw_return - self.random) / (self.expert - self.random)

    def raw(self, score: float) -> float:
        """Inverse of `normalise`."""
        return self.random + score / 100.0 * (self.expert - self.random)


_SUCCESS = "0 never at the goal, 100 always"

REFERENCES = {
    "HalfCheetah": Reference(random=-280.178953, expert=12135.0),
    "Hopper": Reference(random=-20.272305, expert=3234.3),
    "Walker2d": Reference(random=1.629008, expert=4592.3),
    # Not the mazes of the same name in gymnasium-robotics, which are other tasks; see `robotics_ant_maze`.
    **{f"odaf/AntMaze-{size}": Reference(0.0, 1.0, _SUCCESS) for size in ("UMaze", "Medium", "Large")},
}


def reference_of(environment_id: str) -> Reference | None:
    """The reference returns of a task such as `Hopper-v4`; None where there are none."""
    match = re.fullmatch(r"([\w/-]+)-v\d+", environment_id)
    return REFERENCES.get(match.group(1)) if match else None


def normalised_score(environment_id: str, returns: Sequence[float]) -> dict[str, Any] | None:
    """Mean normalised score, mean raw return and the environment version they belong to; None without a reference."""
    reference = reference_of(environment_id)
    if reference is None or len(returns) == 0:
        return None
    mean = float(sum(returns) / len(returns))
    return {"environment": environment_id, "normalised_score": reference.normalise(mean), "mean_return": mean}
