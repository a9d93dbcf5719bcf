"""Reader of the D4RL file layout: flat HDF5 arrays with `terminals` and, since version 1, `timeouts`."""

import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from odaf.data import storage, validation
from odaf.data.log import Column, Log
from odaf.data.readers import hdf5
from odaf.errors import DatasetError

REQUIRED = ("observations", "actions", "rewards", "terminals")
_COLUMNS = ("observations", "actions", "rewards", "next_observations")
_POLICY = "metadata/policy"


def read(
    path: Path,
    *,
    max_episode_steps: int | None = None,
    action_bounds: validation.Bounds | None = (-1.0, 1.0),
    d4rl_compat: bool = False,
) -> Log:
    """The log in a D4RL file; its large columns stay in the file until they are sliced.

    Stored `next_observations` are used as they are; without them the observations are shifted inside each episode, and
    the last row of an episode that timed out is dropped because nobody logged its successor. A row that is both
    terminal and timed out counts as terminated. Rows behind the last end flag form an episode cut by the recording.
    Arrays under `infos` become infos; a stored policy is described in the provenance, see `behaviour_policy`.

    Args:
        path: an HDF5 file.
        max_episode_steps: the environment's time limit. Needed where the file has no `timeouts`, or where these and
            `terminals` mark no row at all; refused elsewhere.
        action_bounds: lowest and highest action; [-1, 1] holds for the published locomotion and maze files.
            None takes them from the data.
        d4rl_compat: reproduce the rows that D4RL's own `qlearning_dataset` returns: the successor is the next row's
            observation even across the end of an episode, timed-out rows are dropped (also terminal ones), and so is
            the file's last row. For comparisons only: successors of terminal rows belong to another episode. These
            rows are held in memory.

    Raises:
        DatasetError: a field is missing or is no array of numbers, or the ends of episodes cannot be told.
    """
    with storage.opened(path) as (file, source), storage.reading(source):
        refuse_other_layouts(file, source)
        for name in REQUIRED:
            storage.require_field(file, source, name)
        columns: dict[str, Column] = {name: hdf5.column(path, file, source, name) for name in _COLUMNS if name in file}
        terminals = _flags(file, source, "terminals")
        timeouts = _flags(file, source, "timeouts") if "timeouts" in file else None
        rows = len(terminals)
        if timeouts is not None and len(timeouts) != rows:
            raise DatasetError(
                f"{source}: field 'timeouts' has {len(timeouts):,} rows, 'terminals' has {rows:,}; "
                "every field needs one entry per step, so find where rows were lost or added"
            )
        stored = hdf5.arrays_below(file, source)
        infos, others = _infos(path, file, source, stored, rows)
        provenance = {**_policy_facts(file, source, stored), "fields_not_read": others}
    timeouts = _checked_timeouts(source, terminals, timeouts, max_episode_steps)
    provenance |= {"file": os.path.basename(source), "rows_in_file": rows, "d4rl_compat": d4rl_compat}
    if max_episode_steps is not None:
        provenance["max_episode_steps"] = max_episode_steps
    findings, kept = [], None
    if d4rl_compat:
        kept, episode, terminated = _compat_rows(terminals, timeouts, max_episode_steps)
        if len(kept) == 0:
            raise DatasetError(f"{source}: d4rl_compat= drops all {rows} rows; read the file without it")
        columns, infos = _taken(source, columns, infos, kept, rows)
        columns |= {"terminated": terminated, "episode": episode}
    else:
        if timeouts is None:
            timeouts = _time_limits(terminals, int(max_episode_steps or 0))
        if terminals.any() and np.array_equal(terminals, timeouts):
            findings.append(_suspicion(int(terminals.sum())))
        ends = terminals | timeouts
        episode = np.cumsum(ends, dtype=np.int64) - ends
        columns |= {"terminated": terminals, "truncated": timeouts, "episode": episode}
    return Log(
        columns=columns,
        source=source,
        format="d4rl",
        action_bounds=action_bounds,
        infos=infos,
        provenance=provenance,
        findings=tuple(findings),
        row_numbers=kept,
    )


