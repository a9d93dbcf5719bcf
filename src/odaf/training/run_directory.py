"""What a run leaves on the disk, and reading it back: everything needed to explain, use, repeat or continue it.

    config.json        every resolved setting
    environment.json   versions, device and command of the process that began it, and of each that resumed it
    data.json          where the data came from, their fingerprint, sizes, normaliser and environment
    data_sample.npz    returns of all logged episodes and some episodes themselves, for pictures
    seed-S/            metrics.jsonl, checkpoints/STEP/, evaluations/STEP.npz, summary.json

Paths inside the files stand as the user gave them.
"""

import contextlib
import datetime
import functools
import importlib.metadata
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.random as jr
import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.algorithms.config import from_dict
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.writing import TEMPORARY_PREFIX
from odaf.errors import CheckpointError, ConfigError
from odaf.training import checkpoints, lock, logging
from odaf.training.checkpoints import Checkpoint
from odaf.training.files import read_json, write_arrays, write_json
from odaf.training.policy import Policy

FORMAT = "odaf-run"
VERSION = 1

# Written in this order; the config comes last, so a directory that has one is complete.
_FILES = ("environment.json", "data_sample.npz", "data.json", "config.json")
_PACKAGES = (
    "odaf", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "h5py", "gymnasium", "gymnasium-robotics", "mujoco"
)  # fmt: skip
_SAMPLED_EPISODES = 100
_NO_RUN = "Give the directory that `odaf train --out` or `odaf.fit(directory=...)` wrote."


@dataclass(frozen=True)
class RunDirectory:
    """One run on the disk. Nothing is read before it is asked for; settings are read once, results every time."""

    path: Path

    @functools.cached_property
    def config(self) -> dict[str, Any]:
        """`config.json`, checked for its format.

        Raises:
            CheckpointError: there is no run here, or the file is damaged.
        """
        path = self.path / "config.json"
        config = read_json(path, _NO_RUN)
        if config.get("format") != FORMAT or config.get("version") != VERSION:
            raise CheckpointError(
                f"{path}: format, version: expected {FORMAT!r}, {VERSION}, found {config.get('format')!r}, "
                f"{config.get('version')!r}. {_NO_RUN}"
            )
        for field in ("algorithm", "steps", "seeds", "checkpoint_every", "stretch"):
            if field not in config:
                raise CheckpointError(f"{path}: {field}: is missing, so the file was changed. {_NO_RUN}")
        return config

    @functools.cached_property
    def data(self) -> dict[str, Any]:
        """`data.json`."""
        return read_json(self.path / "data.json", _NO_RUN)

    @functools.cached_property
    def algorithm(self) -> Algorithm:
        """The learner, rebuilt from its resolved settings."""
        try:
            return from_dict(self.config["algorithm"])
        except ConfigError as error:
            raise CheckpointError(f"{self.path / 'config.json'}: algorithm: {error}") from None

    @functools.cached_property
    def spec(self) -> Spec:
        """Sizes, bounds and reward range of the training data."""
        return Spec.from_dict(self.data["spec"])

    @functools.cached_property
    def normaliser(self) -> Normaliser:
        """The map of observations fitted on the training data."""
        return Normaliser.from_dict(self.data["normaliser"])

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds that were asked for, whether or not their training has begun."""
        return tuple(self.config["seeds"])

    def seed_directory(self, seed: int) -> Path:
        """Where one seed's files lie.

        Raises:
            ConfigError: the run has no such seed.
        """
        if seed not in self.seeds:
            raise ConfigError(f"{self.path}: has no seed {seed}; it has {', '.join(map(str, self.seeds))}")
        return self.path / f"seed-{seed}"

    def checkpoints(self, seed: int) -> list[Checkpoint]:
        """The seed's checkpoints, earliest first."""
        return checkpoints.listed(self.seed_directory(seed) / "checkpoints")

    def checkpoint(self, seed: int, step: int | None = None) -> Checkpoint:
        """The seed's checkpoint after `step` updates, or its last.

        Raises:
            CheckpointError: there is none; the message lists those there are.
        """
        found = self.checkpoints(seed)
        chosen = found[-1:] if step is None else [checkpoint for checkpoint in found if checkpoint.step == step]
        if not chosen:
            steps = ", ".join(str(checkpoint.step) for checkpoint in found) or "none"
            wanted = "no checkpoint" if step is None else f"no checkpoint of step {step}"
            raise CheckpointError(
                f"{self.seed_directory(seed) / 'checkpoints'}: {wanted}; there are: {steps}. "
                "Choose one of these, or go on training with `odaf resume`."
            )
        return chosen[0]

    def state(self, seed: int, step: int | None = None) -> Any:
        """The learner's complete state after `step` updates, or the last one saved."""
        return self.checkpoint(seed, step).load(blank_state(self.algorithm, self.spec), identity={"seed": seed})

    def policy(self, seed: int, step: int | None = None) -> Policy:
        """What the seed had learned after `step` updates, or at its last checkpoint; needs no dataset."""
        checkpoint = self.checkpoint(seed, step)
        return self.policy_of(self.state(seed, checkpoint.step), seed=seed, step=checkpoint.step)

    def policy_of(self, state: Any, **provenance: int) -> Policy:
        """The policy of a learner's state, with the names and units of the data it learns from.

        Args:
            state: of the run's learner.
            **provenance: what the policy says about where it comes from, beside learner, preset and data.
        """
        fields = ("observation_names", "action_names", "observation_units", "action_units")
        columns = {field: tuple(self.data["summary"].get(field, ())) for field in fields}
        return Policy(
            self.algorithm.actor(state),
            self.normaliser,
            self.spec.action_low,
            self.spec.action_high,
            **columns,
            provenance={
                "learner": self.algorithm.kind,
                "preset": self.config.get("preset"),
                "data_sha256": self.data.get("sha256"),
                **provenance,
            },
        )

    def metrics(self, seed: int) -> list[dict[str, Any]]:
        """The lines of the seed's `metrics.jsonl`; one torn by a kill is left out."""
        return logging.read(self.seed_directory(seed) / "metrics.jsonl")

    def summary(self, seed: int) -> dict[str, Any]:
        """The seed's state of affairs at its last checkpoint; `status` is one of "not started", "running" (which
        includes runs that were cut off), "diverged" and "finished"."""
        found = self.checkpoints(seed)
        if not found:
            return {"seed": seed, "step": 0, "status": "not started", "evaluation": None, "warnings": []}
        summary = found[-1].header()["summary"]
        if summary["status"] == "finished" and summary["step"] < self.config["steps"]:
            summary["status"] = "running"  # it was finished once, and made longer since
        return summary


