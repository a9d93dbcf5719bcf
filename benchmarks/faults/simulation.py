"""Plays controllers in small plants, many episodes side by side, and writes down what a logger would."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Rng = np.random.Generator
Memory = dict[str, Any]
Controller = Callable[[np.ndarray, int, Memory, Rng], np.ndarray]
"""(observations [episodes, obs_dim], number of the step, its own memory, generator) -> actions [episodes, act_dim]."""


@dataclass(frozen=True)
class Plant:
    """What is controlled; each function works on all episodes at once.

    Attributes:
        start: (episodes, generator) -> states [episodes, state].
        step: (states, actions, number of the step, generator) -> next states.
        observe: (states, generator) -> observations.
        reward: (states, actions, next states) -> [episodes].
        bounds: (low, high) of the actions, one number or one per action.
        act_dim: number of actions.
        ended: next states -> [episodes] whether the task ended there; None never ends.
        gain: [act_dim, obs_dim] a feedback that suits it, where one was computed.
    """

    start: Callable[[int, Rng], np.ndarray]
    step: Callable[[np.ndarray, np.ndarray, int, Rng], np.ndarray]
    observe: Callable[[np.ndarray, Rng], np.ndarray]
    reward: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    bounds: tuple[Any, Any] = (-1.0, 1.0)
    act_dim: int = 1
    ended: Callable[[np.ndarray], np.ndarray] | None = None
    gain: np.ndarray | None = None

    def clip(self, actions: np.ndarray) -> np.ndarray:
        """Actions as the actuators take them."""
        return np.clip(actions, self.bounds[0], self.bounds[1])

    @property
    def middle(self) -> np.ndarray:
        """[act_dim] half way between the bounds."""
        return np.broadcast_to((np.asarray(self.bounds[0]) + np.asarray(self.bounds[1])) / 2, (self.act_dim,))


@dataclass(frozen=True)
class Tampering:
    """How the plant is told apart from what the log says of it.

    Attributes:
        delay: rows between an action and its effect.
        idle: actions whose effect is nil, by number; the plant gets those of another episode in their place.
    """

    delay: int = 0
    idle: tuple[int, ...] = ()


@dataclass
class Rows:
    """A log in the making: [rows, ...] columns, rows in time order inside each episode, as in `odaf.data.log.Log`."""

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    episode: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    bounds: tuple[Any, Any]
    next_observations: np.ndarray | None = None
    keep_ids: bool = True

    @property
    def starts(self) -> np.ndarray:
        """First row of each episode."""
        return np.flatnonzero(np.append(True, self.episode[1:] != self.episode[:-1]))

    @property
    def lengths(self) -> np.ndarray:
        """Rows of each episode."""
        return np.diff(np.append(self.starts, len(self.rewards)))


def play(
    plant: Plant,
    controller: Controller,
    episodes: int,
    lengths: int | np.ndarray,
    rng: Rng,
    tampering: Tampering | None = None,
) -> Rows:
    """Episodes of one controller, one after the other.

    Args:
        lengths: steps after which the recording is cut, one number or one per episode.
    """
    tampering = tampering or Tampering()
    lengths = np.broadcast_to(np.asarray(lengths), (episodes,))
    state = plant.start(episodes, rng)
    memory: Memory = {}
    waiting = [np.tile(plant.middle, (episodes, 1)).astype(float) for _ in range(tampering.delay)]
    alive = np.ones(episodes, bool)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("o", "a", "r", "n", "terminated", "alive")}
    seen = plant.observe(state, rng)
    for number in range(int(lengths.max())):
        action = plant.clip(controller(seen, number, memory, rng))
        waiting.append(action)
        applied = waiting.pop(0)
        if tampering.idle:
            applied = applied.copy()
            for index in tampering.idle:
                low, high = (np.broadcast_to(edge, (plant.act_dim,))[index] for edge in plant.bounds)
                others = rng.permutation(applied[:, index])
                applied[:, index] = others if episodes > 1 else rng.uniform(low, high, 1)
        following = plant.step(state, applied, number, rng)
        over = plant.ended(following) if plant.ended is not None else np.zeros(episodes, bool)
        after = plant.observe(following, rng)
        entries = (seen, action, plant.reward(state, action, following), after, over, alive.copy())
        for column, entry in zip(columns.values(), entries, strict=True):
            column.append(entry)
        alive &= ~over & (number + 1 < lengths)
        state, seen = following, after
        if not alive.any():
            break
    whole = {name: np.stack(column, axis=1) for name, column in columns.items()}  # [episodes, steps, ...]
    mask = whole.pop("alive")
    flat = {name: values[mask] for name, values in whole.items()}
    episode = np.broadcast_to(np.arange(episodes)[:, None], mask.shape)[mask]
    last = np.append(episode[1:] != episode[:-1], True)
    return Rows(
        flat["o"], flat["a"], flat["r"], episode, flat["terminated"], last & ~flat["terminated"], plant.bounds,
        next_observations=flat["n"],
    )  # fmt: skip


def joined(parts: list[Rows], rng: Rng | None = None) -> Rows:
    """Logs of the same plant as one; with a generator, their episodes in random order."""
    shift = np.cumsum([0, *(part.episode.max() + 1 for part in parts)])
    names = ("observations", "actions", "rewards", "terminated", "truncated", "next_observations")
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    episode = np.concatenate([part.episode + by for part, by in zip(parts, shift[:-1], strict=True)])
    rows = Rows(**columns, episode=episode, bounds=parts[0].bounds)
    return rows if rng is None else of_episodes(rows, rng.permutation(len(rows.starts)))


def of_episodes(rows: Rows, chosen: np.ndarray) -> Rows:
    """The chosen episodes in that order, numbered anew."""
    starts, lengths = rows.starts, rows.lengths
    places = np.concatenate([starts[index] + np.arange(int(lengths[index])) for index in chosen])
    names = ("observations", "actions", "rewards", "terminated", "truncated", "next_observations")
    columns: dict[str, Any] = {name: getattr(rows, name)[places] for name in names}
    return Rows(**columns, episode=np.repeat(np.arange(len(chosen)), lengths[chosen]), bounds=rows.bounds)


# ---- controllers ---------------------------------------------------------------------------------------------------


def uniform(plant: Plant) -> Controller:
    """Every action anew, anywhere between the bounds."""
    low, high = plant.bounds

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        return rng.uniform(low, high, (len(seen), plant.act_dim))

    return act


def wandering(plant: Plant, keep: float = 0.9) -> Controller:
    """Actions that drift: each is near the last."""
    half = (np.asarray(plant.bounds[1]) - np.asarray(plant.bounds[0])) / 2

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        noise = rng.normal(size=(len(seen), plant.act_dim))
        memory["z"] = keep * memory.get("z", noise) + np.sqrt(1 - keep**2) * noise
        return plant.middle + 0.5 * half * memory["z"]

    return act


def feedback(
    plant: Plant, gain: Any, noise: float, target: Any = 0.0, offset: Any = None, keep: float = 0.0
) -> Controller:
    """offset - gain (observations - target), with noise of this share of half the range, kept from step to step."""
    half = (np.asarray(plant.bounds[1]) - np.asarray(plant.bounds[0])) / 2
    matrix = np.atleast_2d(gain)
    base = plant.middle if offset is None else offset

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        fresh = rng.normal(size=(len(seen), plant.act_dim))
        memory["z"] = keep * memory.get("z", fresh) + np.sqrt(1 - keep**2) * fresh
        return base - (seen[:, : matrix.shape[1]] - target) @ matrix.T + noise * half * memory["z"]

    return act
