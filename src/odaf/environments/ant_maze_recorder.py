"""Recording ants that are led to their goals: many side by side, one simulator each."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from odaf.environments.ant_maze import AntMaze
from odaf.environments.ant_maze_controller import WaypointController
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET

ACTION_NOISE = 0.2  # standard deviation of what is added to the walker's actions, as in D4RL
MOST_ANTS = 50

_ACTIONS = 8


@dataclass(frozen=True)
class Walks:
    """W walks of T steps, each to a goal of its own.

    Attributes:
        bodies: [W, T + 1, 29] float64, `qpos` and `qvel` before every step and after the last.
        actions: [W, T, 8] float32 in [-1, 1].
        goals: [W, 2] float64, metres.
    """

    bodies: np.ndarray
    actions: np.ndarray
    goals: np.ndarray


def record(
    ants: Sequence[AntMaze],
    walker: GaussianPolicy,
    walks: int,
    steps: int,
    rng: np.random.Generator,
    advance: Callable[[int], None] = lambda steps: None,
    noise: float = ACTION_NOISE,
) -> Walks:
    """Leads ants to their goals and lets them stay there until their time is up; equal arguments give equal bits.

    Actions are drawn from the walker, which is shown a waypoint's direction, noise is added, and the sum is clipped to
    [-1, 1]. No walk is shorter than another, so none is over-counted.

    Args:
        ants: of one maze, in the mode "collection", used side by side.
        walker: see `WaypointController`.
        walks: how many.
        steps: of each.
        rng: source of starts, goals, waypoints and noise.
        advance: called after every step with the number of rows so far.
        noise: standard deviation of what is added.
    """
    bodies = np.empty((walks, steps + 1, 29))
    actions, goals = np.empty((walks, steps, _ACTIONS), np.float32), np.empty((walks, 2))
    controller = WaypointController(ants[0].maze, lambda inputs: inputs)
    # The simulator lets other threads run while it computes.
    with ThreadPoolExecutor(_cores()) as pool:
        for first in range(0, walks, len(ants)):
            group = ants[: walks - first]
            here = slice(first, first + len(group))
            seeds = rng.integers(EVALUATION_SEED_OFFSET, size=len(group)).tolist()
            bodies[here, 0] = [ant.reset(seed=seed)[0] for ant, seed in zip(group, seeds, strict=True)]
            goals[here] = [ant.goal for ant in group]
            for step in range(steps):
                inputs = controller.inputs(bodies[here, step], goals[here], rng)
                normal = rng.standard_normal((2, len(group), _ACTIONS), dtype=np.float32)
                drawn = walker.sample(inputs, normal[0]) + noise * normal[1]
                actions[here, step] = np.clip(drawn, -1.0, 1.0)
                bodies[here, step + 1] = list(pool.map(_stepped, group, actions[here, step]))
                advance(first * steps + (step + 1) * len(group))
    return Walks(bodies, actions, goals)


def _stepped(ant: AntMaze, action: np.ndarray) -> np.ndarray:
    return ant.step(action)[0]


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
