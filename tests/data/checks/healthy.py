"""A log without fault, for tests that spoil one thing at a time."""

from typing import Any

import numpy as np

from odaf.data.log import Log

EPISODES, STEPS = 30, 100
ROWS = EPISODES * STEPS


def columns() -> dict[str, np.ndarray]:
    """Thirty episodes of a hundred steps, every third of which is a step shorter and ends by itself.

    Each action moves one of the first two observations, which also walk at random; the reward is noise.
    """
    rng = np.random.default_rng(5)
    lengths = [STEPS - 1 if index % 3 == 0 else STEPS for index in range(EPISODES)]
    found: dict[str, list[np.ndarray]] = {
        name: []
        for name in (
            "observations", "actions", "rewards", "next_observations", "terminated", "truncated", "episode", "time"
        )
    }  # fmt: skip
    for index, length in enumerate(lengths):
        steps = rng.normal(size=(length + 1, 3))
        actions = rng.uniform(-0.9, 0.9, (length, 2))
        steps[1:, :2] += actions
        states = np.cumsum(steps, axis=0)
        last = np.arange(length) == length - 1
        found["observations"].append(states[:-1])
        found["next_observations"].append(states[1:])
        found["actions"].append(actions)
        found["rewards"].append(rng.normal(size=length))
        found["terminated"].append(last & (length < STEPS))
        found["truncated"].append(last & (length == STEPS))
        found["episode"].append(np.full(length, index))
        found["time"].append(0.05 * np.arange(length))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def log(changes: dict[str, Any] | None = None, drop: tuple[str, ...] = (), **settings: Any) -> Log:
    """The log with some columns exchanged or left out."""
    own = {**columns(), **(changes or {})}
    own = {name: values for name, values in own.items() if name not in drop}
    return Log(**{"columns": own, "source": "tank.csv", "format": "csv", "action_bounds": (-1.0, 1.0), **settings})
