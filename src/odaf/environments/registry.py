"""From a dataset's description of its environment to the environment itself."""

import contextlib
import io
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from odaf.environments import contact_margins as margins
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.gymnasium_environment import check_wrappers, make_described
from odaf.environments.maze import Maze
from odaf.errors import ConfigError

if TYPE_CHECKING:
    import gymnasium

    from odaf.environments.point_maze import PointMaze

_EXTRA = 'pip install "odaf[envs]"'


def make(
    environment: Mapping[str, Any], contact_margins: ContactMargins | None = None
) -> "Callable[[], gymnasium.Env]":
    """A function without arguments that builds a fresh environment at each call.

    Args:
        environment: `{"name": "pointmaze", "maze": {...}, "steps": 200}` or
            `{"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}`; JSON types, as found in `Dataset.environment`. The
            latter's id may be `"MODULE:ID"`, which imports the module that registers it, and it may say
            `max_episode_steps` (null: no limit) where the id's own does not hold, and `wrappers`, the innermost first,
            each `{"name": "RescaleAction", "kwargs": {...}}`; both may say `contact_margins`.
        contact_margins: how MuJoCo counts the margins of geoms that touch, see `odaf.environments.contact_margins`;
            in the place of what `environment` says. None leaves it to that, and it to the installed MuJoCo.

    Raises:
        ConfigError: the description is incomplete or names something unknown, or the simulator is not installed.
    """
    name = environment.get("name")
    if contact_margins is not None:
        environment = {**environment, "contact_margins": contact_margins}
    rule = margins.check(environment.get("contact_margins"))
    if name == "pointmaze":
        _expect(environment, required={"name", "maze"}, optional={"steps", "contact_margins"})
        maze, steps = Maze.from_dict(environment["maze"]), int(environment.get("steps", 200))
        if steps < 1:
            raise ConfigError(f"environment 'pointmaze': steps is {steps}; give the time limit, 1 or more")
        build = _point_maze_class()
        return lambda: build(maze, steps, rule)
    if name == "gymnasium":
        extras = {"kwargs", "max_episode_steps", "wrappers", "contact_margins"}
        _expect(environment, required={"name", "id"}, optional=extras)
        identity = environment["id"]
        check_wrappers(identity, environment.get("wrappers", ()))
        try:
            import gymnasium
        except ImportError as error:
            raise ConfigError(f"environment '{identity}' needs gymnasium ({error}); {_EXTRA}") from error
        identity = _imported(identity)
        try:
            _registered(identity)
        except gymnasium.error.Error as error:
            raise ConfigError(
                f"environment '{identity}': gymnasium does not know it ({error}); check the name, or import the "
                "package that registers it"
            ) from error
        described = {**environment, "id": identity}
        return lambda: make_described(described)
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
    own = environment.get("max_episode_steps", own)
    build = make({**environment, "kwargs": kwargs, "max_episode_steps": None})
    import gymnasium

    said = own is not None or "max_episode_steps" in environment
    limit = own if said else gymnasium.spec(_imported(environment["id"])).max_episode_steps
    return build, limit if limit is not None and limit > 0 else None


def _imported(identity: str) -> str:
    """Gymnasium's own name of `MODULE:ID`, once the module that registers it is imported."""
    module, colon, name = identity.partition(":")
    if not colon:
        return identity
    try:
        import_module(module)
    except ImportError as error:
        raise ConfigError(
            f"environment '{identity}': the module {module!r} cannot be imported ({error}); install it, or name its "
            "folder in PYTHONPATH"
        ) from error
    return name


def point_maze(maze: Maze, steps: int, rule: ContactMargins | None = None) -> "PointMaze":
    """One point maze; `ConfigError` names the extra to install where the simulator is missing."""
    return _point_maze_class()(maze, steps, rule)


def _registered(identity: str) -> None:
    """Raises gymnasium's error where neither it, nor this package, nor gymnasium-robotics knows an environment."""
    import gymnasium

    if identity.startswith("odaf/"):
        import_module("odaf.environments.gymnasium_ids")
    try:
        gymnasium.spec(identity)
    except gymnasium.error.Error:
        if "gymnasium_robotics" in sys.modules:
            raise
        try:
            with contextlib.redirect_stderr(io.StringIO()):  # a notice about environments that nobody asked for
                import gymnasium_robotics
        except ImportError:
            gymnasium_robotics = None
        if gymnasium_robotics is None:
            raise
        gymnasium.register_envs(gymnasium_robotics)
        gymnasium.spec(identity)


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
