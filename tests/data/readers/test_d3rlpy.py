"""d3rlpy's buffer files, written here by their description: version 2.1, tuples, and the flat arrays of version 1."""

import h5py
import numpy as np
import pytest

from odaf.data import Dataset, readers
from odaf.errors import DatasetError


@pytest.fixture
def write(tmp_path):
    def write(tuples=False, without=(), **changes):
        """Three rows that terminate, four that were cut, one that terminates; observations count the rows."""
        with h5py.File(tmp_path / "buffer.h5", "w") as file:
            fields = {"columns": ["observations", "actions", "rewards", "terminated"], "num_episodes": 3}
            fields["version"] = "2.1"
            for number, rows in enumerate((range(3), range(3, 7), range(7, 8))):
                column = np.array(rows, np.float32)[:, None]
                if tuples:
                    fields |= {f"observations_{number}_0": column, f"observations_{number}_1": column * [10, 100]}
                else:
                    fields[f"observations_{number}"] = column * [1, 10]
                fields |= {f"actions_{number}": column / 8, f"rewards_{number}": -column}
                fields[f"terminated_{number}"] = number != 1
            for name, values in {**fields, **changes}.items():
                if name not in without:
                    file[name] = values
        return tmp_path / "buffer.h5"

    return write


def test_cut_episode_loses_its_last_row_and_a_finished_one_does_not(write):
    log = readers.read(write())
    assert len(log) == 8 and not isinstance(log.columns["observations"], np.ndarray)
    dataset = Dataset.from_log(log)
    np.testing.assert_array_equal(dataset.observations, np.array([0, 1, 2, 3, 4, 5, 7])[:, None] * [1, 10])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 2, 4, 5, 6, 7])
    np.testing.assert_array_equal(dataset.rewards, [0, -1, -2, -3, -4, -5, -7])
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [2, 6])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [5])
    assert dataset.provenance["version"] == "2.1"


def test_tuple_observations_are_joined_as_asked(write):
    path = write(tuples=True)
    with pytest.raises(DatasetError, match="each observation is a tuple of 2 arrays; name those to join"):
        Dataset.load(path)
    with pytest.raises(DatasetError, match=r"of which \[2\] was asked for; name .* observations=\[0, 1\]"):
        Dataset.load(path, observations=[2])
    np.testing.assert_array_equal(Dataset.load(path, observations=[1, 0]).observations[4], [40, 400, 4])
    np.testing.assert_array_equal(Dataset.load(path, observations=[0]).observations[4], [4])
    with pytest.raises(DatasetError, match="they are no tuple; leave it out"):
        Dataset.load(write(), observations=[0])


def flat(path, **changes):
    fields = {
        "observations": np.arange(6, dtype=np.float32)[:, None],
        "actions": np.linspace(-1, 1, 6)[:, None],
        "rewards": np.ones(6),
        "terminals": np.array([0, 0, 1, 0, 0, 0], np.float32),
        "episode_terminals": np.array([0, 0, 1, 0, 0, 1], np.float32),
        "discrete_action": False,
        "version": "1.0",
        **changes,
    }
    with h5py.File(path, "w") as file:
        for name, values in fields.items():
            file[name] = values
    return path


def test_flat_arrays_of_version_1(tmp_path):
    dataset = Dataset.load(flat(tmp_path / "v1.h5"))
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 2, 4, 5])
    np.testing.assert_array_equal(dataset.terminated, [False, False, True, False, False])
    with pytest.raises(DatasetError, match="its actions are discrete"):
        Dataset.load(flat(tmp_path / "v1.h5", discrete_action=True))


WRONG = {
    "old": ({"version": "2.0"}, "written in version '2.0' of d3rlpy's file format, expected '2.1'; load it with"),
    "count": ({"num_episodes": 10**15}, "'num_episodes' is 1000000000000000, but 3 episodes were found"),
    "missing": ({"without": ["actions_1"]}, "field 'actions_1' is missing"),
    "flag": ({"terminated_1": 7}, "field 'terminated_1' is 7, expected true or false"),
    "discrete": (
        {f"actions_{number}": np.zeros((rows, 1), np.int64) for number, rows in enumerate((3, 4, 1))},
        "field 'actions' holds int64 values, which d3rlpy writes for discrete actions",
    ),
    "length": ({"rewards_1": np.zeros((3, 1))}, "episode 1: 'rewards' has 3 rows, 'actions' has 4"),
    "width": ({"observations_1": np.zeros((4, 5))}, "field 'observations_1' has rows of shape .5,., 'observations_0'"),
    "empty": (
        {name: np.zeros((0, width)) for name, width in (("observations_2", 2), ("actions_2", 1), ("rewards_2", 1))},
        "episode 2 has no rows",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_file_names_field_and_remedy(write, name):
    changes, message = WRONG[name]
    with pytest.raises(DatasetError, match=f"buffer.h5: .*{message}"):
        Dataset.load(write(**changes))
