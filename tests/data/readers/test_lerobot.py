"""LeRobot folders of versions 2 and 3, written by the test."""

import inspect
import json

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset, readers
from odaf.data.readers import lerobot
from odaf.errors import OPTION, DatasetError

LENGTHS = (4, 3, 5)


def frames(lengths=LENGTHS, **changes):
    """Frames whose state is (number of the frame, number of the episode)."""
    episode = np.repeat(np.arange(len(lengths)), lengths)
    number = np.concatenate([np.arange(length) for length in lengths])
    rows = len(episode)
    columns = {
        "observation.state": np.stack([np.arange(rows), episode], axis=1).astype(np.float32),
        "action": np.stack([0.1 * number, -0.1 * number], axis=1).astype(np.float32),
        "next.reward": np.arange(rows, dtype=np.float32) + 0.5,
        "next.done": np.append(np.diff(episode) == 1, True) & (episode != 1),
        "timestamp": (number / 10).astype(np.float32),
        "frame_index": number,
        "episode_index": episode,
        "index": np.arange(rows),
        "task_index": np.zeros(rows, int),
    }
    columns |= changes
    return pl.DataFrame({name: values for name, values in columns.items() if values is not None})


def folder(path, table, version, **changes):
    """Version 2: one file an episode; version 3: the first two episodes in one file, the last in another."""
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": ["x", "y"]},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["left", "right"]}},
        "next.reward": {"dtype": "float32", "shape": [1], "names": None},
        "observation.images.top": {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channel"]},
    }
    info = {
        "codebase_version": f"v{version}",
        "robot_type": "arm",
        "fps": 10,
        "total_frames": table.height,
        "features": features,
    }
    if version < 3:
        # In version 2 list columns have no fixed length.
        table = table.with_columns(pl.col("observation.state", "action").arr.to_list())
        parts = {f"episode_{e:06d}": table.filter(episode_index=e) for e in table["episode_index"].unique()}
    else:
        parts = {
            f"file-{n:03d}": table.filter(pl.col("episode_index").is_in(ids)) for n, ids in enumerate(([0, 1], [2]))
        }
    (path / "data" / "chunk-000").mkdir(parents=True)
    for name, part in parts.items():
        part.write_parquet(path / "data" / "chunk-000" / f"{name}.parquet")
    (path / "meta").mkdir()
    (path / "meta" / "info.json").write_text(json.dumps({**info, **changes}))
    return path


def findings(dataset):
    return {finding["finding"]: finding["count"] for finding in dataset.provenance["findings"]}


@pytest.mark.parametrize("version", [2.0, 2.1, 3.0])
def test_both_layouts_give_the_same_log(version, tmp_path):
    log = lerobot.read(folder(tmp_path / "arm", frames(), version), units={"action": "rad"})
    assert log.format == "lerobot" and log.provenance["files"] == (2 if version == 3.0 else 3)
    assert log.provenance["robot_type"] == "arm" and log.provenance["time_step"] == 0.1
    assert log.observation_names == ("x", "y") and log.action_names == ("left", "right")
    assert log.action_units == ("rad", "rad")
    dataset = Dataset.from_log(log)
    # Episode 1 was not done: its last frame, the seventh of all, has no successor.
    np.testing.assert_array_equal(dataset.observations[:, 0], np.delete(np.arange(12), 6))
    np.testing.assert_array_equal(dataset.rewards, np.delete(np.arange(12) + 0.5, 6))
    np.testing.assert_array_equal(dataset.observations[dataset.terminated, 0], [3, 11])
    after = dataset.next_observations[~dataset.terminated]
    np.testing.assert_array_equal(after, dataset.observations[~dataset.terminated] + np.array([1, 0]))
    assert findings(dataset)["dropped-without-successor"] == 1
    assert "time-gaps" not in findings(dataset) and "uneven-sampling" not in findings(dataset)


def test_what_is_optional(tmp_path):
    table = frames(**{"next.done": None, "timestamp": None})
    log = lerobot.read(folder(tmp_path / "arm", table, 3.0), terminated=None, infos=["task_index"])
    assert "terminated" not in log.columns and set(log.infos) == {"task_index"}
    assert lerobot.read(tmp_path / "arm").provenance["columns"]["time"] == "frame_index"
    with pytest.raises(DatasetError, match="column 'next.success' not found"):
        lerobot.read(tmp_path / "arm", terminated="next.success")


def test_no_reward_needs_a_choice(tmp_path):
    path = folder(tmp_path / "arm", frames(**{"next.reward": None}), 3.0)
    with pytest.raises(DatasetError, match=r"pass reward=0\.0 for cloning, or name another"):
        lerobot.read(path)
    assert not Dataset.from_log(lerobot.read(path, reward=0.0)).rewards.any()
    np.testing.assert_array_equal(lerobot.read(path, reward="index").columns["rewards"][:, 0], np.arange(12))


def test_time_stamps_at_another_rate_than_promised_name_both_and_the_way_out(tmp_path):
    path = folder(tmp_path / "arm", frames(), 3.0, fps=30)
    with pytest.raises(DatasetError, match=r"is 30, .*0\.1 apart.*pass time_step=0\.1 ") as caught:
        readers.read(path)
    assert 'time="frame_index"' in str(caught.value) and "next_observations" not in str(caught.value)
    assert readers.read(path, time_step=0.1).provenance["time_step"] == 0.1
    counted = readers.read(path, time="frame_index")
    assert counted.provenance["time_step"] == 1.0 and not counted.findings
    with pytest.raises(DatasetError, match="fps in meta/info.json is 5, .*10 a second"):
        readers.read(folder(tmp_path / "slow", frames(), 2.1, fps=5))


