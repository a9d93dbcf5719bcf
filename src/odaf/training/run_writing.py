"""Writing a run directory: claiming it, its first files, and removing what a killed process left."""

import os
import shlex
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.algorithms.config import to_dict
from odaf.data import fingerprint
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.ranges import ranges
from odaf.data.writing import TEMPORARY_PREFIX
from odaf.errors import ConfigError
from odaf.training import lock
from odaf.training.data_search import data_place
from odaf.training.files import plain, write_arrays, write_json
from odaf.training.run_directory import FORMAT, VERSION, RunDirectory
from odaf.training.settings import RunSettings, differences

# Written in this order; the config comes last, so a directory that has one is complete.
_FILES = ("environment.json", "data_sample.npz", "data.json", "config.json")
_SAMPLED_EPISODES = 100


def config_record(
    algorithm: Algorithm, settings: RunSettings, preset: str | None, advice: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of `config.json`; `advice` stands there only if it chose the preset."""
    record = {"format": FORMAT, "version": VERSION, "preset": preset, "algorithm": to_dict(algorithm)}
    return plain(record | settings.to_dict() | ({} if advice is None else {"advice": dict(advice)}))


def begin(
    path: Path, config: dict[str, Any], data: dict[str, Any], process: dict[str, Any], dataset: Dataset
) -> RunDirectory:
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
    write_json(path / "environment.json", {**process, "resumed": []})
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
    run.require_current()
    # A run from before there were prints of rows has only that of the file.
    kind = "rows_sha256" if "rows_sha256" in run.data else "sha256"
    old, new = {**run.config, "data": run.data.get(kind)}, {**config, "data": data[kind]}
    different = differences(old, new, more=("algorithm", "data"))
    if different:
        place = shlex.quote(str(run.path))
        remedy = f"train into another directory with --out, or go on with the old settings by `odaf resume {place}`"
        if list(different) == ["steps"]:
            remedy = f"go on with `odaf resume {place} --steps {new['steps']}`, or give another directory with --out"
        details = "; ".join(different.values())
        raise ConfigError(f"{run.path}: holds a run with other settings ({details}). To keep both: {remedy}.")


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


def data_record(
    dataset: Dataset, normaliser: Normaliser, path: str | os.PathLike[str] | None, directory: Path
) -> dict[str, Any]:
    """The content of `data.json`; a file's path stands as the user gave it, with what it is relative to."""
    return {
        **data_place(path, directory),
        **fingerprint.record(dataset),
        "summary": dataset.summary(),
        "ranges": ranges(dataset),
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
