"""Reader of d3rlpy's buffer file: HDF5 with one array per column and episode (2.1), or flat arrays (1)."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from odaf.data import storage, validation
from odaf.data.log import Column, Log
from odaf.data.readers import hdf5
from odaf.data.readers.columns import Joined
from odaf.errors import DatasetError

_COLUMNS = ("observations", "actions", "rewards", "terminated")
_FLAT = ("observations", "actions", "rewards", "terminals")


def read(
    path: Path, *, observations: Sequence[int | str] | None = None, action_bounds: validation.Bounds | None = None
) -> Log:
    """The log in a d3rlpy buffer file; its large columns stay in the file until they are sliced.

    An episode of T steps has T observations. One that terminated keeps its last row, whose successor nobody needs; one
    that did not loses it in the dataset, because its successor was not logged.

    Args:
        path: an HDF5 file.
        observations: for tuple observations, the entries to join into one vector, by number.
        action_bounds: lowest and highest action. None takes them from the data.

    Raises:
        DatasetError: an older version, a missing or odd field, or actions that are whole numbers, which d3rlpy writes
            for discrete actions.
    """
    chosen = None if observations is None else _entries(os.fspath(path), observations)
    with storage.opened(path) as (file, source), storage.reading(source):
        keys = set(hdf5.keys(file))
        if "columns" in keys or "num_episodes" in keys:
            _refuse_old_version(file, source)
            columns, version = _episodes(path, file, source, keys, chosen)
        else:
            columns, version = _flat(path, file, source, keys, chosen)
        if columns["actions"].dtype.kind != "f":
            raise DatasetError(
                f"{source}: field 'actions' holds {columns['actions'].dtype} values, which d3rlpy writes for discrete "
                "actions; odaf learns continuous ones. If they are continuous, store them as float32"
            )
    return Log(
        columns=columns,
        source=source,
        format="d3rlpy",
        action_bounds=action_bounds,
        provenance={"file": os.path.basename(source), "version": version},
    )


def _entries(source: str, given: Sequence[int | str]) -> list[int]:
    """Numbers of entries, which a command line gives as texts."""
    try:
        return [int(entry) for entry in given]
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{source}: observations={given!r}: give the numbers of entries, as in [0, 1]") from error


def _refuse_old_version(file: h5py.File, source: str) -> None:
    version = str(hdf5.scalar(file, source, "version"))
    if version != "2.1":
        raise DatasetError(
            f"{source}: written in version {version!r} of d3rlpy's file format, expected '2.1'; "
            "load it with the d3rlpy that wrote it and dump it again with a current one"
        )


def _episodes(
    path: Path, file: h5py.File, source: str, keys: set[str], chosen: Sequence[int] | None
) -> tuple[dict[str, Column], str]:
    count = hdf5.scalar(file, source, "num_episodes")
    if not isinstance(count, int) or count < 1 or f"terminated_{count - 1}" not in keys:
        found = sum(key.startswith("terminated_") for key in keys)
        raise DatasetError(
            f"{source}: field 'num_episodes' is {count!r}, but {found:,} episodes were found; "
            "the file is damaged: dump the buffer again"
        )
    names = {field: [f"{field}_{index}" for index in range(count)] for field in _COLUMNS}
    actions = hdf5.pieces(path, file, source, names["actions"])
    rewards = hdf5.pieces(path, file, source, names["rewards"])
    observed = _observations(path, file, source, keys, count, chosen)
    for field, column in {"rewards": rewards, **observed}.items():
        wrong = np.flatnonzero(column.lengths != actions.lengths)
        if len(wrong):
            first = int(wrong[0])
            raise DatasetError(
                f"{source}: episode {first}: '{field}' has {column.lengths[first]:,} rows, 'actions' has "
                f"{actions.lengths[first]:,}; every field needs one entry per step"
            )
    ended = np.array([_ended(file, source, name) for name in names["terminated"]])
    if (actions.lengths == 0).any():
        raise DatasetError(
            f"{source}: episode {int(np.flatnonzero(actions.lengths == 0)[0])} has no rows; dump the buffer without it"
        )
    last = np.zeros(len(actions), bool)
    last[np.cumsum(actions.lengths) - 1] = True
    terminated = np.repeat(ended, actions.lengths) & last
    parts = tuple(observed.values())
    columns: dict[str, Column] = {
        "observations": parts[0] if len(parts) == 1 and chosen is None else Joined(parts),
        "actions": actions,
        "rewards": rewards,
        "terminated": terminated,
        "truncated": last & ~terminated,
        "episode": np.repeat(np.arange(count), actions.lengths),
    }
    return columns, "2.1"


def _observations(
    path: Path, file: h5py.File, source: str, keys: set[str], count: int, chosen: Sequence[int] | None
) -> Mapping[str, Any]:
    entries = []
    while f"observations_0_{len(entries)}" in keys:
        entries.append(len(entries))
    if "observations_0" in keys or not entries:
        if chosen is not None:
            raise DatasetError(f"{source}: observations={list(chosen)} was given, but they are no tuple; leave it out")
        return {"observations": hdf5.pieces(path, file, source, [f"observations_{index}" for index in range(count)])}
    if not chosen or any(entry not in entries for entry in chosen):
        raise DatasetError(
            f"{source}: each observation is a tuple of {len(entries)} arrays"
            + ("" if chosen is None else f", of which {list(chosen)} was asked for"),
            remedies=[f"name those to join into one vector, for instance observations={entries}"],
        )
    return {
        f"observations {entry}": hdf5.pieces(
            path, file, source, [f"observations_{index}_{entry}" for index in range(count)]
        )
        for entry in chosen
    }


def _ended(file: h5py.File, source: str, name: str) -> bool:
    value = hdf5.scalar(file, source, name)
    if value not in (0, 1):
        raise DatasetError(f"{source}: field '{name}' is {value!r}, expected true or false; dump the buffer again")
    return bool(value)


def _flat(
    path: Path, file: h5py.File, source: str, keys: set[str], chosen: Sequence[int] | None
) -> tuple[dict[str, Column], str]:
    """Version 1: ends of episodes are marked in `episode_terminals`, those of the task in `terminals`."""
    if chosen is not None:
        raise DatasetError(f"{source}: observations= applies to tuple observations of version 2.1; leave it out")
    for name in (*_FLAT, "episode_terminals"):
        storage.require_field(file, source, name)
    if "discrete_action" in keys and hdf5.scalar(file, source, "discrete_action"):
        raise DatasetError(f"{source}: its actions are discrete (field 'discrete_action'); odaf learns continuous ones")
    terminated = validation.flags(source, "terminals", hdf5.whole(file, source, "terminals"))
    ends = validation.flags(source, "episode_terminals", hdf5.whole(file, source, "episode_terminals"))
    if len(ends) != len(terminated):
        raise DatasetError(
            f"{source}: field 'episode_terminals' has {len(ends):,} rows, 'terminals' has {len(terminated):,}; "
            "every field needs one entry per step"
        )
    ends = ends | terminated
    columns: dict[str, Column] = {
        name: hdf5.column(path, file, source, name) for name in ("observations", "actions", "rewards")
    }
    columns |= {
        "terminated": terminated,
        "truncated": ends & ~terminated,
        "episode": np.cumsum(ends, dtype=np.int64) - ends,
    }
    return columns, "1"
