"""From a dataset's description of its environment to the environment itself."""

import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from odaf.environments.gymnasium_environment import make_quietly
from odaf.environments.maze import Maze
from odaf.errors import ConfigError

if TYPE_CHECKING:
    import gymnasium

    from odaf.environments.point_maze import PointMaze

_EXTRA = 'pip install "odaf[envs]"'


def make(environment: Mapping[str, Any]) -> "Callable[[], gymnasium.Env]":
    """A function without arguments that builds a fresh environment at each call.

    Args:
        environment: `{"name": "pointmaze", "maze": {...}, "steps": 200}` or
            `{"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}`; JSON types, as found in `Dataset.environment`.

    Raises:
        ConfigError: the description is incomplete or names something unknown, or the simulator is not installed.
    """
    name = environment.get("name")
    if name == "pointmaze":
        _expect(environment, required={"name", "maze"}, optional={"steps"})
        maze, steps = Maze.from_dict(environment["maze"]), int(environment.get("steps", 200))
        if steps < 1:
            raise ConfigError(f"environment 'pointmaze': steps is {steps}; give the time limit, 1 or more")
        build = _point_maze_class()
        return lambda: build(maze, steps)
    if name == "gymnasium":
        _expect(environment, required={"name", "id"}, optional={"kwargs"})
        identity, kwargs = environment["id"], dict(environment.get("kwargs") or {})
        try:
            import gymnasium
        except ImportError as error:
            raise ConfigError(f"environment '{identity}' needs gymnasium ({error}); {_EXTRA}") from error
        try:
            gymnasium.spec(identity)
        except gymnasium.error.Error as error:
            raise ConfigError(f"environment '{identity}': gymnasium does not know it ({error})") from error
        return lambda: make_quietly(identity, **kwargs)
    raise ConfigError(f"environment: name is {name!r}; known are 'pointmaze' and 'gymnasium'")


def make_untimed(environment: Mapping[str, Any]) -> "tuple[Callable[[], gymnasium.Env], int | None]":
    """As `make`, without the time limit, and that limit in steps; None where there is none.

    True ends still end an episode. A limit that an environment keeps itself, inside its own `step`, stays.
    """
    if environment.get("name") == "pointmaze":
        make(environment)  # judges the description as it was given
        return make({**environment, "steps": sys.maxsize}), int(environment.get("steps", 200))
    kwargs = dict(environment.get("kwargs") or {})
    own = kwargs.pop("max_episode_steps", None)
    build = make({**environment, "kwargs": {**kwargs, "max_episode_steps": -1}})
    import gymnasium

    limit = gymnasium.spec(environment["id"]).max_episode_steps if own is None else int(own)
    return build, limit if limit is not None and limit > 0 else None


def point_maze(maze: Maze, steps: int) -> "PointMaze":
    """One point maze; `ConfigError` names the extra to install where the simulator is missing."""
    return _point_maze_class()(maze, steps)


def _point_maze_class() -> "type[PointMaze]":
    try:
        from odaf.environments.point_maze import PointMaze
    except ImportError as error:
        raise ConfigError(f"environment 'pointmaze' needs a simulator that is missing ({error}); {_EXTRA}") from error
    return PointMaze


def _expect(environment: Mapping[str, Any], required: set[str], optional: set[str]) -> None:
    missing, unknown = required - set(environment), set(environment) - required - optional
    if missing or unknown:
        raise ConfigError(
            f"environment '{environment['name']}': missing {sorted(missing)}, unknown {sorted(unknown)}; "
            f"it takes {sorted(required | optional)}"
        )
