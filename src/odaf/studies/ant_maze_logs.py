"""The logs of the ant mazes: ants led through a maze, told as attempts at one goal."""

import json
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError
from odaf.studies.job import Log

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run

FULL = 1_000_000  # rows of D4RL's sets


@dataclass(frozen=True)
class AntMazeLog(Log):
    """A set of the ant mazes, recorded by the walker that comes with the package. A log of another size than 1,000,000
    rows says so in its name, as `antmaze-umaze-100k`.

    Attributes:
        set_name: as in `antmaze-medium-play`.
        transitions: rows.
        seed: of starts, goals and actions.
    """

    set_name: str
    transitions: int = FULL
    seed: int = 0

    @property
    def name(self) -> str:
        return self.set_name if self.transitions == FULL else f"{self.set_name}-{self.transitions / 1000:g}k"

    def recipe(self) -> dict[str, Any]:
        return {
            "kind": "ant-maze",
            "version": 2,  # 1 went on at the goal of evaluation, an episode a row
            "set": self.set_name,
            "transitions": self.transitions,
            "seed": self.seed,
            "walker_sha256": walker_print(),
        }

    @property
    def command(self) -> str:
        """What records the same set again."""
        return f"odaf data generate {self.set_name} --transitions {self.transitions} --seed {self.seed} --out FILE"

    def make(self, path: Path) -> None:
        from odaf.environments.ant_maze_data import generate

        generate(self.set_name, self.transitions, self.seed).save(path)

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: how many walks reached their own goals and that of evaluation, and how to
        make them again."""
        logged = run.data["summary"]["provenance"]["statistics"]
        names = ("transitions", "whole_walks", "reached_share", "flipped_share", "goal_walks")
        return {"same_set": self.command, **{name: logged.get(name) for name in names}}


@cache
def walker_print() -> str | None:
    """A fingerprint of the shipped walker's parameters; None where none is shipped."""
    from odaf.environments.shipped_policies import shipped_walker

    try:
        policy = shipped_walker().policy
    except ConfigError:
        return None
    digest = sha256(json.dumps(policy.spread).encode())
    for array in (*policy.weights, *policy.biases):
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
