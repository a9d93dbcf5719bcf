"""Logs without fault, of thirty kinds: what a plant, a controller and a logger of each kind would leave behind."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.faults import plants
from benchmarks.faults.simulation import (
    Controller,
    Memory,
    Plant,
    Rng,
    Rows,
    Tampering,
    feedback,
    joined,
    play,
    uniform,
    wandering,
)

Wrap = Callable[[Controller, Plant], Controller]
Part = tuple[Controller, int]  # who controls, and how many episodes


@dataclass(frozen=True)
class Kind:
    """One kind of sound log.

    Attributes:
        plant: from a generator; the same seed makes the same plant.
        controllers: the parts of the log.
        length: steps of an episode, one number, or the least and the most of them.
        finish: what the logger does to the rows.
        shuffled: whether episodes of the parts are mixed.
    """

    plant: Callable[[Rng], Plant]
    controllers: Callable[[Plant, Rng], list[Part]]
    length: int | tuple[int, int]
    finish: Callable[[Rows, Rng], Rows] = lambda rows, rng: rows
    shuffled: bool = True

    def make(
        self, seed: int, tampering: Tampering | None = None, wrap: Wrap | None = None, length: int | None = None
    ) -> Rows:
        """A log.

        Args:
            tampering: how the plant differs from what the log says.
            wrap: takes the place of each controller.
            length: steps of an episode, in place of the kind's own; as many rows in all.
        """
        rng = np.random.default_rng([seed, 7])
        plant = self.plant(rng)
        parts = []
        for controller, episodes in self.controllers(plant, rng):
            own = self.length
            if length is not None:
                episodes = max(2, round(episodes * np.mean(own) / length))
                own = length
            lengths = own if isinstance(own, int) else rng.integers(own[0], own[1] + 1, episodes)
            if wrap is not None:
                controller = wrap(controller, plant)
            parts.append(play(plant, controller, episodes, lengths, rng, tampering))
        return self.finish(joined(parts, rng if self.shuffled else None), rng)


def one(make: Callable[[Plant], Controller], episodes: int) -> Callable[[Plant, Rng], list[Part]]:
    """One controller for all episodes."""
    return lambda plant, rng: [(make(plant), episodes)]


# ---- what loggers do -----------------------------------------------------------------------------------------------


def rounded(digits: int) -> Callable[[Rows, Rng], Rows]:
    """Sensors with few digits."""

    def finish(rows: Rows, rng: Rng) -> Rows:
        following = rows.next_observations
        assert following is not None
        return replace(
            rows, observations=rows.observations.round(digits), next_observations=following.round(digits)
        )  # fmt: skip

    return finish


def with_columns(make: Callable[[Rows, Rng], tuple[np.ndarray, np.ndarray]]) -> Callable[[Rows, Rng], Rows]:
    """Further columns of observations and of next observations."""

    def finish(rows: Rows, rng: Rng) -> Rows:
        now, after = make(rows, rng)
        assert rows.next_observations is not None
        return replace(
            rows,
            observations=np.concatenate([rows.observations, now], axis=1),
            next_observations=np.concatenate([rows.next_observations, after], axis=1),
        )

    return finish


def constants(rows: Rows, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A column that never changes, and one that is the same within an episode."""
    batch = rng.normal(size=rows.episode.max() + 1)[rows.episode]
    both = np.stack([np.full(len(batch), 4.0), batch], axis=1)
    return both, both


