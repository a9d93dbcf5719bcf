"""Recording ants that are led to their goals: many side by side, one simulator each."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from odaf.environments.ant_maze import SUCCESS_RADIUS, AntMaze
from odaf.environments.ant_maze_controller import WaypointController
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.in_order import play_in_order
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET

ACTION_NOISE = 0.2  # standard deviation of what is added to the walker's actions, as in D4RL
MOST_ANTS = 50
WALKS_AN_ANT = 5  # fewer for each ant would waste walks that the record does not need

_ACTIONS = 8


@dataclass
class Walk:
    """A walk of T steps to a goal of its own; while it is played its arrays have room for the longest one.

    Attributes:
        bodies: [T + 1, 29] float64, `qpos` and `qvel` before every step and after the last.
        actions: [T, 8] float32 in [-1, 1].
        goal: [2] float64, metres.
        length: T, steps so far.
        finished: whether it came to its end.
        arrived: whether its end was at the place where walks end.
    """

    bodies: np.ndarray
    actions: np.ndarray
    goal: np.ndarray
    length: int = 0
    finished: bool = False
    arrived: bool = False

    def trim(self) -> None:
        """Gives the room back that was not needed."""
        self.bodies, self.actions = self.bodies[: self.length + 1].copy(), self.actions[: self.length].copy()


def ants_for(transitions: int, steps: int) -> int:
    """How many ants walk side by side."""
    return min(MOST_ANTS, max(1, transitions // (WALKS_AN_ANT * steps)))


def record(
    ants: Sequence[AntMaze],
    walker: GaussianPolicy,
    transitions: int,
    steps: int,
    rng: np.random.Generator,
    advance: Callable[[int], None] = lambda steps: None,
    noise: float = ACTION_NOISE,
    end: tuple[float, float] | None = None,
) -> list[Walk]:
    """Walks that hold `transitions` steps or more, in the order they were begun; equal arguments give equal bits.

    An ant is led to its goal and stays there until its time is up; then it is put to the start of a new walk. Actions
    are drawn from the walker, which is shown a waypoint's direction, noise is added, and the sum is clipped to [-1, 1].

    Args:
        ants: of one maze, in the mode "collection", used side by side.
        walker: see `WaypointController`.
        transitions: steps wanted; the last walk may hold more than are, or not be over.
        steps: after which a walk's time is up.
        rng: source of starts, goals, waypoints and noise.
        advance: called after every step with the number of steps so far.
        noise: standard deviation of what is added.
        end: a place (x, y), metres; a walk that comes within 0.5 m of it ends there, and none begins in its cell.
    """
    maze, here = ants[0].maze, np.empty((len(ants), 29))
    goals = np.empty((len(ants), 2))
    controller = WaypointController(maze, lambda inputs: inputs)

    def begin(slot: int) -> Walk:
        ant = ants[slot]
        body = ant.reset(seed=int(rng.integers(EVALUATION_SEED_OFFSET)))[0]
        while end is not None and ant.random_start and maze.cell((body[0], body[1])) == maze.cell(end):
            body = ant.reset(seed=int(rng.integers(EVALUATION_SEED_OFFSET)))[0]
        here[slot], goals[slot] = body, ant.goal
        bodies = np.empty((steps + 1, 29))
        bodies[0] = body
        return Walk(bodies, np.empty((steps, _ACTIONS), np.float32), goals[slot].copy())

    def step(playing: Mapping[int, Walk]) -> None:
        inputs = controller.inputs(here, goals, rng)
        normal = rng.standard_normal((2, len(ants), _ACTIONS), dtype=np.float32)
        actions = np.clip(walker.sample(inputs, normal[0]) + noise * normal[1], -1.0, 1.0)
        slots = list(playing)
        after = pool.map(_stepped, [ants[slot] for slot in slots], actions[slots])
        for (slot, walk), body in zip(playing.items(), after, strict=True):
            walk.actions[walk.length] = actions[slot]
            walk.length += 1
            walk.bodies[walk.length] = here[slot] = body
            walk.arrived = end is not None and math.dist(body[:2], end) <= SUCCESS_RADIUS
            walk.finished = walk.arrived or walk.length == steps
            if walk.finished:
                walk.trim()

    # The simulator lets other threads run while it computes.
    with ThreadPoolExecutor(_cores()) as pool:
        walks = play_in_order(len(ants), transitions, begin, step, advance)
    walks[-1].trim()
    return walks


def _stepped(ant: AntMaze, action: np.ndarray) -> np.ndarray:
    return ant.step(action)[0]


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
