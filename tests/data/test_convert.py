"""The layouts of other programs, read back by our own readers and by their own library."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from data.test_mixing import walk
from odaf.data import Dataset, convert
from odaf.errors import DatasetError

COLUMNS = ("observations", "actions", "rewards", "next_observations", "terminated", "truncated")


def assert_same_rows(left: Dataset, right: Dataset) -> None:
    for name in (*COLUMNS, "episode_starts", "action_low", "action_high"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    assert set(left.infos) == set(right.infos)
    for name in left.infos:
        np.testing.assert_array_equal(left.infos[name], right.infos[name])


def test_d4rl_and_back(tmp_path: Path):
    convert.to_d4rl(walk(1), tmp_path / "walk.hdf5")
    assert_same_rows(Dataset.load(tmp_path / "walk.hdf5"), walk(1))
    with h5py.File(tmp_path / "walk.hdf5") as file:
        assert {"observations", "actions", "rewards", "next_observations", "terminals", "timeouts"} <= set(file)
        assert json.loads(file["metadata/odaf"][()])["provenance"]["seed"] == 1  # type: ignore[index]


def test_d4rl_with_other_bounds(tmp_path: Path):
    wide = walk(1, action_bounds=(-3.0, 5.0))
    convert.to_d4rl(wide, tmp_path / "walk.hdf5")
    assert_same_rows(Dataset.load(tmp_path / "walk.hdf5", action_bounds=(-3.0, 5.0)), wide)


def test_d4rl_keeps_successors_that_differ_from_the_next_row(tmp_path: Path):
    odd = walk(1, next_observations=np.full((100, 2), 7.0))
    convert.to_d4rl(odd, tmp_path / "walk.hdf5")
    assert_same_rows(Dataset.load(tmp_path / "walk.hdf5"), odd)
    with pytest.raises(DatasetError, match="90 stored successors differ .* rows 0, 1, 2, 3, 4; .* D4RL"):
        convert.to_minari(odd, tmp_path / "walk")
    assert not (tmp_path / "walk").exists()


def test_minari_and_back(tmp_path: Path):
    convert.to_minari(walk(1, action_bounds=(-3.0, 5.0)), tmp_path / "walk")
    assert_same_rows(Dataset.load(tmp_path / "walk"), walk(1, action_bounds=(-3.0, 5.0)))
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk"]


def test_minari_keeps_the_environment_with_its_limit_settings_and_wrappers(tmp_path: Path):
    own = {
        "name": "gymnasium",
        "id": "Pendulum-v1",
        "kwargs": {"g": 3.0},
        "max_episode_steps": 20,
        "wrappers": [{"name": "RescaleAction", "kwargs": {"min_action": -1.0, "max_action": 1.0}}],
    }
    convert.to_minari(walk(1).with_provenance(environment=own), tmp_path / "walk")
    assert Dataset.load(tmp_path / "walk").environment == own
    plain = {"name": "gymnasium", "id": "Pendulum-v1", "kwargs": {}}
    convert.to_minari(walk(1).with_provenance(environment=plain), tmp_path / "plain")
    assert Dataset.load(tmp_path / "plain").environment == {**plain, "max_episode_steps": 200}
    other = {"name": "gymnasium", "id": "Hopper-v5", "kwargs": {}, "contact_margins": "larger"}
    convert.to_minari(walk(1).with_provenance(environment=other), tmp_path / "other")
    assert Dataset.load(tmp_path / "other").environment is None


def test_minari_itself_reads_the_folder(tmp_path: Path):
    minari = pytest.importorskip("minari")
    original = walk(1)
    convert.to_minari(original, tmp_path / "walk", identity="tank/walk-v3")
    read = minari.MinariDataset(tmp_path / "walk" / "data")
    assert (read.id, read.total_steps, read.total_episodes) == ("tank/walk-v3", 100, 10)
    episodes = list(read.iterate_episodes())
    np.testing.assert_array_equal(np.concatenate([e.rewards for e in episodes]), original.rewards)
    np.testing.assert_array_equal(episodes[3].observations[:-1], original.observations[30:40])
    np.testing.assert_array_equal(episodes[3].observations[-1], original.next_observations[39])
    assert [bool(e.terminations[-1]) for e in episodes] == [True, False] * 5
    assert read.action_space.high.tolist() == [1.0]


def test_what_exists_is_not_overwritten_and_a_missing_place_is_explained(tmp_path: Path):
    (tmp_path / "walk").mkdir()
    with pytest.raises(DatasetError, match="exists already"):
        convert.to_minari(walk(1), tmp_path / "walk")
    with pytest.raises(DatasetError, match="cannot be written"):
        convert.to_d4rl(walk(1), tmp_path / "nowhere" / "walk.hdf5")
