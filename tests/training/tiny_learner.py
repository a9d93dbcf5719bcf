"""A learner small enough to train thousands of updates in a test, and a script that trains it, to be killed."""

import dataclasses
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int

from odaf.algorithms.base import Algorithm, LearnerState
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.view import View
from odaf.training import Evaluation, Policy


class TinyState(LearnerState):
    step: Int[Array, ""]
    weights: Float[Array, "obs_dim act_dim"]
    slow: Float[Array, "obs_dim act_dim"]
    offset: Float[Array, " act_dim"]


class TinyActor(Actor):
    weights: Float[Array, "obs_dim act_dim"]
    offset: Float[Array, " act_dim"]

    def act(self, carry, observations, key=None):
        return jnp.tanh(observations @ self.weights + self.offset[None, :]), carry


@dataclasses.dataclass(frozen=True)
class TinyLearner(Algorithm):
    """Noisy least squares with a slow copy and an offset: random keys, batches and every part of a state matter."""

    kind: ClassVar[str] = "tiny"

    learning_rate: float = 0.1
    discount: float = 0.5
    batch_size: int = 8
    blow_up_at: int = -1  # from this update on, metrics leave every range
    value_range: str = "none"
    normaliser_epsilon: float = 0.0

    def view(self):
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def untrained(self, key, spec):
        return jr.normal(key, (spec.act_dim,))

    def pretrain(self, dataset, normaliser, key, progress):
        progress("offset", 1, 1)
        return jr.normal(key, (dataset.act_dim,)), {"error": 0.25, "warnings": ["the offset is random"]}

    def pretraining(self):
        return ()

    def init(self, key, spec, models):
        weights = jr.normal(key, (spec.obs_dim, spec.act_dim))
        return TinyState(jnp.asarray(0), weights, weights, models)  # one buffer twice, as learners may do

    def update(self, state: Any, batch, key):
        error = batch.observations @ state.weights + state.offset[None, :] - batch.actions
        gradient = batch.observations.T @ error / self.batch_size
        noise = 0.01 * jr.normal(key, state.weights.shape)
        weights = state.weights - self.learning_rate * gradient + noise
        blown = jnp.where((self.blow_up_at >= 0) & (state.step >= self.blow_up_at), 1e6, 0.0)
        metrics = {
            "tiny/step": state.step.astype(jnp.float32),
            "tiny/step/max": state.step.astype(jnp.float32),
            "tiny/step/min": state.step.astype(jnp.float32),
            "tiny/loss": jnp.mean(jnp.square(error)),
            "critic/max": blown,
        }
        slow = 0.9 * state.slow + 0.1 * weights
        return TinyState(state.step + 1, weights, slow, state.offset), metrics

    def actor(self, state: Any):
        return TinyActor(state.weights, state.offset)


@dataclasses.dataclass
class TinyEvaluator:
    """Mean action on fixed observations, beside a file, as rollouts would leave one."""

    every: int = 4

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        actions = policy(np.linspace(-1.0, 1.0, 6, dtype=np.float32).reshape(2, 3))
        (directory / "evaluations").mkdir(exist_ok=True)
        np.savez(directory / "evaluations" / f"{step:08d}.npz", actions=actions)
        mean = float(actions.mean())
        return Evaluation({"evaluation/return_mean": mean}, {"mean_return": mean, "returns": [mean]}, mean)

    def to_dict(self) -> dict[str, Any]:
        return {"kind": "tiny", "every": self.every}


def tiny_dataset(rows: int = 60) -> Dataset:
    rng = np.random.default_rng(0)
    return Dataset.from_arrays(
        rng.normal(2.0, 3.0, (rows, 3)),
        rng.uniform(-1.0, 4.0, (rows, 2)),
        rng.uniform(0.0, 1.0, rows),
        next_observations=rng.normal(2.0, 3.0, (rows, 3)),
        truncated=np.arange(rows) % 15 == 14,
        action_bounds=(-1.0, 4.0),
        observation_names=["level", "flow", "heat"],
    )


def arrays_of(directory: Path) -> dict[str, bytes]:
    """The bytes of every checkpoint's arrays."""
    return {str(file.relative_to(directory)): file.read_bytes() for file in sorted(directory.rglob("state.eqx"))}


def lines_of(directory: Path, seed: int = 0) -> list[dict[str, Any]]:
    """Every line of a seed's metrics without what a clock measured; a line that is not JSON raises."""
    text = (directory / f"seed-{seed}" / "metrics.jsonl").read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    return [{name: value for name, value in line.items() if not name.startswith("time/")} for line in lines]


def _die_at(count: int) -> None:
    """Makes the process kill itself just before or just after its `count`-th write to the disk."""
    seen = 0

    def deadly(function):
        def call(*args, **kwargs):
            nonlocal seen
            seen += 1
            if seen == count and count % 2:
                os.kill(os.getpid(), signal.SIGKILL)
            result = function(*args, **kwargs)
            if seen == count:
                os.kill(os.getpid(), signal.SIGKILL)
            return result

        return call

    os.fsync, os.replace = deadly(os.fsync), deadly(os.replace)


if __name__ == "__main__":
    from odaf import training
    from odaf.algorithms.registry import ALGORITHMS

    ALGORITHMS.add(TinyLearner)
    target, steps, die_at = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    if die_at:
        _die_at(die_at)
    training.fit(
        TinyLearner(),
        tiny_dataset(),
        steps=steps,
        directory=target,
        evaluate=TinyEvaluator(every=40),
        checkpoint_every=20,
        stretch=10,
        progress=False,
    )
