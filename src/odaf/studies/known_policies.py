"""Policies of known value: snapshots of the training runs that come with the package, and what they earn."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.job import Record, Work
from odaf.studies.logs import policies_print

if TYPE_CHECKING:
    from odaf.environments.gaussian_policy import GaussianPolicy
    from odaf.training.policy import Policy
    from odaf.training.progress import ProgressReport

DISCOUNTS = (0.99, 1.0)
SIDE_BY_SIDE = 25  # episodes that are played at once


def snapshots(robot: str, every: int = 2) -> "dict[str, GaussianPolicy]":
    """Snapshots of a robot's training run up to its medium policy, every second of them, and the expert; by name.

    They act as trained. The medium policy, which writes the logs, is none of them.
    """
    from odaf.environments.locomotion import task_of
    from odaf.environments.shipped_policies import shipped

    policies = shipped(task_of(robot))
    steps = [
        policies.facts["steps"][phase["index"]] for phase in policies.facts["replay"] if phase["index"] is not None
    ]
    played = [phase.policy for phase in policies.replay if phase.policy is not None]
    found = {f"step-{step}": policy for step, policy in list(zip(steps, played, strict=True))[every - 1 :: every]}
    assert policies.expert is not None
    return {**found, "expert": replace(policies.expert, spread=1.0)}


def as_policy(policy: "GaussianPolicy", observation_names: Sequence[str]) -> "Policy":
    """A shipped policy as one of ours, on raw observations and with actions in [-1, 1]."""
    import jax.numpy as jnp

    from odaf.components.networks import MLP
    from odaf.components.policies import GaussianActor
    from odaf.data.normalisation import Normaliser
    from odaf.training.policy import Policy

    assert policy.spread == 1.0  # the actor has none
    weights, biases = (tuple(map(jnp.asarray, part)) for part in (policy.weights, policy.biases))
    inputs, outputs = policy.weights[0].shape[0], policy.weights[-1].shape[1] // 2
    return Policy(
        GaussianActor(MLP(weights, biases, (), (), "relu")),
        Normaliser(np.zeros(inputs), np.ones(inputs)),
        (-1.0,) * outputs,
        (1.0,) * outputs,
        tuple(observation_names),
    )


def play(
    robot: str, policy: "GaussianPolicy", episodes: int, horizon: int, discounts: Sequence[float], seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Plays a policy that draws its actions.

    Returns:
        Returns of the episodes [discounts, episodes] up to the horizon, and their lengths [episodes].
    """
    from odaf.environments.locomotion import Simulator, task_of
    from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET

    task, rng = task_of(robot), np.random.default_rng(seed)
    simulators = [Simulator(task) for _ in range(min(SIDE_BY_SIDE, episodes))]
    earned, lengths = np.zeros((len(discounts), episodes)), np.zeros(episodes, np.int64)
    for first in range(0, episodes, len(simulators)):
        bodies = simulators[: episodes - first]
        states = np.stack([body.reset(EVALUATION_SEED_OFFSET + first + place) for place, body in enumerate(bodies)])
        running = np.ones(len(bodies), bool)
        for step in range(horizon):
            if not running.any():
                break
            actions = policy.sample(states, rng.standard_normal((len(bodies), task.act_dim), dtype=np.float32))
            for place in np.flatnonzero(running).tolist():
                states[place], reward, fell = bodies[place].step(actions[place])
                earned[:, first + place] += np.power(discounts, step) * reward
                lengths[first + place] += 1
                running[place] = not fell
    return earned, lengths


@dataclass(frozen=True)
class TrueValues(Work):
    """What every snapshot of a robot earns, simulated.

    Attributes:
        robot: as in `hopper`.
        episodes: of each policy.
        horizon: steps of an episode, at most.
        every: which snapshots are taken, see `snapshots`.
        words: of `--only` that ask for it too.
    """

    robot: str
    episodes: int = 100
    horizon: int = 1_000
    every: int = 2
    words: tuple[str, ...] = ()

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"robot": (self.robot,), "log": self.words}

    def identity(self) -> dict[str, Any]:
        return {
            "version": 1,
            "episodes": self.episodes,
            "horizon": self.horizon,
            "every": self.every,
            "discounts": list(DISCOUNTS),
            "policies_sha256": policies_print(f"{self.robot}-medium-replay"),
        }

    def guess(self) -> float:
        return 150.0

    def said(self, record: Record) -> str:
        plain = [values["1.0"]["mean"] for values in record["policies"].values()]
        return f"{len(plain)} policies earn {min(plain):,.0f} to {max(plain):,.0f}"

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        begun, policies = time.monotonic(), snapshots(self.robot, self.every)
        progress.start(f"true values, {self.robot}", len(policies), unit="policies")
        found: dict[str, Any] = {}
        for number, (name, policy) in enumerate(policies.items()):
            earned, lengths = play(self.robot, policy, self.episodes, self.horizon, DISCOUNTS, seed=number)
            found[name] = {
                **{str(discount): _mean_of(returns) for discount, returns in zip(DISCOUNTS, earned, strict=True)},
                "mean_length": float(lengths.mean()),
            }
            progress.advance(number + 1)
        progress.close()
        return {
            "kind": "truth",
            "robot": self.robot,
            "policies": found,
            "identity": self.identity(),
            "versions": _versions(),
            "seconds": time.monotonic() - begun,
        }


def _mean_of(returns: np.ndarray) -> Mapping[str, float]:
    error = float(returns.std(ddof=1) / math.sqrt(len(returns))) if len(returns) > 1 else math.nan
    return {"mean": float(returns.mean()), "standard_error": error}


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {package: version(package) for package in ("gymnasium", "mujoco", "numpy", "jax")}