def test_single_precision_is_too_coarse_for_the_time_of_day(tmp_path):
    stamps = (np.arange(12) / 10 + 1.7e9).astype(np.float32)
    with pytest.raises(DatasetError, match=r'told apart only if 128 lie between them.*pass time="frame_index"'):
        readers.read(folder(tmp_path / "arm", frames(timestamp=stamps), 3.0))
    path = folder(tmp_path / "uncounted", frames(timestamp=stamps, frame_index=None), 3.0)
    with pytest.raises(DatasetError, match="; store the times in double precision"):
        readers.read(path)
    exact = np.arange(12) / 10 + 1.7e9
    assert len(readers.read(folder(tmp_path / "exact", frames(timestamp=exact), 3.0))) == 12


def test_an_episode_that_lies_in_two_files_names_both_and_one_that_goes_on_is_read(tmp_path):
    path = folder(tmp_path / "arm", frames(), 3.0)
    chunk = path / "data" / "chunk-000"
    (chunk / "file-002.parquet").write_bytes((chunk / "file-000.parquet").read_bytes())
    with pytest.raises(DatasetError, match=r"episode 0 lies in file-000.parquet and again in file-002.parquet; remove"):
        readers.read(path)
    table = frames()
    table[:6].write_parquet(chunk / "file-000.parquet")
    table[6:].write_parquet(chunk / "file-001.parquet")
    (chunk / "file-002.parquet").unlink()
    assert Dataset.from_log(readers.read(path)).num_episodes == 3


@pytest.mark.parametrize(
    "changes",
    [
        {"timestamp": np.zeros(12)},
        {"timestamp": -np.arange(12) / 10},
        {"episode_index": np.tile([0, 1], 6)},
        {"next.reward": None},
        {"action": np.full((12, 1), np.nan)},
    ],
)
@pytest.mark.parametrize("version", [2.1, 3.0])
def test_refusals_name_no_option_that_the_layout_lacks(changes, version, tmp_path):
    with pytest.raises(DatasetError) as caught:
        Dataset.from_log(readers.read(folder(tmp_path / "arm", frames(**changes), version)))
    assert set(OPTION.findall(str(caught.value))) <= set(inspect.signature(lerobot.read).parameters)


def test_a_flag_that_only_marks_every_end_is_doubted(tmp_path):
    done = np.isin(np.arange(12), [3, 6, 11])
    log = lerobot.read(folder(tmp_path / "arm", frames(**{"next.done": done}), 2.1))
    assert findings(Dataset.from_log(log))["done-at-every-end"] == 3


def test_a_missing_file_is_told_from_the_count_and_a_gap_from_the_clock(tmp_path):
    path = folder(tmp_path / "arm", frames(), 2.1)
    (path / "data" / "chunk-000" / "episode_000001.parquet").unlink()
    found = findings(Dataset.from_log(lerobot.read(path)))
    assert found["frames-missing"] == 3 and "time-gaps" not in found
    table = frames().filter(pl.col("index") != 9)
    log = lerobot.read(folder(tmp_path / "gap", table, 2.1))
    assert findings(Dataset.from_log(log))["time-gaps"] == 1
    with pytest.raises(DatasetError, match="rows are missing after row 8"):
        lerobot.read(tmp_path / "gap", on_gap="error")


def test_names_that_two_columns_share_are_told_apart(tmp_path):
    table = frames(**{"observation.goal": np.zeros((12, 2), np.float32)})
    feature = {"names": ["x", "y"]}
    features = {"observation.state": feature, "observation.goal": feature, "action": {"names": [["a"], "b"]}}
    path = folder(tmp_path / "arm", table, 3.0, features=features)
    log = lerobot.read(path, observations=["observation.state", "observation.goal"], action_bounds={"action": (-1, 1)})
    assert log.observation_names == tuple(f"observation.{part}.{axis}" for part in ("state", "goal") for axis in "xy")
    assert log.action_names == ("action_0", "action_1")
    assert Dataset.from_log(log).action_high.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"codebase_version": "v1.6"}, "codebase_version is 'v1.6'; this reads versions 2 and 3"),
        ({"fps": 0}, "fps is 0; it must be the number of frames a second"),
        ({"fps": None}, "fps is None"),
        ({"features": []}, "does not describe the 'features'"),
    ],
)
def test_an_odd_description_is_refused(changes, message, tmp_path):
    with pytest.raises(DatasetError, match=message):
        lerobot.read(folder(tmp_path / "arm", frames(), 3.0, **changes))


def test_other_folders_and_damaged_files_are_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"no meta/info.json can be read"):
        lerobot.read(tmp_path)
    path = folder(tmp_path / "arm", frames(), 3.0)
    with pytest.raises(DatasetError, match=r"column 'observation.images.top' not found"):
        lerobot.read(path, observations=["observation.images.top"])
    file = path / "data" / "chunk-000" / "file-001.parquet"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DatasetError, match=r"file-001.parquet: is no complete Parquet file"):
        lerobot.read(path)
    frames()[7:].drop("action").write_parquet(file)
    with pytest.raises(DatasetError, match=r"file-001.parquet: column 'action' not found"):
        lerobot.read(path)
    frames()[7:].with_columns(action=pl.lit("left")).write_parquet(file)
    with pytest.raises(DatasetError, match=r"arm: files whose columns differ in type cannot be read"):
        lerobot.read(path)
    (path / "meta" / "info.json").write_text("{")
    with pytest.raises(DatasetError, match=r"info.json: is not JSON"):
        lerobot.read(path)
    for each in path.glob("data/*/*"):
        each.unlink()
    (path / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 10, "features": {}}))
    with pytest.raises(DatasetError, match=r"holds no data/chunk-\*"):
        lerobot.read(path)