def blank_state(algorithm: Algorithm, spec: Spec) -> Any:
    """The structure of a learner's state, with shapes in place of arrays."""

    def build(key):
        key_models, key_init = jr.split(key)
        return algorithm.init(key_init, spec, algorithm.untrained(key_models, spec))

    return eqx.filter_eval_shape(build, jr.key(0))


def begin(path: Path, config: dict[str, Any], data: dict[str, Any], dataset: Dataset) -> RunDirectory:
    """Opens `path` for a run with these settings: writes its files, or checks that those there say the same.

    Raises:
        ConfigError: the directory holds another run, or something that is no run.
    """
    run = RunDirectory(path)
    if (path / "config.json").exists():
        _check_same(run, config, data)
        return run
    refuse_foreign(path)
    path.mkdir(parents=True, exist_ok=True)
    write_json(path / "environment.json", {**process_record(), "resumed": []})
    write_arrays(path / "data_sample.npz", data_sample(dataset))
    write_json(path / "data.json", data)
    write_json(path / "config.json", config)
    return run


def refuse_foreign(path: Path) -> None:
    """Makes sure that `path` can become a run's directory, or is one.

    Raises:
        ConfigError: it is a file, or holds files of something else.
    """
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{path}: is a file, not a directory. Give another directory with --out.")
    if not path.exists() or (path / "config.json").exists():
        return
    # A kill before the config was written leaves some of our own files, and nothing of value.
    foreign = sorted(
        child.name
        for child in path.iterdir()
        if child.name not in (*_FILES, lock.NAME) and not child.name.startswith(TEMPORARY_PREFIX)
    )
    if foreign:
        raise ConfigError(
            f"{path}: is not empty ({', '.join(foreign[:3])}{', ...' if len(foreign) > 3 else ''}) and holds no run. "
            "Give another directory with --out."
        )