def last_action(rows: Rows, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """The action of the row before, which a controller may know."""
    before = np.roll(rows.actions, 1, axis=0)
    before[rows.starts] = 0.0
    return before, rows.actions


def slow_sensor(rows: Rows, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A laboratory value that is measured every twelfth row and held between."""
    place = np.arange(len(rows.rewards)) - np.repeat(rows.starts, rows.lengths)
    held = rows.observations[np.arange(len(place)) - place % 12, :1]
    after = np.append(held[1:], held[-1:], axis=0)
    ends = np.append(rows.starts[1:], len(place)) - 1
    after[ends] = held[ends]
    return held, after


def clock_and_ageing(rows: Rows, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Hours of operation, and a sensor that wanders off slowly over the whole log."""
    number = np.arange(len(rows.rewards))[:, None] / len(rows.rewards)
    drift = np.concatenate([number * 100, 0.5 * number + 0.02 * np.sin(number * 40)], axis=1)
    return drift, np.append(drift[1:], drift[-1:], axis=0)


# ---- controllers of some kinds -------------------------------------------------------------------------------------


def on_off(plant: Plant) -> Controller:
    """Heats below a temperature until above another."""

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        on = memory.setdefault("on", rng.random(len(seen)) < 0.5)
        wanted = memory.setdefault("wanted", 21 + rng.normal(size=len(seen)))
        on = np.where(seen[:, 0] < wanted - 0.5, True, np.where(seen[:, 0] > wanted + 0.5, False, on))
        # Somebody tries the switch now and then.
        memory["on"] = np.where(rng.random(len(seen)) < 0.03, ~on, on)
        return memory["on"].astype(float)[:, None]

    return act


def level_control(plant: Plant) -> Controller:
    """The operator's rule of thumb for the lower tank, with a hand that is never quite still."""
    rule = feedback(plant, [[0.0, 12.0, -12.0, 0.0]], 0.1, offset=np.array([55.0]), keep=0.8)
    return lambda seen, number, memory, rng: np.round(rule(seen, number, memory, rng), 1)


def feeding(plant: Plant) -> Controller:
    """A recipe that rises with the hours, another in each batch, corrected by the substrate."""

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        start = memory.setdefault("start", rng.uniform(0.3, 0.8, len(seen)))
        rate = memory.setdefault("rate", rng.uniform(0.06, 0.11, len(seen)))
        feed = start * np.exp(rate * seen[:, 4]) - 0.1 * (seen[:, 1] - 3)
        return (feed + 0.1 * rng.normal(size=len(seen)))[:, None]

    return act


def swinging(plant: Plant) -> Controller:
    """Pumps energy into the pendulum, and holds it when it is up."""

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        energy = 0.5 * seen[:, 2] ** 2 + 15 * (seen[:, 0] - 1)
        hold = -4 * seen[:, 1] - seen[:, 2]
        action = np.where(seen[:, 0] > 0.9, hold, np.where(energy < 0, 1, -1) * np.sign(seen[:, 2]))
        return (action + 0.2 * rng.normal(size=len(seen)))[:, None]

    return act


def reaching(noise: float, goal: tuple[float, float] | None = None) -> Callable[[Plant], Controller]:
    """Towards the goal, which is in the last two columns where none is given."""

    def make(plant: Plant) -> Controller:
        def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
            where = seen[:, 4:6] if goal is None else np.array(goal)
            return 3 * (where - seen[:, :2]) - 2 * seen[:, 2:4] + noise * rng.normal(size=(len(seen), 2))

        return act

    return make


def through_the_door(plant: Plant) -> Controller:
    """By way of the door to the goal, with detours that somebody else might have made."""

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        left = seen[:, 0] < 1.02
        target = np.where(left[:, None], [1.1, 0.7], [1.6, 0.3])
        fresh = rng.normal(size=(len(seen), 2))
        memory["z"] = 0.9 * memory.get("z", fresh) + 0.44 * fresh
        return 4 * (target - seen[:, :2]) - 3 * seen[:, 2:4] + 0.6 * memory["z"]

    return act


def gait(noise: float, vigour: float = 1.0) -> Callable[[Plant], Controller]:
    """Drives each joint along its own swing."""

    def make(plant: Plant) -> Controller:
        joints = plant.act_dim
        phase = np.arange(joints) * 1.3

        def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
            speeds = seen[:, joints : 2 * joints]
            beat = memory.setdefault("beat", rng.uniform(0, 2 * np.pi, (len(seen), 1)))
            action = 0.3 * np.tanh(2 * speeds) + 0.4 * np.sin(0.25 * number + beat + phase)
            return vigour * action + noise * rng.normal(size=(len(seen), joints))

        return act

    return make


def ordering(plant: Plant) -> Controller:
    """Orders up to a level, more or less."""

    def act(seen: np.ndarray, number: int, memory: Memory, rng: Rng) -> np.ndarray:
        return np.round(np.clip(28 - seen[:, :1] + 3 * rng.normal(size=(len(seen), 1)), 0, 30))

    return act


def learning(
    make: Callable[[Plant, float], Controller], stages: int, episodes: int
) -> Callable[[Plant, Rng], list[Part]]:
    """A controller that gets better: `make(plant, skill)` for skills from 0 to 1."""
    return lambda plant, rng: [(make(plant, skill), episodes) for skill in np.linspace(0, 1, stages)]


LQR = [[1.0, 0.4]]
POLE = [[-0.1, -0.3, -3.0, -0.8]]


def big(rng: Rng) -> Plant:
    return plants.linear(rng, states=40, actions=6)


KINDS: dict[str, Kind] = {
    "linear, random actions": Kind(plants.linear, one(uniform, 60), 150),
    "linear, wandering actions": Kind(lambda rng: plants.linear(rng, 3, 2), one(wandering, 60), 150),
    "linear, feedback with noise": Kind(
        lambda rng: plants.linear(rng, 4, 2, noise=0.03), one(lambda p: feedback(p, p.gain, 0.2), 60), 150
    ),
    "linear, feedback without noise": Kind(plants.linear, one(lambda p: feedback(p, p.gain, 0.0), 80), 100),
    "noisy sensors": Kind(
        lambda rng: plants.linear(rng, 3, 1, sensor=0.1), one(lambda p: feedback(p, p.gain, 0.2), 60), 150
    ),
    "heavy-tailed disturbances": Kind(
        lambda rng: plants.linear(rng, 3, 1, noise=0.03, tail=3), one(wandering, 60), 150
    ),
    "discretised sensors": Kind(plants.linear, one(uniform, 60), 150, rounded(2)),
    "coarse sensors": Kind(plants.cart, one(lambda p: feedback(p, LQR, 0.4), 60), 150, rounded(1)),
    "constant columns": Kind(plants.linear, one(uniform, 60), 150, with_columns(constants)),
    "last action among observations": Kind(
        lambda rng: plants.linear(rng, 3, 2), one(wandering, 60), 150, with_columns(last_action)
    ),
    "slow laboratory sensor": Kind(plants.linear, one(wandering, 60), 150, with_columns(slow_sensor)),
    "ageing plant": Kind(plants.linear, one(wandering, 60), 150, with_columns(clock_and_ageing)),
    "high dimension": Kind(big, one(wandering, 80), 150),
    "one long episode": Kind(plants.reactor, one(lambda p: wandering(p, 0.97), 1), 12_000),
    "reactor, shifts": Kind(plants.reactor, one(lambda p: wandering(p, 0.9), 40), 250),
    "many short episodes": Kind(plants.cart, one(lambda p: feedback(p, LQR, 0.5), 900), 10),
    "irregular lengths": Kind(plants.cart, one(lambda p: feedback(p, LQR, 0.3), 80), (60, 170)),
    "pole that falls": Kind(plants.pole, one(lambda p: feedback(p, POLE, 0.6), 100), 200),
    "pendulum, random": Kind(plants.pendulum, one(lambda p: wandering(p, 0.8), 60), 200),
    "pendulum, swung up": Kind(plants.pendulum, one(swinging, 60), 200),
    "tanks, level controller": Kind(plants.tank, one(level_control, 30), 400),
    "fermenter": Kind(plants.fermenter, one(feeding, 80), 160),
    "thermostat, on and off": Kind(plants.room, one(on_off, 20), 672),
    "room, proportional": Kind(plants.room, one(lambda p: feedback(p, [[0.4]], 0.2, target=20.5, keep=0.9), 20), 480),
    "arm, goals, sparse reward": Kind(plants.arm, one(reaching(0.8), 200), 50),
    "maze with a door": Kind(plants.maze, one(through_the_door, 300), 150),
    "expert and random": Kind(
        plants.cart, lambda p, rng: [(feedback(p, [[1.2, 1.2]], 0.1), 40), (uniform(p), 40)], 120
    ),
    "medium and expert": Kind(
        plants.pole, lambda p, rng: [(feedback(p, POLE, 0.5), 50), (feedback(p, POLE, 0.05), 50)], 200
    ),
    "replay": Kind(
        plants.cart,
        learning(lambda p, skill: feedback(p, np.multiply(skill, [[1.2, 1.2]]), 0.8 - 0.6 * skill), 10, 10),
        120,
        shuffled=False,
    ),
    "walker, random": Kind(plants.walker, one(lambda p: wandering(p, 0.7), 60), 150),
    "walker, gait": Kind(plants.walker, one(gait(0.2), 60), 150),
    "walker, levels": Kind(plants.walker, lambda p, rng: [(gait(0.1)(p), 30), (gait(0.3, 0.5)(p), 30)], 150),
    "store": Kind(plants.store, one(ordering, 30), 364),
    "dosing, patient by patient": Kind(plants.dosing, one(uniform, 50), 200),
}
