"""Reader of Minari's folders: episodes of T steps with T + 1 observations, in one HDF5 file or an Arrow file each."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odaf.data import storage, validation
from odaf.data.log import Column, Log
from odaf.data.readers import hdf5
from odaf.data.readers.attempts import told_for_goal
from odaf.data.readers.columns import Joined, Pieces
from odaf.data.readers.minari_environment import environments_of, json_object
from odaf.errors import DatasetError

POSITIONS = "observations/achieved_goal"
MAIN_FILE = "main_data.hdf5"
EPISODE = re.compile(r"episode_(0|[1-9]\d{0,17})")
_FACTS = ("dataset_id", "total_episodes", "total_steps", "algorithm_name", "minari_version", "env_spec")


@runtime_checkable
class Episodes(Protocol):
    """Episodes in either container; an entry of a dictionary or tuple is addressed as `observations/goal`, `actions/0`.

    Attributes:
        ids: of the episodes, ascending.
    """

    ids: tuple[int, ...]

    def leaves(self) -> list[str]:
        """Addresses of all arrays of the first episode, sorted."""
        ...

    def column(self, leaf: str) -> Pieces:
        """All recorded rows of an array, one piece an episode: T + 1 of an observation, T of the others."""
        ...


def read(
    path: Path,
    *,
    observations: Sequence[str] | None = None,
    actions: Sequence[str] | None = None,
    action_bounds: validation.Bounds | None = None,
    goal: Sequence[float] | None = None,
    goal_radius: float = 0.45,
) -> Log:
    """The log in a Minari folder; its large columns stay in the files until they are sliced.

    The successor of each step is the recorded one, also at the end of an episode. Infos with an entry per observation
    or per step become infos, less the entry that belongs to the last observation of an episode.

    Args:
        path: the data set's folder, the `data` folder in it, or `main_data.hdf5`.
        observations: for observations in a dictionary or tuple, the entries to join into one vector, in this order:
            `["achieved_goal", "observation"]`, `["sensors/imu"]`, or `["0", "1"]` for a tuple.
        actions: the same for actions.
        action_bounds: lowest and highest action. None takes them from the action space in `metadata.json`, and where
            that has none, from the data.
        goal: (x, y) of one goal of a maze whose recording gave a robot a new goal wherever it reached one. The rewards
            are told anew for it, 1 where it is reached and 0 elsewhere, the task ends there, and rows are left out
            until the robot has gone away again; see `odaf.data.readers.attempts`. Positions are the observations'
            entry `achieved_goal`.
        goal_radius: how near counts as there; 0.45 in the mazes of gymnasium-robotics.

    Raises:
        DatasetError: no episodes, an entry that is missing or has to be named, discrete actions, images, or episodes
            that differ in shape.
    """
    source = os.fspath(path)
    folder = data_folder(path)
    metadata = _metadata(folder / "metadata.json", source)
    episodes = _episodes(folder, source, metadata)
    leaves = episodes.leaves()
    observed = _chosen(source, metadata, leaves, "observations", observations)
    acted = _chosen(source, metadata, leaves, "actions", actions)
    rewards = episodes.column("rewards")
    steps = rewards.lengths
    ends = {field: _of_steps(source, episodes.column(field), field, steps) for field in ("terminations", "truncations")}
    before = [_of_steps(source, episodes.column(leaf), leaf, steps, 1) for leaf in observed]
    done = [_of_steps(source, episodes.column(leaf), leaf, steps) for leaf in acted]
    columns: dict[str, Column] = {
        "observations": Joined(tuple(before)),
        "actions": Joined(tuple(done)),
        "rewards": rewards,
        "next_observations": Joined(tuple(replace(column, skip=1) for column in before)),
        "terminated": np.asarray(ends["terminations"][:]),
        "truncated": np.asarray(ends["truncations"][:]),
        "episode": np.repeat(np.array(episodes.ids, np.int64), steps),
    }
    infos, others = _infos(episodes, leaves, steps)
    named, findings = environments_of(metadata)
    read_leaves = {"rewards", *ends, *observed, *acted}
    log = Log(
        columns=columns,
        source=source,
        format="minari",
        observation_names=None if observations is None else _names(observed, before),
        action_names=None if actions is None else _names(acted, done),
        action_bounds=_bounds(metadata, acted, done) if action_bounds is None else action_bounds,
        infos=infos,
        provenance=_provenance(path, metadata)
        | named
        | {"fields_not_read": sorted({leaf for leaf in leaves if leaf not in read_leaves} - set(others))},
        findings=(*_missing_episodes(metadata, len(episodes.ids)), *findings),
    )
    if goal is None:
        return log
    if POSITIONS not in leaves:
        raise DatasetError(f"{source}: goal= needs positions in field '{POSITIONS}', which is missing; leave goal= out")
    before = _of_steps(source, episodes.column(POSITIONS), POSITIONS, steps, 1)
    return told_for_goal(log, goal, goal_radius, before, replace(before, skip=1))


def data_folder(path: Path) -> Path:
    """The folder that holds `metadata.json` and the episodes, from the folder above, itself, or its HDF5 file."""
    if path.is_file():
        return path.parent
    return path / "data" if (path / "data").is_dir() else path


def _episodes(folder: Path, source: str, metadata: Mapping[str, Any]) -> Episodes:
    written = metadata.get("data_format")
    inside = sorted(folder.iterdir()) if folder.is_dir() else ()
    arrow = [entry.name for entry in inside if entry.is_dir() and entry.name.isdigit()]
    if (folder / MAIN_FILE).is_file() and not (arrow and written in ("arrow", "parquet")):
        if arrow and written != "hdf5":
            raise DatasetError(
                f"{source}: holds episodes in {MAIN_FILE} and in folders ({arrow[0]}, ...), and metadata.json does not "
                "say in 'data_format' which of them count; move one of the two elsewhere"
            )
        return Hdf5Episodes(folder / MAIN_FILE)
    from odaf.data.readers.minari_arrow import ArrowEpisodes

    return ArrowEpisodes(folder, source)


class Hdf5Episodes:
    """One HDF5 file with a group per episode; the groups may be in any order, and numbers may be missing."""

    def __init__(self, path: Path):
        self._path = path
        with storage.opened(path) as (file, source), storage.reading(source):
            names = hdf5.keys(file)
            strange = [name for name in names if not EPISODE.fullmatch(name)]
            if strange or not names:
                raise DatasetError(
                    f"{source}: expected one group per episode (episode_0, ...), found "
                    f"{hdf5.shown(strange) if strange else 'nothing'}; give a file written by Minari"
                )
            self.ids = tuple(sorted(int(name.removeprefix("episode_")) for name in names))
            first = f"episode_{self.ids[0]}"
            self._stored = {
                _address(name.removeprefix(f"{first}/")): name.removeprefix(f"{first}/")
                for name in hdf5.arrays_below(file, source, first)
            }

    def leaves(self) -> list[str]:
        return sorted(self._stored)

    def column(self, leaf: str) -> Pieces:
        with storage.opened(self._path) as (file, source), storage.reading(source):
            stored = self._stored.get(leaf, leaf)
            return hdf5.pieces(self._path, file, source, [f"episode_{number}/{stored}" for number in self.ids])


def _address(name: str) -> str:
    """`observations/_index_0`, as tuples are stored, becomes `observations/0`."""
    return "/".join(re.sub(r"^_index_(\d+)$", r"\1", part) for part in name.split("/"))


def _chosen(
    source: str, metadata: Mapping[str, Any], leaves: list[str], field: str, entries: Sequence[str] | None
) -> list[str]:
    """Addresses of the arrays that make up observations or actions."""
    known = [leaf.removeprefix(f"{field}/") for leaf in leaves if leaf.startswith(f"{field}/")]
    if field in leaves or not known:
        if entries is not None:
            raise DatasetError(f"{source}: {field}={list(entries)} was given, but they have no entries; leave it out")
        chosen = [field]
    elif not entries or isinstance(entries, str) or any(entry not in known for entry in entries):
        raise DatasetError(
            f"{source}: field '{field}' has the entries {known}"
            + ("" if entries is None else f", and {entries!r} was asked for"),
            remedies=[f"name those to join into one vector, for instance {field}={known}"],
        )
    else:
        chosen = [f"{field}/{entry}" for entry in entries]
    for leaf in chosen:
        space = _space(metadata, leaf)
        kind, shape = space.get("type"), space.get("shape")
        if kind in ("Discrete", "MultiDiscrete", "Text"):
            raise DatasetError(
                f"{source}: field '{leaf}' is of a {kind} space; odaf learns from vectors and continuous actions"
            )
        if kind == "Box" and space.get("dtype") == "uint8" and isinstance(shape, list) and len(shape) == 3:
            raise DatasetError(f"{source}: field '{leaf}' holds images; odaf learns from vectors")
    return chosen


def _of_steps(source: str, column: Pieces, field: str, steps: np.ndarray, extra: int = 0) -> Pieces:
    """The column cut to one row per step; raises unless each episode has `extra` rows more than steps."""
    wrong = np.flatnonzero(column.lengths != steps + extra)
    if len(wrong):
        first = int(wrong[0])
        raise DatasetError(
            f"{source}: field '{field}' has {column.lengths[first]:,} rows in episode number {first} of the file, "
            f"'rewards' has {steps[first]:,}; expected {'as many' if not extra else 'one more'}: record the episode "
            "again, or leave it out"
        )
    return replace(column, lengths=steps)


def _infos(episodes: Episodes, leaves: list[str], steps: np.ndarray) -> tuple[dict[str, Column], list[str]]:
    """(infos that every episode has in equal shape, by name; their addresses)."""
    infos: dict[str, Column] = {}
    addresses = []
    for leaf in leaves:
        if not leaf.startswith("infos/"):
            continue
        try:
            column = episodes.column(leaf)
        except DatasetError:
            continue  # texts, or absent in some episodes: it stays among the fields that are not read
        if np.array_equal(column.lengths, steps) or np.array_equal(column.lengths, steps + 1):
            infos[leaf.removeprefix("infos/").replace("/", ".")] = replace(column, lengths=steps)
            addresses.append(leaf)
    return infos, addresses


def _names(leaves: list[str], columns: Sequence[Pieces]) -> tuple[str, ...]:
    names: list[str] = []
    for leaf, column in zip(leaves, columns, strict=True):
        entry = leaf.split("/", 1)[1].replace("/", ".")
        width = int(np.prod(column.row_shape, dtype=np.int64))
        names += [entry] if width == 1 else [f"{entry}_{index}" for index in range(width)]
    return tuple(names)


def _metadata(path: Path, source: str) -> dict[str, Any]:
    """The contents of `metadata.json`; empty where there is none, as for an HDF5 file on its own."""
    if not path.is_file():
        return {}
    try:
        metadata = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: cannot be read as JSON ({error}); copy the folder again") from error
    if not isinstance(metadata, dict):
        raise DatasetError(f"{path}: holds a {type(metadata).__name__}, expected an object; copy the folder again")
    return metadata


def _space(metadata: Mapping[str, Any], leaf: str) -> Mapping[str, Any]:
    """The description of the space an array comes from; empty where the metadata has none."""
    field, *entries = leaf.split("/")
    space = json_object(metadata.get({"observations": "observation_space", "actions": "action_space"}[field]))
    for entry in entries:
        below = space.get("subspaces")
        if isinstance(below, list):
            below = {str(index): part for index, part in enumerate(below)}
        space = below.get(entry) if isinstance(below, dict) else None
        if not isinstance(space, dict):
            return {}
    return space


def _bounds(metadata: Mapping[str, Any], leaves: list[str], columns: Sequence[Pieces]) -> np.ndarray | None:
    """[2, act_dim] from the action space, None where it is unknown or unbounded."""
    edges = []
    for leaf, column in zip(leaves, columns, strict=True):
        space = _space(metadata, leaf)
        try:
            pair = np.stack([np.array(space[edge], np.float32).reshape(-1) for edge in ("low", "high")])
        except (KeyError, ValueError, TypeError, OverflowError):
            return None
        if pair.shape[1] != np.prod(column.row_shape) or not np.isfinite(pair).all() or (pair[0] >= pair[1]).any():
            return None
        edges.append(pair)
    return np.concatenate(edges, axis=1)


def _provenance(path: Path, metadata: Mapping[str, Any]) -> dict[str, Any]:
    facts: dict[str, Any] = {name: metadata[name] for name in _FACTS if isinstance(metadata.get(name), (str, int))}
    needed = metadata.get("requirements")
    if isinstance(needed, list) and needed and all(isinstance(entry, str) for entry in needed):
        facts["requirements"] = needed
    return {"file": path.name, "minari": facts}


def _missing_episodes(metadata: Mapping[str, Any], found: int) -> tuple[dict[str, Any], ...]:
    total = metadata.get("total_episodes")
    if not isinstance(total, int) or total == found:
        return ()
    message = f"metadata.json speaks of {total:,} episodes, {found:,} were found; the copy may be incomplete"
    return ({"finding": "episodes-missing", "count": abs(total - found), "message": message},)
