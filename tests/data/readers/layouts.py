"""The same episodes in every layout that can be read, for tests that hold for all readers.

An entry of `LAYOUTS` or `OTHERS` is a function that writes episodes into a folder and returns what is to be read, the
function that reads it, and that function's options.
"""

import json
from typing import Any

import h5py
import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset, checks, episode_lists, readers
from odaf.data.readers import tables


def episodes_of(lengths, seed=0):
    """Episodes of so many steps with one observation more; the first entry of an observation is its own number."""
    rng = np.random.default_rng(seed)
    result = []
    for number, steps in enumerate(lengths):
        observations = rng.normal(size=(steps + 1, 3)).astype(np.float32)
        observations[:, 0] = 1000 * number + np.arange(steps + 1)
        result.append(
            {
                "observations": observations,
                "actions": rng.uniform(-1, 1, (steps, 2)).astype(np.float32),
                "rewards": rng.normal(size=steps).astype(np.float32),
                "terminated": bool(number % 2 == 0),
            }
        )
    return result


def joined(episodes, field, stop=None):
    return np.concatenate([episode[field][:stop] for episode in episodes])


def ends(episodes, terminated):
    return np.concatenate(
        [np.arange(len(e["rewards"])) == len(e["rewards"]) - 1 if e["terminated"] is terminated
         else np.zeros(len(e["rewards"]), bool) for e in episodes]
    )  # fmt: skip


def write_d4rl(path, episodes, successors=True):
    path = path / "file.hdf5"
    with h5py.File(path, "w") as file:
        file["observations"] = joined(episodes, "observations", -1)
        file["actions"], file["rewards"] = joined(episodes, "actions"), joined(episodes, "rewards")
        file["terminals"], file["timeouts"] = ends(episodes, True), ends(episodes, False)
        if successors:
            file["next_observations"] = np.concatenate([e["observations"][1:] for e in episodes])
        file["infos/qpos"] = joined(episodes, "observations", -1)
        file["metadata/policy/fc0/weight"] = np.zeros((3, 4))
        file["metadata/policy/nonlinearity"] = "relu"
        file["metadata/algorithm"] = np.bytes_("SAC")
    return path


def write_d4rl_packed(path, episodes):
    plain = write_d4rl(path, episodes, successors=False)
    packed = path / "packed.hdf5"
    with h5py.File(plain) as source, h5py.File(packed, "w") as file:
        for name in ("observations", "actions", "rewards", "terminals", "timeouts"):
            file.create_dataset(name, data=np.asarray(source[name]), chunks=True, compression="gzip")
    plain.unlink()
    return packed


def write_d4rl_archive(path, episodes):
    file = write_d4rl(path, episodes)
    with h5py.File(file) as source:
        names = ("observations", "actions", "rewards", "next_observations", "terminals", "timeouts", "infos/qpos")
        arrays: dict[str, Any] = {name: np.asarray(source[name]) for name in names}
        np.savez(path / "file.npz", **arrays)
    file.unlink()
    return path / "file.npz"


def metadata_of(episodes):
    box = {"type": "Box", "dtype": "float32", "shape": [2], "low": [-1.0, -1.0], "high": [1.0, 1.0]}
    return {
        "total_episodes": len(episodes),
        "total_steps": sum(len(e["rewards"]) for e in episodes),
        "action_space": json.dumps(box),
        "env_spec": json.dumps({"id": "Hopper-v5", "entry_point": "os:system", "kwargs": {}}),
    }


def write_minari_hdf5(path, episodes):
    folder = path / "set" / "data"
    folder.mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({**metadata_of(episodes), "data_format": "hdf5"}))
    with h5py.File(folder / "main_data.hdf5", "w", track_order=True) as file:
        for number in reversed(range(len(episodes))):  # neither in order nor without gaps
            episode, group = episodes[number], file.create_group(f"episode_{2 * number}")
            group.attrs["id"] = 2 * number
            for name, values in minari_fields(episode).items():
                group.create_dataset(name, data=values, chunks=True, maxshape=(None, *values.shape[1:]))
    return path / "set"


