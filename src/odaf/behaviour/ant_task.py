"""The walker of the ant mazes as a task of the online trainer, judged by waypoints in sixteen directions."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.algorithms.truncated_quantile_critics import TruncatedQuantileCritics
from odaf.behaviour.task import OnlineTask
from odaf.environments.ant_walker import ACTIONS, POSITIONS, STEP_SECONDS, VELOCITIES, AntWalker
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.gaussian_policy import GaussianPolicy

ACTION_NOISE = 0.2  # standard deviation of what D4RL added to the walker's actions
DISTANCE, ENOUGH_STEPS = 8.0, 150  # metres to a waypoint, and the steps in which a good walker is there
NEAR = 0.5  # metres


class AntTask(OnlineTask):
    """D4RL's ant, shown a direction; an episode ends where it turns over."""

    version = "v0"
    usual = {  # noqa: RUF012 (read only)
        "version": version,
        "steps": 400_000,
        "batch_size": 128,
        "evaluate_every": 10_000,
        "episodes": 16,
        "checkpoint_every": 10_000,
    }
    environment = "odaf ant walker"
    obs_dim, act_dim, positions, velocities = 29, ACTIONS, POSITIONS, VELOCITIES
    time_limit = 1000
    terminates = True

    def body(self, contact_margins: ContactMargins | None) -> AntWalker:
        return AntWalker(contact_margins or "larger")

    def learner(self, batch_size: int) -> TruncatedQuantileCritics:
        """Steers to half a nat less than nothing for each motor, as OGBench's walkers."""
        return TruncatedQuantileCritics(batch_size=batch_size, target_entropy=-0.5 * self.act_dim)

    def evaluate(
        self, policy: GaussianPolicy, episodes: int, seed: int, contact_margins: ContactMargins | None
    ) -> dict[str, Any]:
        """Walks to waypoints around the start, one ant each, actions drawn and noise added as where data are
        recorded."""
        walked = walk(policy, [self.body(contact_margins) for _ in range(episodes)], seed)
        return {
            "environment": self.environment,
            "episodes": episodes,
            "success": float(walked.reached.mean()),
            "mean_speed": float(walked.speeds.mean()),
            "flipped": float(walked.flipped.mean()),
        }

    def in_words(self, line: dict[str, Any]) -> str:
        return f"waypoints {line['success']:.0%}, {line['mean_speed']:.2f} m/s, flipped {line['flipped']:.0%}"


@dataclass(frozen=True)
class Walked:
    """One walk of each ant to a waypoint of its own, all arrays [ants].

    Attributes:
        reached: whether it came within 0.5 m.
        steps: until then, or as many as were played.
        speeds: metres a second on the way there: of the distance that was covered towards the waypoint.
        flipped: whether it turned over.
    """

    reached: np.ndarray
    steps: np.ndarray
    speeds: np.ndarray
    flipped: np.ndarray


def walk(
    policy: GaussianPolicy,
    ants: list[AntWalker],
    seed: int,
    noise: float = ACTION_NOISE,
    most_steps: int = ENOUGH_STEPS,
) -> Walked:
    """Ants walk to waypoints 8 m away, in directions that share the circle evenly.

    Args:
        policy: actions are drawn from it.
        ants: one for each direction.
        seed: of starts and noise.
        noise: standard deviation of what is added to the actions before they are clipped.
        most_steps: after which those who are not there have failed.
    """
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(len(ants)) / len(ants)
    points = DISTANCE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    seeds = rng.integers(2**31, size=len(ants)).tolist()
    observations = np.stack([ant.reset(one, point) for ant, one, point in zip(ants, seeds, points, strict=True)])
    steps = np.full(len(ants), most_steps)
    reached, flipped = np.zeros(len(ants), bool), np.zeros(len(ants), bool)
    left = np.linalg.norm(points - np.stack([ant.position for ant in ants]), axis=1)
    begun = left.copy()
    for step in range(1, most_steps + 1):
        normal = rng.standard_normal((2, len(ants), ACTIONS), dtype=np.float32)
        actions = policy.sample(observations, normal[0]) + noise * normal[1]
        for index in np.flatnonzero(~reached & ~flipped).tolist():
            ant = ants[index]
            _, _, flipped[index] = ant.step(actions[index])
            apart = points[index] - ant.position
            left[index] = np.linalg.norm(apart)
            if left[index] <= NEAR:
                reached[index], steps[index] = True, step
            observations[index] = ant.towards(apart)
    return Walked(reached, steps, (begun - left) / (STEP_SECONDS * steps), flipped)
