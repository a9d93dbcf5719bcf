"""Small plants of the kinds that people log: tanks, rooms, fermenters, carts, arms, stores."""

from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from benchmarks.faults.simulation import Plant, Rng


def linear(
    rng: Rng,
    states: int = 2,
    actions: int = 1,
    noise: float = 0.02,
    sensor: float = 0.0,
    radius: float = 0.95,
    tail: float | None = None,
    spread: float = 1.0,
) -> Plant:
    """s' = A s + B a + noise: a stable random system, seen through noise of the sensors.

    Args:
        tail: degrees of freedom of Student's t for the noise; None is Gaussian.
        spread: of the starts.
    """
    matrix = rng.normal(size=(states, states))
    turn, _ = np.linalg.qr(matrix)
    a = radius * (0.85 * np.eye(states) + 0.15 * turn)
    b = rng.normal(size=(states, actions)) * 0.15
    weight = rng.uniform(0.3, 1.0, states)

    def disturbance(shape: tuple[int, ...], rng: Rng) -> np.ndarray:
        return noise * (rng.normal(size=shape) if tail is None else rng.standard_t(tail, shape))

    return Plant(
        start=lambda count, rng: spread * rng.normal(size=(count, states)),
        step=lambda s, u, number, rng: s @ a.T + u @ b.T + disturbance(s.shape, rng),
        observe=lambda s, rng: s + sensor * rng.normal(size=s.shape),
        reward=lambda s, u, after: -(weight * s**2).sum(axis=1) - 0.1 * (u**2).sum(axis=1),
        act_dim=actions,
        gain=_best_gain(a, b),
    )