def minari_fields(episode):
    steps = len(episode["rewards"])
    last = np.arange(steps) == steps - 1
    return {
        "observations/goal": episode["observations"][:, :1],
        "observations/state": episode["observations"][:, 1:],
        "actions": episode["actions"],
        "rewards": episode["rewards"].astype(np.float64),
        "terminations": last & episode["terminated"],
        "truncations": last & (not episode["terminated"]),
        "infos/qpos": episode["observations"],
    }


def write_minari_arrow(path, episodes):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import ipc

    folder = path / "set" / "data"
    folder.mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({**metadata_of(episodes), "data_format": "arrow"}))

    def rows(values):
        return pa.FixedSizeListArray.from_arrays(values.reshape(-1), type=pa.list_(pa.float32(), values.shape[1]))

    for number, episode in enumerate(episodes):
        fields = minari_fields(episode)
        padded = {
            name: np.concatenate([fields[name], np.zeros_like(fields[name][:1])])
            for name in ("actions", "rewards", "terminations", "truncations")
        }
        goal, state = rows(fields["observations/goal"]), rows(fields["observations/state"].copy())
        table = pa.table(
            {
                "observations": pa.StructArray.from_arrays([goal, state], names=["goal", "state"]),
                "actions": rows(padded["actions"]),
                **{name: padded[name] for name in ("rewards", "terminations", "truncations")},
                "infos": pa.StructArray.from_arrays([rows(fields["infos/qpos"])], names=["qpos"]),
            }
        )
        (folder / str(number)).mkdir()
        with ipc.new_file(folder / str(number) / "part-0.arrow", table.schema) as file:
            file.write_table(table)
    return path / "set"


def write_ogbench(path, episodes):
    """All T + 1 observations are stored; the action of the last row has no meaning."""
    fields = {
        "observations": joined(episodes, "observations"),
        "actions": np.concatenate([np.append(e["actions"], e["actions"][-1:], axis=0) for e in episodes]),
        "terminals": np.concatenate([np.arange(len(e["observations"])) == len(e["rewards"]) for e in episodes]),
        "qpos": joined(episodes, "observations"),
    }
    np.savez_compressed(path / "file.npz", **fields)
    return path / "file.npz"


def write_d3rlpy(path, episodes):
    """An episode that did not terminate stores its T + 1 observations as T + 1 rows, the last one without successor."""
    with h5py.File(path / "file.h5", "w") as file:
        file["columns"] = ["observations", "actions", "rewards", "terminated"]
        file["num_episodes"], file["version"] = len(episodes), "2.1"
        for number, episode in enumerate(episodes):
            extra = [] if episode["terminated"] else [-1]
            file[f"observations_{number}"] = episode["observations"][: len(episode["rewards"]) + len(extra)]
            for name in ("actions", "rewards"):
                values = np.concatenate([episode[name], episode[name][extra]])
                file[f"{name}_{number}"] = values if values.ndim == 2 else values[:, None]
            file[f"terminated_{number}"] = episode["terminated"]
    return path / "file.h5"


def columns_of(episodes):
    """Columns of a table by name; times count the steps of each episode."""
    observations, successors = joined(episodes, "observations", -1), [e["observations"][1:] for e in episodes]
    columns = {f"o{axis}": observations[:, axis] for axis in range(3)}
    columns |= {f"n{axis}": np.concatenate(successors)[:, axis] for axis in range(3)}
    columns |= {f"a{axis}": joined(episodes, "actions")[:, axis] for axis in range(2)}
    lengths = [len(e["rewards"]) for e in episodes]
    return columns | {
        "reward": joined(episodes, "rewards"),
        "batch": np.repeat(np.arange(len(episodes)), lengths),
        "time": np.concatenate([0.5 * np.arange(length) for length in lengths]),
        "ended": ends(episodes, True).astype(int),
    }


