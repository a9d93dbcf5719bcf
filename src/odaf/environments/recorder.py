"""Recording a policy in the simulator: several bodies side by side, whole episodes in the order they were begun.

Only the last episode is cut.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.in_order import play_in_order
from odaf.environments.locomotion import TIME_LIMIT, Simulator, Task
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET

MOST_SLOTS = 32
STEPS_A_SLOT = 10_000  # fewer steps than this for each body would waste episodes that the record does not need


@dataclass
class Episode:
    """Rows of one episode; while it is played its arrays have room for the time limit."""

    columns: dict[str, np.ndarray]
    length: int = 0
    terminated: bool = False
    finished: bool = False

    def trim(self) -> None:
        """Gives the room back that was not needed."""
        self.columns = {name: column[: self.length].copy() for name, column in self.columns.items()}


def slots_for(transitions: int) -> int:
    """How many bodies play side by side."""
    return min(MOST_SLOTS, max(1, transitions // STEPS_A_SLOT))


def record(
    simulators: Sequence[Simulator],
    policy: GaussianPolicy | None,
    transitions: int,
    rng: np.random.Generator,
    advance: Callable[[int], None] = lambda steps: None,
) -> dict[str, np.ndarray]:
    """Exactly `transitions` rows of one policy; equal arguments give equal bits.

    A fall ends the task (`terminated`); step 1,000 and the end of the record cut it (`truncated`). At step 1,000 the
    cut counts even if the body fell just then, as in the published sets.

    Args:
        simulators: bodies of one task, used side by side; no more than `slots_for` the number of rows are taken.
        policy: stochastic actions are drawn from it; None plays uniform ones.
        transitions: rows wanted.
        rng: source of starts and actions.
        advance: called after every step with the number of steps played.

    Returns:
        Columns with the names of `Dataset`, and `qpos`, `qvel` (before the action, double precision) and
        `action_log_probs`.
    """
    simulators = simulators[: slots_for(transitions)]
    task = simulators[0].task
    current = np.zeros((len(simulators), task.obs_dim))

    def begin(slot: int) -> Episode:
        current[slot] = simulators[slot].reset(int(rng.integers(EVALUATION_SEED_OFFSET)))
        return Episode(_room(task))

    def step(playing: Mapping[int, Episode]) -> None:
        actions, densities = _act(policy, current, task, rng)
        for slot, episode in playing.items():
            current[slot] = _play(simulators[slot], episode, current[slot], actions[slot], densities[slot])
            if episode.finished:
                episode.trim()

    return _cut(play_in_order(len(simulators), transitions, begin, step, advance), transitions)


def _room(task: Task) -> dict[str, np.ndarray]:
    def rows(*shape: int, dtype: type = np.float32) -> np.ndarray:
        return np.empty((TIME_LIMIT, *shape), dtype)

    return {
        "observations": rows(task.obs_dim),
        "actions": rows(task.act_dim),
        "rewards": rows(),
        "next_observations": rows(task.obs_dim),
        "qpos": rows(task.positions, dtype=np.float64),
        "qvel": rows(task.positions, dtype=np.float64),
        "action_log_probs": rows(),
    }


def _act(
    policy: GaussianPolicy | None, observations: np.ndarray, task: Task, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Actions and their log-densities for every slot, those that stand still included."""
    shape = len(observations), task.act_dim
    if policy is None:
        uniform = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
        return uniform, np.full(shape[0], -task.act_dim * math.log(2.0), np.float32)
    return policy.sample_with_density(observations, rng.standard_normal(shape, dtype=np.float32))


def _play(
    simulator: Simulator, episode: Episode, observation: np.ndarray, action: np.ndarray, density: np.floating
) -> np.ndarray:
    """Plays one action and writes its row; returns the next observation."""
    row, columns, positions = episode.length, episode.columns, simulator.task.positions
    body = simulator.body()
    successor, reward, fell = simulator.step(action)
    columns["observations"][row] = observation
    columns["actions"][row] = action
    columns["rewards"][row] = reward
    columns["next_observations"][row] = successor
    columns["qpos"][row], columns["qvel"][row] = body[:positions], body[positions:]
    columns["action_log_probs"][row] = density
    episode.length += 1
    episode.finished = fell or episode.length == TIME_LIMIT
    episode.terminated = fell and episode.length < TIME_LIMIT
    return successor


def _cut(episodes: Sequence[Episode], transitions: int) -> dict[str, np.ndarray]:
    """The episodes' rows one after the other, the last episode cut to reach the number of rows exactly."""
    lengths = [episode.length for episode in episodes]
    surplus = sum(lengths) - transitions
    lengths[-1] -= surplus
    columns = {
        name: np.concatenate([e.columns[name][:n] for e, n in zip(episodes, lengths, strict=True)])
        for name in episodes[0].columns
    }
    ends = np.cumsum(lengths) - 1
    whole = [episode.finished for episode in episodes]
    whole[-1] = whole[-1] and surplus == 0
    terminated, truncated = np.zeros(transitions, bool), np.zeros(transitions, bool)
    terminated[ends] = [e.terminated and w for e, w in zip(episodes, whole, strict=True)]
    truncated[ends] = ~terminated[ends]
    return {**columns, "terminated": terminated, "truncated": truncated}