def _best_gain(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[actions, states] feedback that balances squares of states and of actions."""
    value = solve_discrete_are(a, b, np.eye(len(a)), np.eye(b.shape[1]))
    return np.linalg.solve(np.eye(b.shape[1]) + b.T @ value @ b, b.T @ value @ a)


def cart(rng: Rng, dt: float = 0.05, friction: float = 0.1) -> Plant:
    """A mass on a rail: position and speed."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        speed = s[:, 1] + dt * (3 * u[:, 0] - friction * s[:, 1]) + 0.01 * rng.normal(size=len(s))
        return np.stack([s[:, 0] + dt * speed, speed], axis=1)

    return Plant(
        start=lambda count, rng: rng.normal(size=(count, 2)) * [1.0, 0.3],
        step=step,
        observe=lambda s, rng: s.copy(),
        reward=lambda s, u, after: -(s[:, 0] ** 2) - 0.5 * s[:, 1] ** 2 - 0.05 * u[:, 0] ** 2,
    )


def pendulum(rng: Rng, dt: float = 0.05) -> Plant:
    """Angle as cosine and sine, and speed; heavy enough that it must be swung up."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        speed = np.clip(s[:, 1] + dt * (15 * np.sin(s[:, 0]) + 6 * u[:, 0]), -8, 8)
        return np.stack([s[:, 0] + dt * speed, speed], axis=1)

    return Plant(
        start=lambda count, rng: np.stack([rng.uniform(-np.pi, np.pi, count), rng.uniform(-1, 1, count)], axis=1),
        step=step,
        observe=lambda s, rng: np.stack([np.cos(s[:, 0]), np.sin(s[:, 0]), s[:, 1]], axis=1),
        reward=lambda s, u, after: (
            -(np.arctan2(np.sin(s[:, 0]), np.cos(s[:, 0])) ** 2) - 0.1 * s[:, 1] ** 2 - 0.01 * u[:, 0] ** 2
        ),
    )


def pole(rng: Rng, dt: float = 0.02) -> Plant:
    """A pole on a cart, that ends when it falls."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        x, v, angle, turn = s.T
        force = 10 * u[:, 0]
        sine, cosine = np.sin(angle), np.cos(angle)
        temp = (force + 0.05 * turn**2 * sine) / 1.1
        swing = (9.8 * sine - cosine * temp) / (0.5 * (4 / 3 - 0.1 * cosine**2 / 1.1))
        push = temp - 0.05 * swing * cosine / 1.1
        return np.stack([x + dt * v, v + dt * push, angle + dt * turn, turn + dt * swing], axis=1)

    return Plant(
        start=lambda count, rng: rng.uniform(-0.05, 0.05, (count, 4)),
        step=step,
        observe=lambda s, rng: s.copy(),
        reward=lambda s, u, after: 1.0 - 0.1 * u[:, 0] ** 2 - 0.05 * s[:, 0] ** 2,
        ended=lambda s: (np.abs(s[:, 2]) > 0.21) | (np.abs(s[:, 0]) > 2.4),
    )


def fermenter(rng: Rng) -> Plant:
    """Fed batch: biomass, substrate, product, volume and hours; the feed is the action, product at the end counts."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        biomass, substrate, product, volume, hours = s.T
        feed = u[:, 0] * 0.05
        growth = 0.25 * substrate / (0.3 + substrate + substrate**2 / 8) * np.exp(0.02 * rng.normal(size=len(s)))
        dt = 0.25
        volume_after = volume + dt * feed
        thin = feed / volume
        return np.stack(
            [
                np.maximum(biomass + dt * (growth * biomass - thin * biomass), 1e-3),
                np.maximum(substrate + dt * (-growth * biomass / 0.5 + thin * (120 - substrate)), 0.0),
                product + dt * (0.08 * growth * biomass + 0.004 * biomass - thin * product),
                volume_after,
                hours + dt,
            ],
            axis=1,
        )  # fmt: skip

    return Plant(
        start=lambda count, rng: np.stack(
            [
                0.5 * np.exp(0.2 * rng.normal(size=count)),
                3 * np.exp(0.2 * rng.normal(size=count)),
                np.zeros(count),
                np.full(count, 5.0),
                np.zeros(count),
            ],
            axis=1,
        ),
        step=step,
        observe=lambda s, rng: s * np.exp([0.01, 0.02, 0.02, 0.0, 0.0] * rng.normal(size=s.shape)),
        reward=lambda s, u, after: after[:, 2] * after[:, 3] - s[:, 2] * s[:, 3] - 0.02 * u[:, 0],
        bounds=(0.0, 4.0),
    )


def room(rng: Rng) -> Plant:
    """Temperature of a heated room, of its walls, outside, and the hour; the heater is the action."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        air, wall, outside, hour = s.T
        air_after = air + 0.15 * (wall - air) + 0.04 * (outside - air) + 1.8 * u[:, 0] + 0.03 * rng.normal(size=len(s))
        wall_after = wall + 0.03 * (air - wall) + 0.01 * (outside - wall)
        mean = 6 + 5 * np.sin((hour - 9) / 24 * 2 * np.pi)
        outside_after = outside + 0.05 * (mean - outside) + 0.15 * rng.normal(size=len(s))
        return np.stack([air_after, wall_after, outside_after, (hour + 0.25) % 24], axis=1)

    return Plant(
        start=lambda count, rng: np.stack(
            [
                19 + rng.normal(size=count),
                17 + rng.normal(size=count),
                6 + 3 * rng.normal(size=count),
                rng.uniform(0, 24, count),
            ],
            axis=1,
        ),
        step=step,
        observe=lambda s, rng: s + [0.05, 0.05, 0.05, 0.0] * rng.normal(size=s.shape),
        reward=lambda s, u, after: -((after[:, 0] - 21) ** 2) - 0.3 * u[:, 0],
        bounds=(0.0, 1.0),
    )


def tank(rng: Rng) -> Plant:
    """Two tanks in a row, a wanted level that changes now and then, and an inflow that nobody controls."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        upper, lower, wanted, inflow = s.T
        flow, drain = 0.08 * np.sqrt(np.maximum(upper, 0)), 0.08 * np.sqrt(np.maximum(lower, 0))
        change = rng.random(len(s)) < 0.02
        return np.stack(
            [
                np.clip(upper + 0.0025 * u[:, 0] + 0.03 * inflow - flow, 0, 10),
                np.clip(lower + flow - drain + 0.002 * rng.normal(size=len(s)), 0, 10),
                np.where(change, rng.uniform(1, 6, len(s)), wanted),
                0.97 * inflow + 0.06 * rng.normal(size=len(s)),
            ],
            axis=1,
        )

    return Plant(
        start=lambda count, rng: np.stack(
            [
                rng.uniform(1, 6, count),
                rng.uniform(1, 6, count),
                rng.uniform(1, 6, count),
                0.3 * rng.normal(size=count),
            ],
            axis=1,
        ),
        step=step,
        observe=lambda s, rng: s + [0.01, 0.01, 0.0, 0.01] * rng.normal(size=s.shape),
        reward=lambda s, u, after: -np.abs(after[:, 1] - s[:, 2]) - 1e-4 * u[:, 0],
        bounds=(0.0, 100.0),
    )


def reactor(rng: Rng) -> Plant:
    """A stirred tank with a reaction: concentration, temperature, jacket, and two actions (coolant, feed)."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        c, temperature, jacket, fouling = s.T
        rate = 0.1 * c * np.exp((temperature - 350) / 40)
        feed = 0.05 * (1 + 0.5 * u[:, 1])
        return np.stack(
            [
                np.clip(c + feed * (1 - c) - rate + 0.002 * rng.normal(size=len(s)), 0, 1),
                temperature + 60 * rate - feed * (temperature - 330) - 0.1 * fouling * (temperature - jacket)
                + 0.05 * rng.normal(size=len(s)),
                jacket + 0.3 * (320 - 15 * u[:, 0] - jacket) + 0.05 * rng.normal(size=len(s)),
                np.maximum(fouling - 2e-5, 0.5),
            ],
            axis=1,
        )  # fmt: skip

    return Plant(
        start=lambda count, rng: np.stack(
            [
                rng.uniform(0.3, 0.8, count),
                rng.uniform(340, 360, count),
                rng.uniform(315, 325, count),
                np.ones(count),
            ],
            axis=1,
        ),
        step=step,
        observe=lambda s, rng: s[:, :3] + [0.002, 0.1, 0.1] * rng.normal(size=(len(s), 3)),
        reward=lambda s, u, after: (
            10 * 0.1 * s[:, 0] * np.exp((s[:, 1] - 350) / 40) - 0.001 * (s[:, 1] - 350) ** 2 - 0.05 * u[:, 0] ** 2
        ),
        act_dim=2,
    )


def arm(rng: Rng, goals: bool = True) -> Plant:
    """A hand in the plane that should reach a goal, which is another in each episode; the reward says only success."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        speed = 0.7 * s[:, 2:4] + 0.05 * u + 0.003 * rng.normal(size=(len(s), 2))
        return np.concatenate([np.clip(s[:, :2] + speed, -1, 1), speed, s[:, 4:6]], axis=1)

    def start(count: int, rng: Rng) -> np.ndarray:
        goal = rng.uniform(-0.8, 0.8, (count, 2)) if goals else np.tile([0.5, 0.5], (count, 1))
        return np.concatenate([rng.uniform(-0.8, 0.8, (count, 2)), np.zeros((count, 2)), goal], axis=1)

    return Plant(
        start=start,
        step=step,
        observe=lambda s, rng: s[:, : 6 if goals else 4].copy(),
        reward=lambda s, u, after: (np.linalg.norm(after[:, :2] - after[:, 4:6], axis=1) < 0.15).astype(float),
        act_dim=2,
    )


def walker(rng: Rng, joints: int = 6) -> Plant:
    """Joints that swing, coupled, with stops that they hit: angles and speeds, forward speed earns."""
    stiffness = rng.uniform(4, 10, joints)
    coupling = 0.5 * rng.normal(size=(joints, joints)) / np.sqrt(joints)
    direction = rng.normal(size=joints)

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        angles, speeds, body = s[:, :joints], s[:, joints : 2 * joints], s[:, -1]
        for _ in range(2):
            force = 18 * u - stiffness * np.sin(angles) - 0.8 * speeds + 2 * np.tanh(angles @ coupling.T)
            speeds = speeds + 0.02 * force
            angles = angles + 0.02 * speeds
            stop = np.abs(angles) > 1.2
            angles = np.clip(angles, -1.2, 1.2)
            speeds = np.where(stop, -0.3 * speeds, speeds)
        body = 0.9 * body + 0.1 * np.tanh(speeds @ direction / 4)
        return np.concatenate([angles, speeds, body[:, None]], axis=1)

    return Plant(
        start=lambda count, rng: 0.05 * rng.normal(size=(count, 2 * joints + 1)),
        step=step,
        observe=lambda s, rng: s.copy(),
        reward=lambda s, u, after: after[:, -1] - 0.05 * (u**2).sum(axis=1),
        act_dim=joints,
    )


def store(rng: Rng) -> Plant:
    """Stock and what is on its way, in whole pieces; demand by the day of the week; orders arrive the next day."""

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        stock, _, day = s.T
        demand = rng.poisson(8 + 4 * np.sin(day / 7 * 2 * np.pi))
        stock = np.clip(stock + np.round(u[:, 0]) - demand, 0, 80)
        return np.stack([stock, demand, (day + 1) % 7], axis=1)

    def start(count: int, rng: Rng) -> np.ndarray:
        return np.stack([rng.integers(5, 40, count), rng.poisson(8, count), rng.integers(0, 7, count)], axis=1)

    return Plant(
        start=start,
        step=step,
        observe=lambda s, rng: s.astype(float),
        reward=lambda s, u, after: 0.5 * np.minimum(after[:, 1], s[:, 0]) - 0.05 * s[:, 0] - 0.1 * u[:, 0],
        bounds=(0.0, 30.0),
    )


def dosing(rng: Rng) -> Plant:
    """Patients one after the other: what is seen of the next has nothing to do with the last; the dose earns."""
    weight = rng.normal(size=4)

    return Plant(
        start=lambda count, rng: rng.normal(size=(count, 4)),
        step=lambda s, u, number, rng: rng.normal(size=s.shape),
        observe=lambda s, rng: s.copy(),
        reward=lambda s, u, after: -((u[:, 0] - np.tanh(s @ weight)) ** 2),
    )


def maze(rng: Rng) -> Plant:
    """A point in two rooms with a door between them; walls stop it; the goal, in the far room, earns and ends."""
    goal = np.array([1.6, 0.3])

    def step(s: np.ndarray, u: np.ndarray, number: int, rng: Rng) -> np.ndarray:
        speed = 0.8 * s[:, 2:] + 0.04 * u + 0.004 * rng.normal(size=(len(s), 2))
        place = s[:, :2] + speed
        blocked = ((s[:, 0] < 1) != (place[:, 0] < 1)) & (np.abs(place[:, 1] - 0.7) > 0.2)
        speed[:, 0] = np.where(blocked, -0.1 * speed[:, 0], speed[:, 0])
        place[:, 0] = np.where(blocked, s[:, 0], place[:, 0])
        inside = np.clip(place, [0.0, 0.0], [2.0, 1.0])
        speed = np.where(inside != place, 0.0, speed)
        return np.concatenate([inside, speed], axis=1)

    def reached(s: np.ndarray) -> Any:
        return np.linalg.norm(s[:, :2] - goal, axis=1) < 0.15

    return Plant(
        start=lambda count, rng: np.concatenate(
            [rng.uniform([0.1, 0.1], [0.6, 0.9], (count, 2)), np.zeros((count, 2))], axis=1
        ),
        step=step,
        observe=lambda s, rng: s.copy(),
        reward=lambda s, u, after: reached(after).astype(float),
        act_dim=2,
        ended=reached,
    )
