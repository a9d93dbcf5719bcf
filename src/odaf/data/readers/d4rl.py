"""Reader of the D4RL file layout: flat arrays with `terminals` and, since version 1, `timeouts`, in HDF5 or `.npz`."""

import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from odaf.data import validation
from odaf.data.log import Column, Log
from odaf.data.readers import hdf5
from odaf.data.readers.d4rl_fields import Fields, Hdf5Fields, opened
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
        path: an HDF5 file, or an `.npz` file with the same keys, as `numpy.savez` makes of a dictionary; the arrays of
            the latter are held in memory.
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
    with opened(path) as fields:
        source = fields.source
        if isinstance(fields, Hdf5Fields):
            _refuse_other_layouts(fields.file, source)
        columns: dict[str, Column] = {
            name: fields.column(name) for name in _COLUMNS if name in REQUIRED or name in fields
        }
        terminals = _flags(fields, "terminals")
        timeouts = _flags(fields, "timeouts") if "timeouts" in fields else None
        rows = len(terminals)
        if timeouts is not None and len(timeouts) != rows:
            raise DatasetError(
                f"{source}: field 'timeouts' has {len(timeouts):,} rows, 'terminals' has {rows:,}; "
                "every field needs one entry per step, so find where rows were lost or added"
            )
        _refuse_other_ends(fields, terminals)
        infos, others = _infos(fields, rows)
        provenance = {**_policy_facts(fields), "fields_not_read": others}
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
    with opened(path) as fields:
        names = _policy_arrays(fields)
        if not names:
            raise DatasetError(
                f"{fields.source}: holds no policy (no arrays under '{_POLICY}'), as only D4RL's medium and expert "
                "files do; give one of those"
            )
        return {name.removeprefix(f"{_POLICY}/"): fields.whole(name) for name in names}


def _refuse_other_layouts(file: h5py.File, source: str) -> None:
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


def _flags(fields: Fields, name: str) -> np.ndarray:
    return validation.flags(fields.source, name, fields.whole(name))


def _refuse_other_ends(fields: Fields, terminals: np.ndarray) -> None:
    """Raises where masks beside the flags say that `terminals` are ends of trajectories, as in OGBench's files."""
    if "masks" not in fields:
        return
    goes_on = _flags(fields, "masks")
    odd = terminals & goes_on if len(goes_on) == len(terminals) else np.ones(len(terminals), bool)
    if odd.any():
        raise DatasetError(
            f"{fields.source}: field 'masks' says that the task goes on after {validation.name_rows(odd)}, where "
            "'terminals' is set: two layouts fit, D4RL's, whose terminals end the task, and OGBench's, whose "
            "terminals end a trajectory; remove 'masks' if the task ended there, or pass the arrays to "
            "Dataset.from_arrays and say which rows are terminated and which truncated"
        )


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


def _infos(fields: Fields, rows: int) -> tuple[dict[str, Column], list[str]]:
    """(arrays of numbers or dates under `infos` with one entry per step, paths of all arrays that are left alone)."""
    infos: dict[str, Column] = {}
    others = []
    for name in fields.names:
        if name in (*_COLUMNS, "terminals", "timeouts"):
            continue
        if name.startswith("infos/"):
            column = fields.further(name, rows)
            if column is not None:
                infos[name.removeprefix("infos/").replace("/", ".")] = column
                continue
        others.append(name)
    return infos, others


def _policy_arrays(fields: Fields) -> list[str]:
    names = [name for name in fields.names if name.startswith(f"{_POLICY}/")]
    return [name for name in names if fields.kind(name)[0] in "biuf" and fields.kind(name)[1]]


def _policy_facts(fields: Fields) -> dict[str, Any]:
    """What `metadata` says of the run that recorded the file, in JSON types."""
    facts: dict[str, Any] = {}
    for name in ("algorithm", "iteration"):
        if f"metadata/{name}" in fields.names:
            facts[name] = fields.scalar(f"metadata/{name}")
    arrays = _policy_arrays(fields)
    if arrays:
        policy: dict[str, Any] = {
            "arrays": {name.removeprefix(f"{_POLICY}/"): list(fields.kind(name)[1]) for name in arrays}
        }
        for name in ("nonlinearity", "output_distribution"):
            if f"{_POLICY}/{name}" in fields.names:
                policy[name] = fields.scalar(f"{_POLICY}/{name}")
        facts["behaviour_policy"] = policy
    return facts


def _suspicion(count: int) -> dict[str, Any]:
    return {
        "finding": "terminals-equal-timeouts",
        "count": count,
        "message": f"all {count} timeouts are terminals too; if they are time limits, learned values are wrong",
    }