def behaviour_policy(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Arrays of the policy that recorded the file, by their path under `metadata/policy`, such as `fc0/weight`.

    The medium and expert files of version 2 hold one: observation, 256, 256, then mean and log-deviation, rectified
    in between and squashed by tanh. What the file says of it is in the provenance under `behaviour_policy`.

    Raises:
        DatasetError: the file holds no policy.
    """
    with storage.opened(path) as (file, source), storage.reading(source):
        names = _policy_arrays(file, source, hdf5.arrays_below(file, source))
        if not names:
            raise DatasetError(
                f"{source}: holds no policy (no arrays under '{_POLICY}'); only D4RL's medium and expert files do"
            )
        return {name.removeprefix(f"{_POLICY}/"): hdf5.whole(file, source, name) for name in names}


def refuse_other_layouts(file: h5py.File, source: str) -> None:
    """Raises `DatasetError` where the file holds episodes as groups, or none of the layout's fields."""
    keys = hdf5.keys(file)
    if any(key.startswith("episode_") for key in keys):
        raise DatasetError(
            f"{source}: holds one group per episode ({', '.join(keys[:3])}, ...), as Minari writes; "
            "give Minari's folder, which is read as it is, or pass the joined episodes to Dataset.from_arrays"
        )
    if not any(name in keys for name in REQUIRED):
        raise DatasetError(
            f"{source}: neither an odaf dataset (no attribute 'format') nor in the D4RL layout (no fields "
            f"{', '.join(REQUIRED)}); the file has {hdf5.shown(keys)}"
        )


def _flags(file: h5py.File, source: str, name: str) -> np.ndarray:
    return validation.flags(source, name, hdf5.whole(file, source, name))


def _checked_timeouts(
    source: str, terminals: np.ndarray, timeouts: np.ndarray | None, limit: int | None
) -> np.ndarray | None:
    """`timeouts` where they say something, None where the time limit has to stand in for them."""
    if timeouts is not None and not (terminals | timeouts).any():
        timeouts = None  # present, but it tells as little as if it were not
    if timeouts is None and limit is None:
        raise DatasetError(
            f"{source}: field 'timeouts' is missing or marks nothing, so a time limit cannot be told from the middle "
            "of an episode",
            remedies=["pass max_episode_steps=1000 for the locomotion tasks, or the limit of another task"],
        )
    if timeouts is not None and limit is not None:
        raise DatasetError(
            f"{source}: max_episode_steps={limit} was given but the file has its own 'timeouts'; leave the option out"
        )
    if limit is not None and limit < 1:
        raise DatasetError(f"{source}: max_episode_steps={limit}: give the time limit, 1 or more")
    return timeouts


def _compat_rows(
    terminals: np.ndarray, timeouts: np.ndarray | None, limit: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows kept, their episode, their done flag) of D4RL's loop, step counter included.

    Its counter, used where no `timeouts` are stored, is set to 0 at a terminal row and then still advanced, so the
    episode after a terminal row times out one row early. We keep that.
    """
    kept, episode = [], []
    number, step = 0, 0
    for row in range(len(terminals) - 1):
        final = bool(timeouts[row]) if timeouts is not None else step == (limit or 0) - 1
        if final:
            step = 0
            number += 1
            continue
        kept.append(row)
        episode.append(number)
        if terminals[row]:
            step = 0
            number += 1
        step += 1
    rows = np.array(kept, np.int64)
    return rows, np.array(episode, np.int64), terminals[rows]


def _taken(
    source: str, columns: dict[str, Column], infos: dict[str, Column], kept: np.ndarray, rows: int
) -> tuple[dict[str, Column], dict[str, Column]]:
    """The rows `kept` of columns and infos, in memory, each with the observation of the file's next row."""
    for name, column in columns.items():
        if len(column) != rows:
            raise DatasetError(
                f"{source}: field '{name}' has {len(column):,} rows, 'terminals' has {rows:,}; "
                "every field needs one entry per step, so find where rows were lost or added"
            )
    observations = np.asarray(columns["observations"][:])
    taken: dict[str, Column] = {
        "observations": observations[kept],
        "actions": np.asarray(columns["actions"][:])[kept],
        "rewards": np.asarray(columns["rewards"][:])[kept],
        "next_observations": observations[kept + 1],
    }
    return taken, {name: np.asarray(column[:])[kept] for name, column in infos.items()}


def _time_limits(terminals: np.ndarray, limit: int) -> np.ndarray:
    """[rows] bool: rows that are the `limit`-th of their episode and not terminal."""
    timeouts = np.zeros(len(terminals), bool)
    start = 0
    for end in [*np.flatnonzero(terminals).tolist(), len(terminals) - 1]:
        timeouts[start + limit - 1 : end + 1 : limit] = True
        start = end + 1
    return timeouts & ~terminals


def _infos(
    path: Path, file: h5py.File, source: str, stored: list[str], rows: int
) -> tuple[dict[str, Column], list[str]]:
    """(arrays of numbers under `infos` with one entry per step, paths of all arrays that are left alone)."""
    infos: dict[str, Column] = {}
    others = []
    for name in stored:
        if name in (*_COLUMNS, "terminals", "timeouts"):
            continue
        if name.startswith("infos/"):
            item = hdf5.dataset(file, source, name)
            if item.dtype.kind in "biuf" and item.shape and len(item) == rows:
                infos[name.removeprefix("infos/").replace("/", ".")] = hdf5.column(path, file, source, name)
                continue
        others.append(name)
    return infos, others


def _policy_arrays(file: h5py.File, source: str, stored: list[str]) -> list[str]:
    return [
        name
        for name in stored
        if name.startswith(f"{_POLICY}/")
        and (item := hdf5.dataset(file, source, name)).dtype.kind in "biuf"
        and item.shape
    ]


def _policy_facts(file: h5py.File, source: str, stored: list[str]) -> dict[str, Any]:
    """What `metadata` says of the run that recorded the file, in JSON types."""
    facts: dict[str, Any] = {}
    for name in ("algorithm", "iteration"):
        if f"metadata/{name}" in stored:
            facts[name] = hdf5.scalar(file, source, f"metadata/{name}")
    arrays = _policy_arrays(file, source, stored)
    if arrays:
        policy: dict[str, Any] = {
            "arrays": {
                name.removeprefix(f"{_POLICY}/"): list(hdf5.dataset(file, source, name).shape) for name in arrays
            }
        }
        for name in ("nonlinearity", "output_distribution"):
            if f"{_POLICY}/{name}" in stored:
                policy[name] = hdf5.scalar(file, source, f"{_POLICY}/{name}")
        facts["behaviour_policy"] = policy
    return facts


def _suspicion(count: int) -> dict[str, Any]:
    return {
        "finding": "terminals-equal-timeouts",
        "count": count,
        "message": f"all {count} timeouts are terminals too; if they are time limits, learned values are wrong",
    }
