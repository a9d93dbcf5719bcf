"""Reader of the D4RL file layout: flat HDF5 arrays with `terminals` and, since version 1, `timeouts`."""

import os
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from odaf.data import storage, validation
from odaf.errors import DatasetError

if TYPE_CHECKING:
    from odaf.data.dataset import Dataset

_REQUIRED = ("observations", "actions", "rewards", "terminals")
_READ = (*_REQUIRED, "timeouts", "next_observations")


def read(
    file: h5py.File,
    source: str,
    *,
    max_episode_steps: int | None = None,
    action_bounds: validation.Bounds = (-1.0, 1.0),
    d4rl_compat: bool = False,
) -> "Dataset":
    """The dataset in an open D4RL file.

    Stored `next_observations` are used as they are; without them the observations are shifted inside each episode, and
    the last row of an episode that timed out is dropped because nobody logged its successor. A row that is both
    terminal and timed out counts as terminated. Rows behind the last end flag form an episode cut by the recording.

    Args:
        file: open for reading.
        source: the name messages use.
        max_episode_steps: the environment's time limit. Needed where the file has no `timeouts`, or where these and
            `terminals` mark no row at all; refused elsewhere.
        action_bounds: lowest and highest action; [-1, 1] holds for the published locomotion and maze files.
        d4rl_compat: reproduce the rows that D4RL's own `qlearning_dataset` returns: the successor is the next row's
            observation even across the end of an episode, timed-out rows are dropped (also terminal ones), and so is
            the file's last row. For comparisons only: successors of terminal rows belong to another episode.

    Raises:
        DatasetError: a field is missing, has the wrong type, shape or length, or fails a check of `from_arrays`.
    """
    from odaf.data.dataset import Dataset

    with storage.reading(source):
        _refuse_other_layouts(file, source)
        for name in _REQUIRED:
            storage.require_field(file, source, name)
        arrays = {name: storage.read_array(file, source, name) for name in _READ if name in file}
        others = _other_fields(file)
    observations = validation.matrix(source, "observations", arrays["observations"])
    actions = validation.matrix(source, "actions", arrays["actions"])
    rewards = validation.vector(source, "rewards", arrays["rewards"])
    terminals = validation.flags(source, "terminals", arrays["terminals"])
    columns = {"observations": observations, "actions": actions, "rewards": rewards, "terminals": terminals}
    if "timeouts" in arrays:
        columns["timeouts"] = validation.flags(source, "timeouts", arrays["timeouts"])
    if "next_observations" in arrays:
        columns["next_observations"] = validation.matrix(source, "next_observations", arrays["next_observations"])
    rows = validation.same_length(source, columns)
    timeouts = columns.get("timeouts")
    if timeouts is not None and not (terminals | timeouts).any():
        timeouts = None  # present, but it tells as little as if it were not
    if timeouts is None and max_episode_steps is None:
        raise DatasetError(
            f"{source}: field 'timeouts' is missing or marks nothing, so a time limit cannot be told from the middle "
            "of an episode; pass max_episode_steps= (1000 for the locomotion tasks)"
        )
    if timeouts is not None and max_episode_steps is not None:
        raise DatasetError(
            f"{source}: max_episode_steps={max_episode_steps} was given but the file has its own 'timeouts'; "
            "leave the option out"
        )
    if max_episode_steps is not None and max_episode_steps < 1:
        raise DatasetError(f"{source}: max_episode_steps is {max_episode_steps}; give the time limit, 1 or more")

    provenance: dict[str, Any] = {
        "format": "d4rl",
        "file": os.path.basename(source),
        "rows_in_file": rows,
        "fields_not_read": others,
        "d4rl_compat": d4rl_compat,
    }
    if max_episode_steps is not None:
        provenance["max_episode_steps"] = max_episode_steps
    shared = {"action_bounds": action_bounds, "provenance": provenance, "source": source}
    if d4rl_compat:
        kept, episode, terminated = _compat_rows(terminals, timeouts, max_episode_steps)
        if len(kept) == 0:
            raise DatasetError(f"{source}: d4rl_compat drops all {rows} rows; read the file without it")
        return Dataset.from_arrays(
            observations[kept],
            actions[kept],
            rewards[kept],
            observations[kept + 1],
            terminated=terminated,
            episode=episode,
            **shared,
        )
    if timeouts is None:
        timeouts = _time_limits(terminals, int(max_episode_steps or 0))
    if (terminals & timeouts).any() and np.array_equal(terminals, timeouts):
        count = int(terminals.sum())
        provenance["findings"] = [
            {
                "finding": "terminals-equal-timeouts",
                "count": count,
                "message": f"all {count} timeouts are terminals too; if they are time limits, learned values are wrong",
            }
        ]
    ends = terminals | timeouts
    episode = np.cumsum(np.append(False, ends[:-1]))
    return Dataset.from_arrays(
        observations,
        actions,
        rewards,
        columns.get("next_observations"),
        terminated=terminals,
        truncated=timeouts,
        episode=episode,
        **shared,
    )


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


def _time_limits(terminals: np.ndarray, limit: int) -> np.ndarray:
    """[rows] bool: rows that are the `limit`-th of their episode and not terminal."""
    timeouts = np.zeros(len(terminals), bool)
    start = 0
    for end in [*np.flatnonzero(terminals).tolist(), len(terminals) - 1]:
        timeouts[start + limit - 1 : end + 1 : limit] = True
        start = end + 1
    return timeouts & ~terminals


def _refuse_other_layouts(file: h5py.File, source: str) -> None:
    keys = list(file.keys())
    if any(key.startswith("episode_") for key in keys):
        raise DatasetError(
            f"{source}: holds one group per episode ({', '.join(keys[:3])}, ...), as Minari writes; "
            "concatenate the episodes and use Dataset.from_arrays(..., episode=ids)"
        )
    if not any(name in keys for name in _REQUIRED):
        raise DatasetError(
            f"{source}: neither an odaf dataset (no attribute 'format') nor in the D4RL layout (no fields "
            f"{', '.join(_REQUIRED)}); the file has {sorted(keys)}"
        )


def _other_fields(file: h5py.File) -> list[str]:
    """Paths of all data sets that the reader leaves alone, such as `infos/qpos` and `metadata/policy/fc0/weight`."""
    paths: list[str] = []
    file.visititems(lambda path, item: paths.append(path) if isinstance(item, h5py.Dataset) else None)
    return sorted(path for path in paths if path not in _READ)
