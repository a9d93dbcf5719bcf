"""Run directories without any training, written in a moment: of untrained learners, and of scores alone."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.training import checkpoints, run_writing
from odaf.training.files import plain, write_json
from odaf.training.process_record import process_record
from odaf.training.settings import RunSettings


def dataset_of(obs_dim: int, act_dim: int, environment: dict, episodes: int = 4, steps: int = 10) -> Dataset:
    """Episodes of standard normal states, cut by a time limit, with actions in [-1, 1]."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(episodes, steps + 1, obs_dim)).astype(np.float32)
    return Dataset.from_arrays(
        states[:, :-1].reshape(-1, obs_dim),
        rng.uniform(-1, 1, (episodes * steps, act_dim)),
        rng.uniform(0, 1, episodes * steps),
        states[:, 1:].reshape(-1, obs_dim),
        truncated=np.tile(np.arange(steps) == steps - 1, episodes),
        action_bounds=(-1.0, 1.0),
        provenance={"environment": environment},
    )


def untrained_run(
    directory: Path, learner: Algorithm, dataset: Dataset, seeds: tuple[int, ...] = (0, 1), data: Path | None = None
) -> Path:
    """A run of 0 updates; each seed has its own random parameters."""
    settings = RunSettings(steps=1, seeds=seeds, checkpoint_every=1, stretch=1).resolved()
    config = run_writing.config_record(learner, settings, None) | {"steps": 0}
    normaliser = Normaliser.fit(dataset.observations, epsilon=1e-3)
    record = run_writing.data_record(dataset, normaliser, data, directory)
    run = run_writing.begin(directory, config, plain(record), process_record(1, "default"), dataset)
    spec = dataset.spec()
    begin = jax.jit(lambda key: learner.init(key, spec, learner.untrained(key, spec)))
    for seed in seeds:
        state = begin(jr.key(seed))
        summary = {"seed": seed, "step": 0, "status": "finished", "evaluation": None, "warnings": []}
        checkpoints.save(run.seed_directory(seed) / "checkpoints", 0, state, {"seed": seed, "summary": summary})
    return directory


def scored_run(
    directory: Path,
    returns: Mapping[int, Sequence[float | None]],
    preset: str = "odaf",
    *,
    data: Mapping[str, Any] | None = None,
    step: int = 100,
    **algorithm: Any,
) -> Path:
    """What a report reads of a run: for each seed the returns of its last evaluation, None for one that broke off.

    Args:
        data: entries of `data.json` to add or to replace.
        algorithm: settings of the learner.
    """
    config = {"preset": preset, "algorithm": {"kind": "ensemble-sac", **algorithm}, "steps": step, "seeds": [*returns]}
    record = {
        "path": "log.h5",
        "rows_sha256": "ab12" * 16,
        "sha256": "cd34" * 16,
        "summary": {"mean_return": 2.0, "best_return": 5.0, "transitions": 40, "episodes": 4, "provenance": {}},
        "environment": {"name": "gymnasium", "id": "Hopper-v5", "kwargs": {}},
    }
    directory.mkdir(parents=True)
    write_json(directory / "config.json", config | {"format": "odaf-run", "version": 2})
    write_json(directory / "data.json", record | dict(data or {}))
    write_json(directory / "environment.json", {"versions": {"odaf": "0.2.0"}, "command": ["odaf", "train", preset]})
    for seed, values in returns.items():
        sound = [value for value in values if value is not None]
        evaluation = {
            "step": step,
            "mean_return": float(np.mean(sound)) if sound else None,
            "std_return": float(np.std(sound)) if sound else None,
            "episodes": len(values),
            "returns": list(values),
        }
        (directory / f"seed-{seed}").mkdir()
        summary = {"seed": seed, "step": step, "status": "finished", "evaluation": evaluation if values else None}
        timing = {"updates_per_second": 50.0, "seconds": {"train": 2.0}, "warnings": []}
        write_json(directory / f"seed-{seed}" / "summary.json", summary | timing)
    return directory
