"""OGBench files as its scripts store them: trajectories with a last row that is there for its observation only."""

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.errors import DatasetError

TERMINALS = np.array([0, 0, 0, 1, 0, 0, 1], np.float32)


@pytest.fixture
def write(tmp_path):
    def write(without=(), **changes):
        rows = len(TERMINALS)
        fields = {
            "observations": np.arange(rows, dtype=np.float32)[:, None] * [1, 10],
            "actions": np.linspace(-1, 1, rows, dtype=np.float32)[:, None],
            "terminals": TERMINALS,
            "qpos": np.arange(rows, dtype=np.float64)[:, None] * [1, 0],
            "qvel": np.zeros((rows, 2)),
            **changes,
        }
        np.savez_compressed(tmp_path / "maze.npz", **{k: v for k, v in fields.items() if k not in without})
        return tmp_path / "maze.npz"

    return write


def test_dates_are_kept_as_whole_numbers_in_their_resolution(write):
    rows = len(TERMINALS)
    when = np.datetime64("2024-02-28T23:59:59", "s") + np.arange(rows)
    took = np.arange(rows).astype("m8[ms]").astype(">m8[ms]")
    gap = when.copy()
    gap[1] = np.datetime64("NaT")
    dataset = Dataset.load(write(when=when, took=took, gap=gap, short=when[1:], words=when.astype(str)), reward="zero")
    assert sorted(dataset.infos) == ["qpos", "qvel", "took", "when"]
    assert dataset.infos["when"].dtype == dataset.infos["took"].dtype == np.int64
    np.testing.assert_array_equal(dataset.infos["when"], 1709164799 + np.array([0, 1, 2, 4, 5]))
    np.testing.assert_array_equal(dataset.infos["took"], [0, 1, 2, 4, 5])
    assert dataset.provenance["fields_not_read"] == ["gap", "short", "words"]


def test_last_stored_row_is_a_successor_only(write):
    dataset = Dataset.load(write(), reward="zero")
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 4, 5])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 3, 5, 6])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [2, 4])
    assert not dataset.terminated.any() and not dataset.rewards.any()
    assert sorted(dataset.infos) == ["qpos", "qvel"]
    np.testing.assert_array_equal(dataset.infos["qpos"][:, 0], [0, 1, 2, 4, 5])
    np.testing.assert_array_equal(dataset.action_low, [-1])
    assert dataset.provenance["format"] == "ogbench"


def test_rewards_must_be_given(write, tmp_path):
    with pytest.raises(DatasetError, match=r"maze.npz: OGBench files hold no rewards; pass goal=.*reward=0\.0"):
        Dataset.load(write())
    rewards = np.arange(7.0)
    np.save(tmp_path / "rewards.npy", rewards)
    for given in (rewards, tmp_path / "rewards.npy", str(tmp_path / "rewards.npy"), rewards[:, None]):
        np.testing.assert_array_equal(Dataset.load(write(), reward=given).rewards, [0, 1, 2, 4, 5])
    with pytest.raises(DatasetError, match="reward has shape .6,.; give one number for each of 7 rows"):
        Dataset.load(write(), reward=rewards[1:])
    hidden = np.ma.masked_array(np.arange(7), np.arange(7) == 4)
    with pytest.raises(DatasetError, match="field 'rewards' holds NaN or infinity in row 4"):
        Dataset.load(write(), reward=hidden)
    assert not Dataset.load(write(), reward=0.0).rewards.any()
    with pytest.raises(DatasetError, match="none.npy: there is no such file"):
        Dataset.load(write(), reward=tmp_path / "none.npy")
    with pytest.raises(DatasetError, match="were both given"):
        Dataset.load(write(), reward="zero", goal=(0.0, 0.0))


def test_reward_of_a_goal_ends_the_task_where_it_is_reached(write):
    """Positions are (row, 0). The goal (2, 0.3) within 1.1 is reached in rows 1, 2 and 3; row 3 is stored last."""
    dataset = Dataset.load(write(), goal=(2.0, 0.3), goal_radius=1.1)
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 4, 5])
    np.testing.assert_array_equal(dataset.rewards, [-1, 0, 0, -1, -1])
    np.testing.assert_array_equal(dataset.terminated, [False, True, True, False, False])
    np.testing.assert_array_equal(dataset.next_observations[[0, 3, 4], 0], [1, 5, 6])
    finding = dataset.provenance["findings"][0]
    assert (finding["finding"], finding["count"]) == ("rewards-from-goal", 3)
    assert not Dataset.load(write(), goal=(90.0, 90.0)).terminated.any()
    with pytest.raises(DatasetError, match="goal= needs positions in field 'qpos'"):
        Dataset.load(write(without=["qpos"]), goal=(0.0, 0.0))
    with pytest.raises(DatasetError, match="goal_radius=-1.0: give two numbers"):
        Dataset.load(write(), goal=(0.0, 0.0), goal_radius=-1.0)


def test_relabelled_file_with_rewards_and_masks(write):
    rewards, masks = np.arange(7.0), np.array([1, 1, 0, 1, 1, 1, 0.0])
    path = write(rewards=rewards, masks=masks)
    dataset = Dataset.load(path)
    np.testing.assert_array_equal(dataset.rewards, [0, 1, 2, 4, 5])
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [2])
    with pytest.raises(DatasetError, match="has its own 'rewards'; leave reward= and goal= out"):
        Dataset.load(path, reward="zero")


def test_stored_successors_make_every_row_a_step(write):
    successors, masks = np.arange(7.0)[:, None] * [1, 10] + 0.5, np.array([1, 1, 1, 0, 1, 1, 1.0])
    dataset = Dataset.load(write(rewards=np.arange(7.0), masks=masks, next_observations=successors))
    np.testing.assert_array_equal(dataset.next_observations, successors)
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [3])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [6])
    with pytest.raises(DatasetError, match="field 'valids' shows OGBench's compact form"):
        Dataset.load(write(rewards=np.arange(7.0), masks=masks, valids=masks))


WRONG = {
    "missing": ({"without": ["terminals"]}, "field 'terminals' is missing; the file has .'actions'"),
    "pixels": ({"observations": np.zeros((7, 8, 8, 3), np.uint8)}, "as images have"),
    "length": ({"actions": np.zeros((6, 1))}, "field 'actions' has shape .6, 1., 'terminals' has 7 rows"),
    "flags": ({"terminals": np.arange(7)}, "field 'terminals' must hold only true and false"),
    "text": ({"observations": np.array([["a"]] * 7)}, "field 'observations' holds <U1 values, not real numbers"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_file_names_field_and_remedy(write, name):
    changes, message = WRONG[name]
    with pytest.raises(DatasetError, match=f"maze.npz: .*{message}"):
        Dataset.load(write(**changes), reward="zero")
