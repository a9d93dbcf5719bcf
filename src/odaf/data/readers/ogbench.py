"""Reader of OGBench's `.npz` files: trajectories without rewards, made for goals that are chosen afterwards."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from odaf.data import validation
from odaf.data.log import Column, Log
from odaf.data.readers import numpy_files
from odaf.data.readers.attempts import goal_of
from odaf.errors import DatasetError

REQUIRED = ("observations", "actions", "terminals")
_READ = (*REQUIRED, "rewards", "masks", "next_observations")


def read(
    path: Path,
    *,
    reward: str | os.PathLike[str] | np.ndarray | float | None = None,
    goal: Sequence[float] | None = None,
    goal_radius: float = 1.0,
    action_bounds: validation.Bounds | None = (-1.0, 1.0),
) -> Log:
    """The log in an OGBench file, in memory.

    `terminals` mark the last stored row of a trajectory, which is there for its observation only: it has no successor,
    so the trajectory counts as truncated and the dataset drops that row. Where the file stores `next_observations`, as
    one of loaded arrays does, every row is a step and none is dropped. `masks` of 0 end the task. The published files
    hold no rewards: one of `reward` and `goal` has to say what they are. Other arrays with one entry per row become
    infos.

    Args:
        path: an `.npz` file.
        reward: a number that every row earned ("zero" for 0.0); or one number per stored row, as an array or the path
            of an `.npy` file.
        goal: (x, y) of the mazes' goal. The reward is 0 where the position of the row lies within `goal_radius`, and
            -1 elsewhere; the task ends there (`terminated`), so that nothing is expected afterwards, although the
            trajectory goes on: its remaining rows form further episodes. The position is `qpos[:, :2]`.
        goal_radius: 1.0 for the point mazes, 0.5 for those of the ant and the humanoid.
        action_bounds: lowest and highest action; [-1, 1] holds for the published files. None takes them from the data.

    Raises:
        DatasetError: a field is missing, holds objects or pixels, or nothing says what the rewards are.
    """
    source = os.fspath(path)
    if not os.path.isfile(source):
        raise DatasetError(f"{source}: there is no such file; check the path, or make the data first")
    arrays = numpy_files.read_members(path)
    for name in REQUIRED:
        if name not in arrays:
            raise DatasetError(
                f"{source}: field '{name}' is missing; the file has {sorted(arrays)}: rename the column or generate "
                "the file again"
            )
    observations = arrays["observations"]
    if observations.ndim > 2:
        raise DatasetError(
            f"{source}: field 'observations' has shape {observations.shape}, as images have; odaf learns from vectors: "
            "use the state-based variant of the file"
        )
    last = validation.flags(source, "terminals", arrays["terminals"])
    rows = len(last)
    for name in (*(name for name in _READ if name in arrays), *(["qpos"] if goal is not None else [])):
        if name in arrays and (arrays[name].ndim == 0 or len(arrays[name]) != rows):
            raise DatasetError(
                f"{source}: field '{name}' has shape {arrays[name].shape}, 'terminals' has {rows:,} rows; "
                "every field needs one entry per step"
            )
    if "valids" in arrays:
        raise DatasetError(
            f"{source}: field 'valids' shows OGBench's compact form, whose 'terminals' mark other rows; save the "
            "arrays with compact_dataset off, or give the file that OGBench provides"
        )
    findings: list[dict[str, Any]] = []
    terminated = np.zeros(rows, bool)
    no_step = last if "next_observations" not in arrays else np.zeros(rows, bool)  # rows that are no step
    if "masks" in arrays:
        terminated = ~validation.flags(source, "masks", arrays["masks"]) & ~no_step
    if "rewards" in arrays:
        if reward is not None or goal is not None:
            raise DatasetError(f"{source}: has its own 'rewards'; leave reward= and goal= out")
        rewards = arrays["rewards"]
    elif goal is not None and reward is None:
        reached = _reached(source, arrays.get("qpos"), goal_of(source, goal, goal_radius), goal_radius)
        rewards, terminated = reached.astype(np.float32) - 1, reached & ~no_step
        findings.append(
            {
                "finding": "rewards-from-goal",
                "count": int(reached.sum()),
                "message": f"rewards are 0 within {goal_radius} of {list(map(float, goal))} and -1 elsewhere; "
                f"the task ends in {validation.name_rows(reached) if reached.any() else 'no row'}",
            }
        )
    else:
        rewards = _given_rewards(source, reward, goal, rows)
    ends = last | terminated
    columns: dict[str, Column] = {
        "observations": observations,
        "actions": arrays["actions"],
        "rewards": rewards,
        "terminated": terminated,
        "truncated": last & ~terminated,
        "episode": np.cumsum(ends, dtype=np.int64) - ends,
    }
    if "next_observations" in arrays:
        columns["next_observations"] = arrays["next_observations"]
    others = {name: array for name, array in arrays.items() if name not in _READ}
    kept = {name: numpy_files.further(array, rows) for name, array in others.items()}
    infos: dict[str, Column] = {name: array for name, array in kept.items() if array is not None}
    return Log(
        columns=columns,
        source=source,
        format="ogbench",
        action_bounds=action_bounds,
        infos=infos,
        provenance={"file": os.path.basename(source), "fields_not_read": sorted(set(others) - set(infos))},
        findings=tuple(findings),
    )


def _reached(source: str, positions: np.ndarray | None, goal: np.ndarray, radius: float) -> np.ndarray:
    if positions is None or positions.ndim != 2 or positions.shape[1] < 2 or positions.dtype.kind not in "iuf":
        raise DatasetError(f"{source}: goal= needs positions in field 'qpos' [rows, 2 or more]; pass reward= instead")
    return np.linalg.norm(positions[:, :2].astype(np.float64) - goal, axis=1) <= radius


def _given_rewards(
    source: str, reward: str | os.PathLike[str] | np.ndarray | float | None, goal: Sequence[float] | None, rows: int
) -> np.ndarray:
    if goal is not None:
        raise DatasetError(f"{source}: reward= and goal= were both given; say what the rewards are in one way")
    if reward is None:
        raise DatasetError(
            f"{source}: OGBench files hold no rewards",
            remedies=[
                "pass goal=(x, y) for a maze",
                "reward= with an .npy file of one number per stored row",
                "reward=0.0 for cloning",
            ],
        )
    if isinstance(reward, (int, float)) or (isinstance(reward, str) and reward == "zero"):
        return np.full(rows, 0.0 if isinstance(reward, str) else reward, np.float32)
    values = reward if isinstance(reward, np.ndarray) else numpy_files.read_single(reward)
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)  # to be counted as missing
    if values.shape not in ((rows,), (rows, 1)):
        raise DatasetError(f"{source}: reward has shape {values.shape}; give one number for each of {rows:,} rows")
    return values
