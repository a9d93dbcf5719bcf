"""Scores of d3rlpy's learners and of ours: the same rows, settings, number of updates and evaluator, on one core.

Each run leaves one JSON file, and a run that has left one is not made again. The policies of both sides are played by
our evaluator, after every `EVERY` updates; d3rlpy's weights are copied into an actor of ours. Seconds are those of the
processor, of training alone: on our side with compilation, on d3rlpy's with its own way of drawing batches.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import odaf
from benchmarks.machine import machine
from benchmarks.parity import weights
from benchmarks.parity.settings import LEARNERS, NORMALISER_EPSILON
from odaf.components.candidates import best_candidate, fixed_normal
from odaf.components.cvae import decoded_draws
from odaf.components.policies import Actor, DeterministicActor, GaussianActor
from odaf.components.ranked_actors import PerturbedActor, RankedGaussianActor, perturbed
from odaf.data.normalisation import Normaliser
from odaf.environments.reference_returns import normalised_score
from odaf.evaluation.rollouts import Rollouts, rollout
from odaf.runs import presets
from odaf.training.policy import Policy

FOLDER = Path(__file__).with_name("scores")
ROOT = Path(__file__).resolve().parents[2]
EPISODES = 20
EVERY = 2_500  # updates between two policies that are played
CANDIDATES = 100  # draws that BCQ and BEAR act with the best of
SIDES = ("odaf", "d3rlpy")


def ours(name: str) -> Any:
    """Our learner with the common settings."""
    return presets.load(name, {**LEARNERS[name], "normaliser_epsilon": NORMALISER_EPSILON})


Policies = dict[int, Policy]  # by the updates made


def train_ours(name: str, dataset: odaf.Dataset, seed: int, updates: int, folder: Path) -> tuple[Policies, dict]:
    """Its policies and how long the training took."""
    start, cpu_start = time.perf_counter(), time.process_time()
    run = odaf.fit(
        ours(name),
        dataset,
        directory=folder / "run",
        steps=updates,
        seeds=(seed,),
        checkpoint_every=min(EVERY, updates),
        keep_checkpoints="all",
        progress=False,
    )
    seconds = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu_start}
    policies = {step: run.policy(seed, step) for step in _steps(updates)}
    return policies, {**seconds, "version": odaf.__version__}


def train_peer(
    name: str, dataset: odaf.Dataset, seed: int, updates: int, folder: Path, python: Path
) -> tuple[Policies, dict]:
    """The same of d3rlpy, in its own interpreter."""
    normaliser = Normaliser.fit(dataset.observations, NORMALISER_EPSILON)
    ends = np.zeros(len(dataset.rewards), bool)
    ends[[*(dataset.episode_starts[1:] - 1), -1]] = True
    returns = dataset.episode_returns()
    np.savez(
        folder / "rows.npz",
        observations=dataset.observations,
        actions=dataset.actions,
        rewards=dataset.rewards[:, None],
        terminals=dataset.terminated.astype(np.float32),
        timeouts=(ends & ~dataset.terminated).astype(np.float32),
        mean=normaliser.mean,
        std=normaliser.std,
        epsilon=NORMALISER_EPSILON,
        reward_scale=1000.0 / (returns.max() - returns.min()),
    )
    out = folder / "weights"
    command = [python, "-m", "benchmarks.parity.peer", "train", "--learner", name, "--data", folder / "rows.npz"]
    command += ["--out", out, "--seed", str(seed), "--updates", str(updates), "--every", str(min(EVERY, updates))]
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, stderr=subprocess.DEVNULL)
    policies, about = {}, {}
    for step in _steps(updates):
        with np.load(out.with_name(f"{out.name}-{step}.npz"), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        about = json.loads(arrays.pop("about").tobytes())
        policies[step] = Policy(
            actor=actor_of(name, arrays),
            normaliser=normaliser,
            action_low=tuple(dataset.action_low.tolist()),
            action_high=tuple(dataset.action_high.tolist()),
            observation_names=dataset.observation_names,
            action_names=dataset.action_names,
        )
    about["version"] = about.pop("peer")
    return policies, about


def _steps(updates: int) -> range:
    """After how many updates policies are played."""
    every = min(EVERY, updates)
    return range(every, updates + 1, every)


class UnsquashedPerturbedActor(PerturbedActor):
    """The best of a decoder's actions as d3rlpy 2.8.1's BCQ has them: without the decoder's tanh."""

    def act(self, carry: Any, observations: Any, key: Any = None) -> tuple[Any, Any]:
        """The candidate that the critic values most, of the same noise at every step."""
        del key
        shape = (self.noise.shape[0], len(observations), self.noise.shape[1])
        actions = decoded_draws(self.decoder, observations, jnp.broadcast_to(self.noise[:, None], shape))
        moved = perturbed(self.perturbation, self.reach, observations, actions)
        return best_candidate(self.critic, observations, moved), carry


