"""Run directories of learners that were never trained: they load like any other, and are written in a moment."""

from pathlib import Path

import jax.random as jr
import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.training import checkpoints, run_writing
from odaf.training.files import plain
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
    for seed in seeds:
        spec = dataset.spec()
        state = learner.init(jr.key(seed), spec, learner.untrained(jr.key(seed), spec))
        summary = {"seed": seed, "step": 0, "status": "finished", "evaluation": None, "warnings": []}
        checkpoints.save(run.seed_directory(seed) / "checkpoints", 0, state, {"seed": seed, "summary": summary})
    return directory
