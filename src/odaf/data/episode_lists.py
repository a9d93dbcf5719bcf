"""Episodes in memory, one mapping from field to array each, as one log."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odaf.data import validation
from odaf.data.log import Log
from odaf.errors import DatasetError

_REQUIRED = ("observations", "actions", "rewards")
_ENDS = ("terminated", "truncated")


def read(episodes: Sequence[Mapping[str, Any]], *, source: str = "episodes", **options: Any) -> Log:
    """The log of a list of episodes.

    Args:
        episodes: each with `observations` [T + 1, obs_dim] or [T, obs_dim], `actions` [T, act_dim], `rewards` [T], and
            where known `terminated` and `truncated`, as [T] or one bool for the end of the episode. T + 1 observations
            hold the last successor. With T, a last row that is not terminated has none and is left out of the dataset.
        source: how messages name the list.
        options: `action_bounds`, names and units, as attributes of `Log`.

    Raises:
        DatasetError: there are no episodes, or a field of one is missing, unknown or of another length.
    """
    parts = [_steps(f"{source}: episode {index}", episode) for index, episode in enumerate(episodes)]
    if not parts:
        raise DatasetError(f"{source}: the list is empty; a dataset needs at least one episode")
    for field in ("observations", "actions"):
        widths = [part[field].shape[1] for part in parts]
        odd = next((index for index, width in enumerate(widths) if width != widths[0]), None)
        if odd is not None:
            raise DatasetError(
                f"{source}: episode {odd}: field '{field}' has {widths[odd]} columns, in episode 0 it has {widths[0]}; "
                "all episodes need the same quantities"
            )
    findings = _add_successors(parts)
    columns: dict[str, np.ndarray] = {
        field: np.concatenate([part[field] for part in parts])
        for field in (*_REQUIRED, *_ENDS, "next_observations")
        if field in parts[0]
    }
    columns["episode"] = np.repeat(np.arange(len(parts)), [len(part["actions"]) for part in parts])
    return Log(columns=columns, source=source, format="episodes", findings=tuple(findings), **options)


def _steps(source: str, episode: Any) -> dict[str, np.ndarray]:
    """One episode's columns; with `next_observations` where T + 1 observations were given."""
    if not isinstance(episode, Mapping):
        raise DatasetError(f"{source}: is a {type(episode).__name__}; give a mapping with {', '.join(_REQUIRED)}")
    known = (*_REQUIRED, *_ENDS)
    for name in episode:
        if name not in known:
            nearest = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            raise DatasetError(f"{source}: field {name!r} is unknown; {hint}known are {', '.join(known)}")
    for name in _REQUIRED:
        if name not in episode:
            raise DatasetError(f"{source}: field '{name}' is missing; it has {', '.join(map(repr, episode))}")
    observations = validation.numbers(source, "observations", episode["observations"])
    actions = validation.numbers(source, "actions", episode["actions"])
    rewards = validation.numbers(source, "rewards", episode["rewards"])
    for name, array in (("observations", observations), ("actions", actions)):
        if array.ndim != 2:
            raise DatasetError(
                f"{source}: field '{name}' has shape {array.shape}; it must be [steps, dimensions], one row a step"
            )
    steps = len(actions)
    if steps == 0:
        raise DatasetError(f"{source}: has no actions; leave empty episodes out")
    if len(observations) not in (steps, steps + 1):
        raise DatasetError(
            f"{source}: field 'observations' has {len(observations):,} rows for {steps:,} actions; give {steps:,}, or "
            f"{steps + 1:,} with the one after the last action"
        )
    if rewards.shape not in ((steps,), (steps, 1)):
        raise DatasetError(f"{source}: field 'rewards' has shape {rewards.shape} for {steps:,} actions; give one each")
    columns = {"observations": observations[:steps], "actions": actions, "rewards": rewards.reshape(steps)}
    if len(observations) == steps + 1:
        columns["next_observations"] = observations[1:]
    for name in _ENDS:
        columns[name] = _flags(source, name, episode.get(name, False), steps)
    return columns


def _flags(source: str, name: str, values: Any, steps: int) -> np.ndarray:
    array = validation.numbers(source, name, values)
    if array.ndim == 0:
        last = np.zeros(steps, array.dtype)
        last[-1] = array
        array = last
    if array.shape not in ((steps,), (steps, 1)):
        raise DatasetError(
            f"{source}: field '{name}' has shape {array.shape} for {steps:,} actions; give one each, or one for the end"
        )
    return validation.flags(source, name, array)


def _add_successors(parts: list[dict[str, np.ndarray]]) -> list[dict[str, Any]]:
    """Where only some episodes hold their last successor, completes or shortens the others."""
    without = [index for index, part in enumerate(parts) if "next_observations" not in part]
    if not without or len(without) == len(parts):
        return []
    dropped = []
    for index in without:
        part = parts[index]
        part["next_observations"] = np.concatenate([part["observations"][1:], part["observations"][-1:]])
        if not part["terminated"][-1]:
            dropped.append(index)
            for name in part:
                part[name] = part[name][:-1]
    parts[:] = [part for part in parts if len(part["actions"])]
    if not dropped:
        return []
    shown = ", ".join(map(str, dropped[:5])) + (", ..." if len(dropped) > 5 else "")
    message = f"last rows of truncated episodes dropped: no next observation was logged, in episodes {shown}"
    return [{"finding": "dropped-without-successor", "count": len(dropped), "message": message}]