def actor_of(name: str, arrays: dict[str, np.ndarray]) -> Actor:
    """What d3rlpy's learner acts with; where it ranks draws, those of the noise that ours ranks."""
    match name:
        case "behaviour-cloning":
            return DeterministicActor(weights.network(arrays, "imitator"))
        case "iql" | "cql":
            return DeterministicActor(weights.network(arrays, "policy", ("_mu",)))
        case "bear":
            proposals = GaussianActor(weights.network(arrays, "policy", ("_mu", "_logstd")))
            width = proposals.network.weights[-1].shape[-1] // 2
            return RankedGaussianActor(proposals, weights.network(arrays, "q_funcs.0"), fixed_normal(CANDIDATES, width))
        case "bcq":
            decoder = weights.network(arrays, "vae_decoder")
            return UnsquashedPerturbedActor(
                decoder=decoder,
                perturbation=weights.network(arrays, "policy"),
                reach=jnp.asarray(LEARNERS[name]["perturbation"]),
                critic=weights.network(arrays, "q_funcs.0"),
                noise=fixed_normal(CANDIDATES, 2 * decoder.weights[-1].shape[-1]),
            )
    return DeterministicActor(weights.network(arrays, "policy"))


def played(policy: Policy, dataset: odaf.Dataset) -> dict[str, Any]:
    """Returns of `EPISODES` episodes, whose starts are the same for every policy, and their normalised mean."""
    rollouts = Rollouts(episodes=EPISODES, seed=0).resolved(dataset.environment)
    returns = rollout(policy, rollouts.maker(), EPISODES, seed=0).returns
    score = normalised_score(rollouts.name, returns.tolist()) or {}
    return {**score, "returns": [round(value, 3) for value in returns.tolist()]}


def score(name: str, side: str, dataset: odaf.Dataset, seed: int, updates: int, python: Path | None) -> dict[str, Any]:
    """Trains and plays one run."""
    with tempfile.TemporaryDirectory() as folder:
        if side == "odaf":
            policies, about = train_ours(name, dataset, seed, updates, Path(folder))
        else:
            assert python is not None
            policies, about = train_peer(name, dataset, seed, updates, Path(folder), python)
        found = {step: played(policy, dataset) for step, policy in policies.items()}
    return {
        "learner": name,
        "side": side,
        "seed": seed,
        "updates": updates,
        **about,
        **found[max(found)],
        "curve": {step: each["normalised_score"] for step, each in found.items()},
        "settings": {**LEARNERS[name], "normaliser_epsilon": NORMALISER_EPSILON},
    }


def main(
    data: Path,
    learners: Sequence[str],
    seeds: Sequence[int],
    updates: int,
    sides: Sequence[str],
    python: Path | None,
    folder: Path = FOLDER,
) -> None:
    """Makes the runs that are missing, every learner of one seed before the next seed, and prints the table."""
    dataset = odaf.Dataset.load(data)
    about = {
        "name": dataset.provenance.get("name", data.stem),
        "rows": len(dataset.rewards),
        "mean_return": float(dataset.episode_returns().mean()),
        "fingerprint": dataset.fingerprint(),
        "locally_generated": True,
    }
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        for name in learners:
            for side in sides:
                path = folder / f"{name}-{side}-seed{seed}-{updates}.json"
                if path.exists():
                    continue
                if side == "d3rlpy" and python is None:
                    print(f"{path.stem}: left out, since no --peer-python is given", file=sys.stderr)
                    continue
                found = score(name, side, dataset, seed, updates, python)
                found |= {"data": about, "machine": machine()}
                path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
                print(f"{path.stem}: {found['normalised_score']:.1f} after {found['seconds']:.0f} s", flush=True)
    print(table(folder))


def table(folder: Path = FOLDER) -> str:
    """All runs that are there, side by side.

    The last policy's score, the mean over seeds and each seed's; the mean of the policies of the second half, each
    seed's; and seconds. Older files hold the last policy only.
    """
    runs = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    parts = ["last", "second half"]
    lines = [
        "| learner | updates | "
        + " | ".join(f"{side}, {part}" for part in parts for side in SIDES)
        + " | seconds a run: odaf, d3rlpy |",
        "|---" * (3 + 2 * len(parts)) + "|",
    ]
    for name in LEARNERS:
        for updates in sorted({run["updates"] for run in runs if run["learner"] == name}):
            of_sides = [
                sorted(
                    (r for r in runs if (r["learner"], r["side"], r["updates"]) == (name, side, updates)),
                    key=lambda run: run["seed"],
                )
                for side in SIDES
            ]
            lasts = [_mean_and_each([run["normalised_score"] for run in of_side]) for of_side in of_sides]
            halves = [
                _mean_and_each([half for r in of_side if (half := second_half(r)) is not None]) for of_side in of_sides
            ]
            seconds = [
                f"{statistics.median(r['cpu_seconds'] for r in of_side):.0f}" if of_side else "-"
                for of_side in of_sides
            ]
            lines.append(f"| {name} | {updates:,} | {' | '.join([*lasts, *halves])} | {', '.join(seconds)} |")
    return "\n".join(lines)


def second_half(run: dict[str, Any]) -> float | None:
    """Mean score of the policies after half of the updates, the half itself included."""
    scores = [score for step, score in run.get("curve", {}).items() if 2 * int(step) >= run["updates"]]
    return statistics.mean(scores) if scores else None


def _mean_and_each(scores: list[float]) -> str:
    if not scores:
        return "-"
    return f"{statistics.mean(scores):.1f} ({', '.join(f'{value:.0f}' for value in scores)})"
