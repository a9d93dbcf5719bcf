"""What a stitching log is made of: a maze, kinds of episodes driven in it, and the figures the log must show."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from odaf.environments.controller import DAMPING, POSITION_GAIN
from odaf.environments.maze import CROSSROADS, LADDER, SHAFT, STITCH, Cell, Maze, as_cell
from odaf.errors import ConfigError


@dataclass(frozen=True)
class Driver:
    """How the scripted controller holds the wheel; the defaults are those of the literature.

    Attributes:
        gain: force for a distance of one cell to the waypoint, before it is clipped to [-1, 1].
        damping: force against a velocity of one cell a second.
        noise: standard deviation of what is added to each force; the sum is clipped again.
    """

    gain: float = POSITION_GAIN
    damping: float = DAMPING
    noise: float = 0.0

    def __post_init__(self):
        if not (0.0 < self.gain < math.inf and 0.0 <= self.damping < math.inf and 0.0 <= self.noise < math.inf):
            raise ConfigError(
                f"driver: gain {self.gain}, damping {self.damping}, noise {self.noise}; give finite numbers, a gain "
                "above 0, damping and noise of 0 or more"
            )


@dataclass(frozen=True)
class Route:
    """One kind of episode.

    Attributes:
        name: how statistics call it.
        goals: cells to drive to, in order.
        repeats: episodes of this kind.
        after: once the last goal is reached, "hold" keeps steering to it, "random" draws uniform actions.
        start: cell to begin in; None is the maze's start.
    """

    name: str
    goals: tuple[Cell, ...]
    repeats: int
    after: str = "hold"
    start: Cell | None = None

    def __post_init__(self):
        title = f"route '{self.name}'"
        if not self.goals:
            raise ConfigError(f"{title}: goals is empty; name at least one cell to drive to")
        if self.repeats < 0:
            raise ConfigError(f"{title}: repeats is {self.repeats}; give 0 or more episodes")
        if self.after not in ("hold", "random"):
            raise ConfigError(f"{title}: after is {self.after!r}; known are 'hold' and 'random'")


@dataclass(frozen=True)
class StitchConfig:
    """What to log: a maze, the kinds of episodes driven in it, and the figures the result must show.

    Attributes:
        maze: the map with start, goal and the detour's cells.
        routes: kinds of episodes, logged in this order.
        steps: length of every episode.
        drivers: the episodes of a route are driven by these in turn.
        accept: (figure, lowest, highest) the log must satisfy; none checks nothing. Figures are undiscounted episode
            returns: "mean" and "best" of the whole log, "NAME/mean" and "NAME/best" of the route NAME.
    """

    maze: Maze
    routes: tuple[Route, ...]
    steps: int = 200
    accept: tuple[tuple[str, float, float], ...] = ()
    drivers: tuple[Driver, ...] = (Driver(),)

    def __post_init__(self):
        title = f"stitching data for maze '{self.maze.name}'"
        if not self.drivers:
            raise ConfigError(f"{title}: drivers is empty; name at least one, or leave it out for the usual one")
        if self.steps < 1:
            raise ConfigError(f"{title}: steps is {self.steps}; give the length of an episode, 1 or more")
        if sum(route.repeats for route in self.routes) < 1:
            raise ConfigError(f"{title}: the routes ask for no episode at all; give one of them repeats of 1 or more")
        names = [route.name for route in self.routes]
        if len(set(names)) != len(names):
            raise ConfigError(f"{title}: route names must differ; got {names}")
        for route in self.routes:
            here = self.maze.start if route.start is None else route.start
            for cell in (here, *route.goals):
                if not self.maze.is_free(cell):
                    raise ConfigError(
                        f"{title}: route '{route.name}' visits {cell}, a wall or outside {self.maze.rows}"
                    )
                self.maze.path(here, cell)
        known = {"mean", "best", *(f"{name}/{figure}" for name in names for figure in ("mean", "best"))}
        for name, _, _ in self.accept:
            if name not in known:
                raise ConfigError(f"{title}: accept names '{name}'; known are {sorted(known)}")

    def part(self, percent: int) -> "StitchConfig":
        """The first so many per cent of each route's episodes, of one seed the same ones; without `accept`."""
        routes = tuple(replace(route, repeats=route.repeats * percent // 100) for route in self.routes)
        return self if percent == 100 else replace(self, routes=routes, accept=())

    def driven_by(self, drivers: tuple[Driver, ...]) -> "StitchConfig":
        """The same routes in other hands; without `accept`."""
        return replace(self, drivers=drivers, accept=())

    def with_repeats(self, repeats: int) -> "StitchConfig":
        """The same routes, each logged `repeats` times; without `accept`, whose limits belong to the full size."""
        return replace(self, routes=tuple(replace(route, repeats=repeats) for route in self.routes), accept=())

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores an equal configuration."""
        return {
            "maze": self.maze.to_dict(),
            "routes": [
                {
                    "name": route.name,
                    "goals": [list(cell) for cell in route.goals],
                    "repeats": route.repeats,
                    "after": route.after,
                    "start": None if route.start is None else list(route.start),
                }
                for route in self.routes
            ],
            "steps": self.steps,
            "accept": [list(check) for check in self.accept],
            **({} if self.drivers == (Driver(),) else {"drivers": [asdict(driver) for driver in self.drivers]}),
        }

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "StitchConfig":
        """Inverse of `to_dict`; `ConfigError` names fields that are missing or unknown."""
        _check_fields("stitching data", fields, required={"maze", "routes"}, optional={"steps", "accept", "drivers"})
        maze = Maze.from_dict(fields["maze"])
        title = f"stitching data for maze '{maze.name}'"
        try:
            accept = tuple((str(name), float(low), float(high)) for name, low, high in fields.get("accept", ()))
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{title}: accept must be a list of [figure, lowest, highest] ({error})") from error
        return cls(
            maze=maze,
            routes=tuple(_route(route) for route in fields["routes"]),
            steps=_whole(title, "steps", fields.get("steps", 200)),
            accept=accept,
            drivers=tuple(_driver(driver) for driver in fields.get("drivers", ({},))),
        )


def _driver(fields: Mapping[str, Any]) -> Driver:
    _check_fields("driver", fields, required=set(), optional={"gain", "damping", "noise"})
    try:
        return Driver(**{name: float(value) for name, value in fields.items()})
    except (TypeError, ValueError) as error:
        raise ConfigError(f"driver: {dict(fields)} must hold numbers ({error})") from error


def _route(fields: Mapping[str, Any]) -> Route:
    _check_fields("route", fields, required={"name", "goals", "repeats"}, optional={"after", "start"})
    title, start = f"route '{fields['name']}'", fields.get("start")
    if not isinstance(fields["goals"], (list, tuple)):
        raise ConfigError(f"{title}: goals must be a list of cells (row, column); got {fields['goals']!r}")
    return Route(
        name=str(fields["name"]),
        goals=tuple(as_cell(title, "goals", cell) for cell in fields["goals"]),
        repeats=_whole(title, "repeats", fields["repeats"]),
        after=str(fields.get("after", "hold")),
        start=None if start is None else as_cell(title, "start", start),
    )


def _whole(title: str, field: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ConfigError(f"{title}: {field} is {value!r}; give a whole number")
    return value


def _check_fields(what: str, fields: Mapping[str, Any], required: set[str], optional: set[str]) -> None:
    missing, unknown = required - set(fields), set(fields) - required - optional
    if missing or unknown:
        raise ConfigError(f"{what}: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")


# The paper's task: (2, 2) is the junction, (1, 1) and (2, 1) are the detour.
_PAPER = StitchConfig(
    maze=STITCH,
    routes=(
        Route("junction-1", goals=((2, 2),), repeats=250),
        Route("junction-2", goals=((2, 2),), repeats=250),
        Route("detour-hold", goals=((1, 1), (2, 1), (2, 4)), repeats=250),
        Route("detour-random", goals=((1, 1), (2, 1), (2, 4)), repeats=250, after="random"),
    ),
    accept=(
        ("mean", 40.2, 41.2),
        ("best", 70.0, 75.0),
        ("junction-1/best", 0.0, 36.0),
        ("junction-2/best", 0.0, 36.0),
        ("detour-hold/mean", 51.0, 59.0),
        ("detour-random/mean", 51.0, 59.0),
    ),
)

# The good path is longer and ends round a corner. Limits: the figures of seeds 0 to 2 with some room.
_SHAFT = StitchConfig(
    maze=SHAFT,
    routes=(
        Route("junction-1", goals=((2, 1),), repeats=250),
        Route("junction-2", goals=((2, 1),), repeats=250),
        Route("detour-hold", goals=((1, 2), (2, 2), (4, 2)), repeats=250),
        Route("detour-random", goals=((1, 2), (2, 2), (4, 2)), repeats=250, after="random"),
    ),
    steps=240,
    accept=(
        ("mean", 44.6, 46.2),
        ("best", 80.0, 92.0),
        ("junction-1/best", 0.0, 36.0),
        ("junction-2/best", 0.0, 36.0),
        ("detour-hold/mean", 66.0, 71.5),
        ("detour-random/mean", 62.0, 66.5),
    ),
)

# One more turn to find, and a detour twice as long as the direct way: nobody logged south to east.
_CROSSROADS = StitchConfig(
    maze=CROSSROADS,
    routes=(
        Route("south-to-north", goals=((1, 3),), repeats=250),
        Route("south-to-crossing", goals=((3, 3),), repeats=250),
        Route("detour-hold", goals=((5, 1), (3, 1), (3, 5)), repeats=250),
        Route("detour-random", goals=((5, 1), (3, 1), (3, 5)), repeats=250, after="random"),
    ),
    steps=260,
    accept=(
        ("mean", 33.5, 35.3),
        ("best", 57.0, 68.0),
        ("south-to-north/best", 0.0, 36.0),
        ("south-to-crossing/best", 0.0, 56.0),
        ("detour-hold/mean", 41.5, 46.0),
        ("detour-random/mean", 39.0, 43.5),
    ),
)

# Every driver comes to the goal, half of them by each loop; nobody waits at the joint. Limits: the figures of seeds 0
# to 2 with some room.
_FIRST_LOOP, _SECOND_LOOP = ((1, 1), (1, 3), (3, 3), (3, 5)), ((3, 3), (1, 3), (1, 5), (3, 5))
_LADDER = StitchConfig(
    maze=LADDER,
    routes=(
        Route("first-loop-hold", goals=_FIRST_LOOP, repeats=250),
        Route("first-loop-random", goals=_FIRST_LOOP, repeats=250, after="random"),
        Route("second-loop-hold", goals=_SECOND_LOOP, repeats=250),
        Route("second-loop-random", goals=_SECOND_LOOP, repeats=250, after="random"),
    ),
    steps=300,
    accept=(
        ("mean", 66.8, 69.2),
        ("best", 90.0, 106.0),
        ("first-loop-hold/mean", 65.2, 68.6),
        ("first-loop-random/mean", 59.5, 62.8),
        ("second-loop-hold/mean", 73.0, 77.0),
        ("second-loop-random/mean", 66.6, 70.8),
    ),
)

_HANDS = ((10.0, 1.0), (20.0, 1.0), (6.0, 0.5))
BROAD = tuple(Driver(gain, damping, noise) for noise in (0.0, 0.3, 0.6) for gain, damping in _HANDS)
"""Nine drivers: the usual one, a hasty and a gentle one, each steady, unsteady and more so."""

CONFIGS: Mapping[str, StitchConfig] = {config.maze.name: config for config in (_PAPER, _SHAFT, _CROSSROADS, _LADDER)}
