"""Logs of scripted drivers in a maze: no episode takes the good path, yet its pieces are all there.

The default configuration rebuilds the PointMaze task of the MBRCSL paper (Zhou et al. 2024): half of the episodes
drive from the start to a junction and wait; the other half reach the goal, but by a detour that crosses the junction.
The best policy drives start, junction, goal, which nobody logged.

Differs from the original: all 200 transitions of an episode are kept, since the simulator hands us the last successor
(the original stored none and dropped the row), so the rewards in the file sum to the episode's true return.
"""

import math
from collections.abc import Mapping
from importlib.metadata import version
from itertools import cycle, islice
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.data.dataset import Dataset
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.controller import WaypointController
from odaf.environments.maze import Cell, Maze
from odaf.environments.registry import point_maze
from odaf.environments.stitch_config import CONFIGS, Driver, Route, StitchConfig

if TYPE_CHECKING:
    from odaf.environments.point_maze import PointMaze

__all__ = ["CONFIGS", "Driver", "Route", "StitchConfig", "direct_controller_return", "generate"]

USUAL = Driver()
GOAL_NOISE = 0.25  # a driver's goal is a cell's centre plus U(-0.25, 0.25) in x and y
REACHED_DISTANCE = 0.5
REACHED_SPEED = 0.5
ENVIRONMENT_SEEDS = 1000  # episodes start from a seed below this, so start and target noise repeat


def generate(
    config: StitchConfig = CONFIGS["stitch"], seed: int = 0, contact_margins: ContactMargins | None = None
) -> Dataset:
    """Drives every route of `config` and logs it; one seed gives the same bits on the same machine and versions.

    `provenance` of the result holds the configuration, the seed, the simulator's versions, the environment's
    description, the returns of the whole log and of each route under "statistics", and whether they lie within
    `config.accept` under "acceptance"; each figure that does not is also a finding. The limits are statistical: the
    best of some hundred episodes misses its limits for some seeds. `contact_margins` says how the simulator counts
    them, see `odaf.environments.contact_margins`; what is given is recorded.
    """
    environment = point_maze(config.maze, config.steps, contact_margins)
    rule = {} if contact_margins is None else {"contact_margins": contact_margins}
    logs, owners = [], []
    for index, (route, stream) in enumerate(
        zip(config.routes, np.random.SeedSequence(seed).spawn(len(config.routes)), strict=True)
    ):
        rng = np.random.default_rng(stream)
        drivers = islice(cycle(config.drivers), route.repeats)
        logs += [_drive(environment, config, route, rng, driver) for driver in drivers]
        owners += [index] * route.repeats

    states, actions, rewards = (np.concatenate(column) for column in zip(*logs, strict=True))
    states = states.reshape(len(logs), config.steps + 1, 4)
    returns = rewards.reshape(len(logs), config.steps).sum(axis=1)
    truncated = np.zeros((len(logs), config.steps), bool)
    truncated[:, -1] = True
    statistics = _statistics(config, returns, np.array(owners))
    source = f"stitching data for maze '{config.maze.name}', seed {seed}"
    acceptance = _acceptance(config, statistics)
    return Dataset.from_arrays(
        states[:, :-1].reshape(-1, 4),
        actions,
        rewards,
        states[:, 1:].reshape(-1, 4),
        truncated=truncated.reshape(-1),
        action_bounds=(-1.0, 1.0),
        observation_names=("x", "y", "vx", "vy"),
        action_names=("force_x", "force_y"),
        provenance={
            "generator": "odaf.environments.stitch_data",
            "seed": seed,
            "config": config.to_dict(),
            "environment": {"name": "pointmaze", "maze": config.maze.to_dict(), "steps": config.steps} | rule,
            "versions": {name: version(name) for name in ("gymnasium", "gymnasium-robotics", "mujoco", "numpy")} | rule,
            "statistics": statistics,
            "acceptance": acceptance,
            "findings": _acceptance_findings(acceptance),
        },
        source=source,
    )


