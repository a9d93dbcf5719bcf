"""How the ant mazes' sets are recorded, under the names of D4RL's; no simulator is loaded to say it."""

from collections.abc import Mapping
from dataclasses import dataclass

from odaf.environments.ant_maze_map import ANT_MAZES, GOAL_OFFSET


@dataclass(frozen=True)
class MazeSet:
    """How a set is recorded.

    Attributes:
        maze: name in `ANT_MAZES` of the map with the goals of the walks.
        evaluation: name of the map with the goal that rewards refer to.
        environment: where policies of this set are evaluated.
        random_start: whether walks begin anywhere, or in the start's cell.
        steps: of a walk.
    """

    maze: str
    evaluation: str
    environment: str
    random_start: bool
    steps: int

    @property
    def goal(self) -> tuple[float, float]:
        """(x, y) that rewards refer to: the mean of the goals that evaluation draws."""
        maze = ANT_MAZES[self.evaluation]
        x, y = maze.centre(maze.goals[0])
        return x + GOAL_OFFSET, y + GOAL_OFFSET


def _sets(size: str, identity: str, steps: int, collections: Mapping[str, tuple[str, bool]]) -> dict[str, MazeSet]:
    return {
        f"antmaze-{name}": MazeSet(maze, size, f"odaf/AntMaze-{identity}-v0", random_start, steps)
        for name, (maze, random_start) in collections.items()
    }


SETS: Mapping[str, MazeSet] = {
    **_sets("umaze", "UMaze", 700, {"umaze": ("umaze", False), "umaze-diverse": ("umaze-diverse", True)}),
    **_sets("medium", "Medium", 1000, {name: (name, True) for name in ("medium-play", "medium-diverse")}),
    **_sets("large", "Large", 1000, {name: (name, True) for name in ("large-play", "large-diverse")}),
}
NAMES = tuple(SETS)