def write_csv(path, episodes):
    pl.DataFrame(columns_of(episodes)).write_csv(path / "log.csv")
    return path / "log.csv"


def write_csv_shuffled(path, episodes):
    """Rows in disorder, as a logger with several sources leaves them."""
    frame = pl.DataFrame(columns_of(episodes))
    frame.sample(fraction=1.0, shuffle=True, seed=len(frame)).write_csv(path / "log.csv", separator=";")
    return path / "log.csv"


def write_parquet(path, episodes):
    pl.DataFrame(columns_of(episodes)).write_parquet(path / "log.parquet")
    return path / "log.parquet"


def write_lerobot(path, episodes):
    """Two episodes a file; whatever is over goes into the last."""
    columns = columns_of(episodes)
    frame = pl.DataFrame(
        {
            "observation.state": joined(episodes, "observations", -1),
            "action": joined(episodes, "actions"),
            "next.reward": columns["reward"],
            "next.done": ends(episodes, True),
            "timestamp": columns["time"],
            "episode_index": columns["batch"],
        }
    )
    folder = path / "set"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    for number, first in enumerate(range(0, len(episodes), 2)):
        part = frame.filter(pl.col("episode_index").is_between(first, first + 1))
        part.write_parquet(folder / "data" / "chunk-000" / f"file-{number:03d}.parquet")
    info = {"codebase_version": "v3.0", "fps": 2, "features": {}, "total_frames": len(frame)}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return folder


def write_own(path, episodes):
    Dataset.from_episodes(episodes, action_bounds=(-1.0, 1.0)).save(path / "own.h5")
    return path / "own.h5"


TABLE: dict[str, Any] = {
    "observations": ["o0", "o1", "o2"],
    "actions": ["a0", "a1"],
    "reward": "reward",
    "episode": "batch",
    "terminated": "ended",
    "action_bounds": (-1.0, 1.0),
}
SUCCESSORS = {"next_observations": ["n0", "n1", "n2"]}
TIMED = {"time": "time", "time_step": 0.5}

# Files of layouts that say themselves what their fields mean. Name: (writer, reader, options of the reader).
LAYOUTS: dict[str, Any] = {
    "d4rl": (write_d4rl, readers.read, {}),
    "d4rl-archive": (write_d4rl_archive, readers.read, {}),
    "d4rl-packed": (write_d4rl_packed, readers.read, {}),
    "minari-hdf5": (write_minari_hdf5, readers.read, {"observations": ["goal", "state"]}),
    "minari-arrow": (write_minari_arrow, readers.read, {"observations": ["goal", "state"]}),
    "ogbench": (write_ogbench, readers.read, {"reward": "zero"}),
    "d3rlpy": (write_d3rlpy, readers.read, {"action_bounds": (-1.0, 1.0)}),
}
# Tables (damaged ones have a test of their own), our own files, and data in memory.
OTHERS: dict[str, Any] = {
    "csv": (write_csv, readers.read, {**TABLE, **TIMED}),
    "csv-successors": (write_csv, readers.read, {**TABLE, **SUCCESSORS}),
    "csv-shuffled": (write_csv_shuffled, readers.read, {**TABLE, **TIMED, "sort_by": ["batch", "time"]}),
    "parquet": (write_parquet, readers.read, TABLE),
    "parquet-successors": (write_parquet, readers.read, {**TABLE, **TIMED, **SUCCESSORS}),
    "lerobot": (write_lerobot, readers.read, {"action_bounds": (-1.0, 1.0)}),
    "frame": (lambda path, episodes: pl.DataFrame(columns_of(episodes)), tables.from_frame, TABLE),
    "episodes": (lambda path, episodes: episodes, episode_lists.read, {"action_bounds": (-1.0, 1.0)}),
    "odaf": (write_own, checks.open_log, {}),
}
# Those that nowhere record what followed the last action of an episode that was cut.
LOSES_LAST = {"d4rl-packed", "csv", "csv-shuffled", "parquet", "lerobot", "frame"}