def direct_controller_return(
    config: StitchConfig = CONFIGS["stitch"], episodes: int = 50, seed: int = 0, knows_target: bool = True
) -> np.ndarray:
    """[episodes] returns of the scripted driver sent from the start straight to the goal, where it stays.

    With `knows_target` it heads for the hidden target, which no policy can see: a ceiling (136 on average in the
    paper's maze). Without, it heads for the goal's cell like the logged drivers do (110): what a policy that is no
    faster than the drivers can expect from joining their paths.
    """
    environment = point_maze(config.maze, config.steps)
    route = Route("direct", goals=(config.maze.goal,), repeats=episodes)
    rng = np.random.default_rng(seed)
    returns = [_drive(environment, config, route, rng, aim_at_target=knows_target)[2].sum() for _ in range(episodes)]
    return np.array(returns)


def _drive(
    environment: "PointMaze",
    config: StitchConfig,
    route: Route,
    rng: np.random.Generator,
    driver: Driver = USUAL,
    aim_at_target: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One episode: (states [steps + 1, 4], actions [steps, 2], rewards [steps]), all float64."""
    states = np.empty((config.steps + 1, 4))
    actions = np.empty((config.steps, 2))
    rewards = np.empty(config.steps)
    start = config.maze.start if route.start is None else route.start
    environment.reset(seed=int(rng.integers(ENVIRONMENT_SEEDS)), options={"start": start})
    state = states[0] = environment.state
    controller = WaypointController(config.maze, rng, driver.gain, driver.damping)
    current, wandering = 0, False
    goal = environment.target if aim_at_target else _noisy_goal(config.maze, route.goals[0], rng)
    for step in range(config.steps):
        final = current == len(route.goals) - 1
        if not wandering and _reached(state, goal, slow=not (final and route.after == "random")):
            if not final:
                current += 1
                goal = _noisy_goal(config.maze, route.goals[current], rng)
            elif route.after == "random":
                wandering = True
        if wandering:
            action = rng.uniform(-1.0, 1.0, 2)
        elif driver.noise:
            action = np.clip(controller.act(state, goal) + driver.noise * rng.standard_normal(2), -1.0, 1.0)
        else:
            action = controller.act(state, goal)
        actions[step] = action
        _, rewards[step], _, _, _ = environment.step(action)
        state = states[step + 1] = environment.state
    return states, actions, rewards


def _noisy_goal(maze: Maze, cell: Cell, rng: np.random.Generator) -> tuple[float, float]:
    x, y = maze.centre(cell)
    right, up = rng.uniform(-GOAL_NOISE, GOAL_NOISE, 2).tolist()
    return x + right, y + up


def _reached(state: tuple[float, float, float, float], goal: tuple[float, float], slow: bool) -> bool:
    near = math.dist(state[:2], goal) <= REACHED_DISTANCE
    return near and (not slow or max(abs(state[2]), abs(state[3])) <= REACHED_SPEED)


def _statistics(config: StitchConfig, returns: np.ndarray, owners: np.ndarray) -> dict[str, Any]:
    def figures(values: np.ndarray) -> dict[str, Any]:
        return {
            "episodes": len(values),
            "mean": float(values.mean()),
            "std": float(values.std()),
            "best": float(values.max()),
            "worst": float(values.min()),
        }

    routes = {
        route.name: figures(returns[owners == index]) for index, route in enumerate(config.routes) if route.repeats > 0
    }
    return {**figures(returns), "routes": routes}


def _acceptance(config: StitchConfig, statistics: Mapping[str, Any]) -> dict[str, Any]:
    checks = []
    for name, low, high in config.accept:
        route, _, figure = name.rpartition("/")
        value = (statistics["routes"][route] if route else statistics)[figure]
        checks.append({"figure": name, "value": value, "lowest": low, "highest": high, "passed": low <= value <= high})
    return {"passed": all(check["passed"] for check in checks) if checks else None, "checks": checks}


def _acceptance_findings(acceptance: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "finding": "acceptance-failed",
            "count": 1,
            "message": f"return {check['figure']} is {check['value']:.2f}, expected "
            f"[{check['lowest']:g}, {check['highest']:g}]: an unlucky seed, or another simulator or other routes than "
            "those the limits were measured with",
        }
        for check in acceptance["checks"]
        if not check["passed"]
    ]
