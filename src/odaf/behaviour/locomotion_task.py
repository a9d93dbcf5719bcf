"""Running robots as tasks of the online trainer: truncated quantile critics, judged by normalised scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.algorithms.truncated_quantile_critics import TruncatedQuantileCritics
from odaf.behaviour.task import OnlineTask
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.locomotion import TIME_LIMIT, VERSIONS, Simulator, task_of
from odaf.environments.reference_returns import REFERENCES

DROPPED = {"halfcheetah": 2, "hopper": 5, "walker2d": 2}  # atoms dropped for each critic, as in the paper


class LocomotionTask(OnlineTask):
    """HalfCheetah, Hopper or Walker2d."""

    time_limit = TIME_LIMIT
    usual = {"version": VERSIONS[0]}  # noqa: RUF012 (read only)

    def __init__(self, name: str, version: str):
        """Raises `ConfigError` where there is no such robot or version."""
        self.robot, self.version = task_of(name, version), version
        self.environment = self.robot.environment_id(version)
        self.obs_dim, self.act_dim = self.robot.obs_dim, self.robot.act_dim
        self.positions, self.velocities = self.robot.positions, self.robot.velocities
        self.terminates = name != "halfcheetah"

    def body(self, contact_margins: ContactMargins | None) -> Simulator:
        return Simulator(self.robot, self.version, contact_margins)

    def learner(self, batch_size: int) -> TruncatedQuantileCritics:
        return TruncatedQuantileCritics(dropped=DROPPED[self.robot.name], batch_size=batch_size)

    def evaluate(
        self, policy: GaussianPolicy, episodes: int, seed: int, contact_margins: ContactMargins | None
    ) -> dict[str, Any]:
        """Returns of deterministic episodes."""
        returns = play(policy, [self.body(contact_margins) for _ in range(episodes)], seed).returns
        return {
            "environment": self.environment,
            "episodes": episodes,
            "mean_return": float(returns.mean()),
            "std_return": float(returns.std()),
            "normalised_score": REFERENCES[self.robot.family].normalise(float(returns.mean())),
        }

    def in_words(self, line: dict[str, Any]) -> str:
        return f"score {line['normalised_score']:.1f}"


@dataclass(frozen=True)
class Played:
    """One episode in each body: undiscounted returns and rows, both [bodies], and the share of all rows with a fall."""

    returns: np.ndarray
    lengths: np.ndarray
    fall_share: float


def play(policy: GaussianPolicy, simulators: Sequence[Simulator], seed: int, stochastic: bool = False) -> Played:
    """One episode in each body, all in step, each from a start of its own."""
    episodes, act_dim = len(simulators), simulators[0].task.act_dim
    rng = np.random.default_rng(seed)
    observations = np.stack([simulator.reset(int(rng.integers(2**31))) for simulator in simulators])
    returns, lengths, alive = np.zeros(episodes), np.zeros(episodes, int), np.ones(episodes, dtype=bool)
    for _ in range(TIME_LIMIT):
        if stochastic:
            actions = policy.sample(observations, rng.standard_normal((episodes, act_dim), dtype=np.float32))
        else:
            actions = policy.mode(observations)
        for index in np.flatnonzero(alive).tolist():
            observations[index], reward, terminated = simulators[index].step(actions[index])
            returns[index] += reward
            lengths[index] += 1
            alive[index] = not terminated
        if not alive.any():
            break
    falls = int(np.sum(lengths < TIME_LIMIT))  # at the last step the clock counts
    return Played(returns, lengths, falls / int(lengths.sum()))
