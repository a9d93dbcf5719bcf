"""A data set in the layouts that other programs read: D4RL's one file, Minari's folder."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from odaf.data import fingerprint, storage
from odaf.data.dataset import Dataset
from odaf.data.progress import Counter, Progress
from odaf.data.writing import TEMPORARY_PREFIX
from odaf.errors import DatasetError

MINARI_VERSION = "0.5.0"


def to_d4rl(dataset: Dataset, path: str | os.PathLike[str], progress: Progress | None = None) -> None:
    """Writes an HDF5 file in the layout of D4RL, version 2: flat arrays with `terminals` and `timeouts`.

    Infos go under `infos`; names, units, bounds and provenance, which the layout has no place for, are kept as a JSON
    text in `metadata/odaf`. Read back, the rows are the same; give `action_bounds` if they are not [-1, 1].

    Args:
        dataset: the data.
        path: the file.
        progress: told how far it has come, in fields written.

    Raises:
        DatasetError: the file cannot be written, or batches are mixed from two parts, which the layout cannot say.
    """
    _refuse_mixture(dataset, "D4RL")
    with storage.replacing(path) as partial, h5py.File(partial, "w") as file:
        fields = {name: getattr(dataset, name) for name in ("observations", "actions", "rewards", "next_observations")}
        fields |= {"terminals": dataset.terminated, "timeouts": dataset.truncated}
        fields |= {f"infos/{name}": values for name, values in dataset.infos.items()}
        counter = Counter(len(fields), progress)
        for name, values in fields.items():
            file.create_dataset(name, data=values)
            counter.add(1)
        content = json.loads(fingerprint.metadata(dataset))
        content |= {"action_low": dataset.action_low.tolist(), "action_high": dataset.action_high.tolist()}
        file.create_dataset("metadata/odaf", data=json.dumps(content, sort_keys=True))


def to_minari(
    dataset: Dataset,
    path: str | os.PathLike[str],
    identity: str | None = None,
    progress: Progress | None = None,
    replace: bool = False,
) -> None:
    """Writes a folder in the layout of Minari 0.5 with HDF5 data: one group per episode.

    An episode of T steps has T + 1 observations there, so each successor has to be the observation of the next row.
    Names of columns and provenance are kept as a JSON text under `odaf` in `data/metadata.json`.

    Args:
        dataset: the data.
        path: folder to make; it must not exist, unless it is to be replaced.
        identity: the data set's id, such as `tank/valve-v0`; None makes one of the folder's name.
        progress: told how far it has come, in episodes written.
        replace: remove a folder that is there once the new one is complete.

    Raises:
        DatasetError: the folder exists or cannot be written, a stored successor differs from the next row, or batches
            are mixed from two parts, which the layout cannot say.
    """
    _refuse_mixture(dataset, "Minari")
    path = Path(path)
    if path.exists() and not replace:
        raise DatasetError(f"{path}: exists already; name a new folder, or remove it first")
    _require_shifted(dataset)
    place = Path(os.path.realpath(path))
    partial, former = (place.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{age}-{place.name}") for age in ("new", "old"))
    try:
        try:
            (partial / "data").mkdir(parents=True)
            with h5py.File(partial / "data" / "main_data.hdf5", "w", track_order=True) as file:
                counter = Counter(dataset.num_episodes, progress)
                for index in range(dataset.num_episodes):
                    _write_episode(dataset, index, file.create_group(f"episode_{index}"))
                    counter.add(1)
            size = (partial / "data" / "main_data.hdf5").stat().st_size
            text = json.dumps(_minari_metadata(dataset, identity or f"{path.name}-v0", size))
            (partial / "data" / "metadata.json").write_text(text, encoding="utf-8")
            if not place.exists():
                os.replace(partial, place)
                return
            os.replace(place, former)
            try:
                os.replace(partial, place)
            except OSError:
                os.replace(former, place)
                raise
            shutil.rmtree(former, ignore_errors=True)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be written ({error}); choose a folder that exists and is writable"
        ) from error


def _refuse_mixture(dataset: Dataset, layout: str) -> None:
    if dataset.mixture is not None:
        raise DatasetError(
            f"convert: batches of these data are mixed from two parts, which {layout}'s layout cannot say, so its "
            "readers would draw all rows evenly; convert the two parts, or a mixture made without --per-batch"
        )


def _require_shifted(dataset: Dataset) -> None:
    inside = ~(dataset.terminated | dataset.truncated)[:-1]
    differs = (dataset.next_observations[:-1] != dataset.observations[1:]).any(axis=1) & inside
    if differs.any():
        rows = np.flatnonzero(differs)
        raise DatasetError(
            f"to_minari: {len(rows):,} stored successors differ from the next row's observation, the first in rows "
            f"{', '.join(map(str, rows[:5]))}; Minari's layout has no place for both: convert to D4RL instead"
        )


def _write_episode(dataset: Dataset, index: int, group: h5py.Group) -> None:
    rows = dataset.episode(index)
    group.attrs["id"] = index
    group.attrs["total_steps"] = rows.stop - rows.start
    last = dataset.next_observations[rows.stop - 1 : rows.stop]
    group["observations"] = np.concatenate([dataset.observations[rows], last])
    group["actions"] = dataset.actions[rows]
    group["rewards"] = dataset.rewards[rows]
    group["terminations"] = dataset.terminated[rows]
    group["truncations"] = dataset.truncated[rows]
    for name, values in dataset.infos.items():
        group[f"infos/{name}"] = values[rows]


def _minari_metadata(dataset: Dataset, identity: str, size: int) -> dict[str, Any]:
    endless = [np.inf] * dataset.obs_dim
    metadata = {
        "total_episodes": dataset.num_episodes,
        "total_steps": len(dataset),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": _box([-value for value in endless], endless),
        "action_space": _box(dataset.action_low.tolist(), dataset.action_high.tolist()),
        "dataset_id": identity,
        "minari_version": MINARI_VERSION,
        "dataset_size": round(size / 1e6, 1),
        "odaf": fingerprint.metadata(dataset),
    }
    spec = _environment_spec(dataset.environment)
    return metadata if spec is None else metadata | {"env_spec": spec}


def _box(low: list[float], high: list[float]) -> str:
    return json.dumps({"type": "Box", "dtype": "float32", "shape": [len(low)], "low": low, "high": high})


def _environment_spec(environment: dict[str, Any] | None) -> str | None:
    """The environment as Minari names it, where it is one of gymnasium's and gymnasium is there to describe it.

    Minari has no words for a rule for contact margins; an environment that has one is not named.
    """
    if environment is None or environment.get("name") != "gymnasium" or "contact_margins" in environment:
        return None
    try:
        import gymnasium.wrappers

        spec = json.loads(gymnasium.spec(environment["id"]).to_json())
        kinds = [getattr(gymnasium.wrappers, wrapper["name"]) for wrapper in environment.get("wrappers", ())]
    except Exception:  # not installed, or an id it does not know: the data are complete without
        return None
    spec["kwargs"] = {**spec["kwargs"], **(environment.get("kwargs") or {})}
    spec["max_episode_steps"] = environment.get("max_episode_steps", spec["max_episode_steps"])
    spec["additional_wrappers"] = [
        {**wrapper, "entry_point": f"{kind.__module__}:{kind.__name__}"}
        for wrapper, kind in zip(environment.get("wrappers", ()), kinds, strict=True)
    ]
    return json.dumps(spec)