def _check_same(run: RunDirectory, config: dict[str, Any], data: dict[str, Any]) -> None:
    old, new = {**run.config, "data": run.data.get("sha256")}, {**config, "data": data["sha256"]}
    fields = ("algorithm", "data", "steps", "seeds", "evaluate", "checkpoint_every", "stretch")
    different = [field for field in fields if old.get(field) != new.get(field)]
    if different:
        details = "; ".join(_difference(field, old.get(field), new.get(field)) for field in different)
        remedy = f"train into another directory with --out, or go on with the old settings by `odaf resume {run.path}`"
        if different == ["steps"]:
            remedy = f"go on with `odaf resume {run.path} --steps {new['steps']}`, or give another directory with --out"
        raise ConfigError(f"{run.path}: holds a run with other settings ({details}). To keep both: {remedy}.")


def _difference(field: str, old: Any, new: Any) -> str:
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
        return ", ".join(_difference(f"{field}.{key}", old.get(key), new.get(key)) for key in keys)
    return f"{field} was {old!r}, now {new!r}"


def clean(seed_directory: Path, step: int) -> None:
    """Removes what a killed process left: unfinished writes, and evaluations later than checkpoint `step`."""
    remove_unfinished(seed_directory)
    for file in (seed_directory / "evaluations").glob("*.npz"):
        if file.stem.isdigit() and int(file.stem) > step:
            file.unlink()


def remove_unfinished(directory: Path, *, recursive: bool = True) -> None:
    """Removes files and folders of writes that broke off; only for a process that holds the run's lock."""
    pattern = f"{TEMPORARY_PREFIX}*"
    for leftover in list(directory.rglob(pattern) if recursive else directory.glob(pattern)):
        if leftover.is_dir():
            shutil.rmtree(leftover)
        else:
            leftover.unlink(missing_ok=True)


def data_record(dataset: Dataset, normaliser: Normaliser, path: str | os.PathLike[str] | None) -> dict[str, Any]:
    """The content of `data.json`."""
    return {
        "path": None if path is None else os.fspath(path),
        "sha256": dataset.fingerprint(),
        "summary": dataset.summary(),
        "spec": dataset.spec().to_dict(),
        "normaliser": normaliser.to_dict(),
        "environment": dataset.environment,
    }


def data_sample(dataset: Dataset) -> dict[str, np.ndarray]:
    """The content of `data_sample.npz`.

    Returns:
        `returns` [episodes] of every logged episode; `best_observations` [time, obs_dim] of the one with the largest
        return; `observations` [n, time, obs_dim] of at most 100 episodes spread evenly over the log, NaN after each
        one's end.
    """
    returns = np.asarray(dataset.episode_returns(), np.float32)
    chosen = np.unique(np.linspace(0, dataset.num_episodes - 1, _SAMPLED_EPISODES).round().astype(int))
    episodes = [dataset.observations[dataset.episode(int(index))] for index in chosen]
    longest = max(len(episode) for episode in episodes)
    padded = np.full((len(episodes), longest, dataset.obs_dim), np.nan, np.float32)
    for row, episode in zip(padded, episodes, strict=True):
        row[: len(episode)] = episode
    best = dataset.observations[dataset.episode(int(returns.argmax()))]
    return {"returns": returns, "best_observations": np.asarray(best, np.float32), "observations": padded}


def changes(before: dict[str, Any], now: dict[str, Any]) -> str:
    """In words, what two process records differ in that can change a bit of the result; empty if nothing."""
    names = ("python", "device", "cores")
    old = {**{name: before.get(name) for name in names}, **before.get("versions", {})}
    new = {**{name: now[name] for name in names}, **now["versions"]}
    different = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    return ", ".join(f"{name} was {old.get(name)}, is {new.get(name)}" for name in different)


@functools.cache
def _versions() -> dict[str, str]:
    versions = {}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[package] = importlib.metadata.version(package)
    return versions


def process_record() -> dict[str, Any]:
    """What this process is: versions, device, platform, command, and when it began."""
    device = jax.devices()[0]
    return {
        "python": platform.python_version(),
        "versions": _versions(),
        "device": f"{device.platform}: {device.device_kind} x {jax.device_count()}",
        "platform": platform.platform(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "command": list(sys.argv),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
