"""Data sets that the `minari` package writes itself, in each of its containers, and folders with something amiss."""

import json

import h5py
import numpy as np
import pytest

from odaf.data import Dataset, readers
from odaf.errors import DatasetError

LENGTHS = (3, 5, 2)


@pytest.fixture
def write(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))

    def box(size, bound=np.inf):
        return spaces.Box(-bound, bound, (size,), np.float32)

    def write(container, nested=True):
        """Three episodes; the first terminates. Observations count 100 an episode and 1 a step."""
        buffers = []
        for number, steps in enumerate(LENGTHS):
            count = (100 * number + np.arange(steps + 1, dtype=np.float32))[:, None]
            state = (count * [1, 2]).astype(np.float32)
            observations = {
                "state": state,
                "goal": -count,
                "more": {"tilt": count + 0.5},
                "pair": (count, -count),
            }
            last = np.arange(steps) == steps - 1
            buffers.append(
                EpisodeBuffer(
                    observations=observations if nested else list(state),
                    actions=list(np.full((steps, 2), [0.25, -0.5], np.float32) * (number + 1)),
                    rewards=list(count[:-1, 0]),
                    terminations=list(last & (number == 0)),
                    truncations=list(last & (number != 0)),
                    infos={"qpos": count.astype(np.float64) * [1, 1, 1], "note": ["x"] * (steps + 1)},
                )
            )
        flat = box(2)
        pair = spaces.Tuple((box(1), box(1)))
        deep = spaces.Dict(state=flat, goal=box(1), more=spaces.Dict(tilt=box(1)), pair=pair)
        minari.create_dataset_from_buffers(
            f"tank/{container}-v0",
            buffers,
            env="Pendulum-v1",
            observation_space=deep if nested else flat,
            action_space=box(2, 2.0),
            data_format=container,
            algorithm_name="none",
            author="nobody",
            author_email="nobody@example.org",
            code_permalink="none",
            description="a test",
        )
        return tmp_path / "tank" / f"{container}-v0"

    return write


# What minari warns of concerns its own use, such as environments that have newer versions.
CONTAINERS = pytest.mark.parametrize("container", ["hdf5", "arrow", "parquet"])
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
STEPS = np.concatenate([100 * number + np.arange(steps) for number, steps in enumerate(LENGTHS)])


@CONTAINERS
def test_successors_are_exact_and_no_row_is_lost(write, container):
    path = write(container, nested=False)
    assert readers.detect(path) == "minari"
    dataset = Dataset.load(path)
    np.testing.assert_array_equal(dataset.observations, STEPS[:, None] * [1, 2])
    np.testing.assert_array_equal(dataset.next_observations, (STEPS + 1)[:, None] * [1, 2])
    np.testing.assert_array_equal(dataset.rewards, STEPS)
    np.testing.assert_array_equal(dataset.actions[:, 0], np.repeat([0.25, 0.5, 0.75], LENGTHS))
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [2])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [7, 9])
    np.testing.assert_array_equal(dataset.action_high, [2, 2])
    np.testing.assert_array_equal(dataset.infos["qpos"], np.repeat(STEPS[:, None], 3, axis=1))
    assert dataset.provenance["fields_not_read"] == ["infos/note"]
    pendulum = {"name": "gymnasium", "id": "Pendulum-v1", "kwargs": {}, "max_episode_steps": 200}
    assert dataset.environment == pendulum
    assert json.loads(dataset.provenance["minari"]["env_spec"])["max_episode_steps"] == 200
    assert dataset.provenance["findings"] == []
    assert Dataset.load(path / "data").fingerprint() != ""


@CONTAINERS
def test_entries_of_dictionaries_and_tuples_are_joined_in_the_order_asked_for(write, container):
    path = write(container)
    with pytest.raises(DatasetError, match=r"'observations' has the entries \['goal', 'more/tilt', 'pair/0', 'pair/1'"):
        Dataset.load(path)
    with pytest.raises(DatasetError, match=r"and \['gaol'\] was asked for; name those to join"):
        Dataset.load(path, observations=["gaol"])
    dataset = Dataset.load(path, observations=["goal", "state", "more/tilt", "pair/1"])
    np.testing.assert_array_equal(dataset.observations, STEPS[:, None] * [-1, 1, 2, 1, -1] + [0, 0, 0, 0.5, 0])
    np.testing.assert_array_equal(dataset.next_observations[:, 1], STEPS + 1)
    assert dataset.observation_names == ("goal", "state_0", "state_1", "more.tilt", "pair.1")
    with pytest.raises(DatasetError, match=r"actions=\['x'\] was given, but they have no entries; leave it out"):
        Dataset.load(path, observations=["goal"], actions=["x"])


def test_hdf5_is_read_without_minari_and_in_blocks(write):
    path = write("hdf5", nested=False)
    log = readers.read(path / "data" / "main_data.hdf5")
    assert not any(isinstance(log.columns[name], np.ndarray) for name in ("observations", "actions", "rewards"))
    for rows in (1, 3, 4, 100):
        blocks = [columns for _, columns in log.blocks(rows)]
        np.testing.assert_array_equal(np.concatenate([block["observations"] for block in blocks])[:, 0], STEPS)
        np.testing.assert_array_equal(np.concatenate([block["next_observations"] for block in blocks])[:, 0], STEPS + 1)


def test_episodes_come_by_number_and_may_have_gaps(write):
    path = write("hdf5", nested=False)
    with h5py.File(path / "data" / "main_data.hdf5", "r+") as file:
        file.move("episode_1", "episode_10")
        del file["episode_0"]
    dataset = Dataset.load(path)
    np.testing.assert_array_equal(dataset.rewards, np.concatenate([STEPS[8:], STEPS[3:8]]))
    assert [finding["finding"] for finding in dataset.provenance["findings"]] == ["episodes-missing"]


def change_metadata(path, **changes):
    file = path / "data" / "metadata.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


def test_environment_that_would_import_a_module_is_not_taken_over(write):
    path = write("hdf5", nested=False)
    change_metadata(path, env_spec=json.dumps({"id": "os:Evil-v0", "kwargs": {}}))
    assert Dataset.load(path).environment is None


def test_bounds_come_from_the_data_where_the_space_has_none(write):
    path = write("hdf5", nested=False)
    change_metadata(path, action_space="{}")
    np.testing.assert_array_equal(Dataset.load(path).action_high, [0.75, -0.5])
    np.testing.assert_array_equal(Dataset.load(path, action_bounds=(-3.0, 3.0)).action_high, [3, 3])


SPACES = {
    "discrete": ({"action_space": '{"type": "Discrete", "n": 3}'}, "field 'actions' is of a Discrete space"),
    "images": (
        {"observation_space": '{"type": "Box", "dtype": "uint8", "shape": [8, 8, 3]}'},
        "field 'observations' holds images",
    ),
}


@pytest.mark.parametrize("name", SPACES)
def test_what_is_no_vector_is_refused(write, name):
    changes, message = SPACES[name]
    path = write("hdf5", nested=False)
    change_metadata(path, **changes)
    with pytest.raises(DatasetError, match=message):
        Dataset.load(path)


def replaced(name, values):
    def change(file):
        del file[name]
        file[name] = values

    return change


BROKEN = {
    "no successor": (replaced("episode_1/observations", np.zeros((5, 2))), "'observations' has 5 rows in episode"),
    "short": (replaced("episode_1/actions", np.zeros((4, 2))), "'actions' has 4 rows .* 'rewards' has 5; expected as"),
    "flag": (
        replaced("episode_1/truncations", np.zeros(6, bool)),
        "field 'truncations' has 6 rows in episode number 1",
    ),
    "missing": (lambda file: file.__delitem__("episode_2/rewards"), "field 'episode_2/rewards' is missing"),
    "width": (replaced("episode_1/actions", np.zeros((5, 3))), "field 'episode_1/actions' has rows of shape .3,."),
    "strange": (lambda file: file.move("episode_1", "episode_one"), r"expected one group per episode .*'episode_one'"),
    "text": (replaced("episode_1/rewards", ["a"] * 5), "field 'episode_1/rewards' holds text or objects"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_episode_is_named(write, name):
    change, message = BROKEN[name]
    path = write("hdf5", nested=False)
    with h5py.File(path / "data" / "main_data.hdf5", "r+") as file:
        change(file)
    with pytest.raises(DatasetError, match=message):
        Dataset.load(path)


def rewritten(path, change):
    """Writes an Arrow file again with some of its columns changed by `change(name, column)`."""
    pa = pytest.importorskip("pyarrow")
    from pyarrow import ipc

    with ipc.open_file(path.read_bytes()) as file:
        table = file.read_all()
    columns = {name: change(pa, name, table.column(name).combine_chunks()) for name in table.column_names}
    changed = pa.table(columns)
    with ipc.new_file(path, changed.schema) as file:
        file.write_table(changed)


def hidden(pa, array, row):
    """The array without the value of a row."""
    valid = np.arange(len(array)) != row
    bits = pa.py_buffer(np.packbits(valid, bitorder="little").tobytes())
    children = [array.values] if pa.types.is_fixed_size_list(array.type) else None
    buffers = [bits] if children else [bits, array.buffers()[1]]
    return pa.Array.from_buffers(array.type, len(array), buffers, children=children)


def test_arrow_values_that_are_missing_are_missing(write):
    path = write("arrow", nested=False)
    table = path / "data" / "1" / "part-0.arrow"
    sound = table.read_bytes()
    for field, message in (
        ("rewards", "field 'rewards' holds NaN or infinity in row 5 of 10"),
        ("observations", "field 'observations' holds NaN or infinity in row 5 of 10"),
        ("terminations", "field 'terminations' lacks a value in row 2 of 6, and bool has no NaN"),
    ):
        rewritten(table, lambda pa, name, array, field=field: hidden(pa, array, 2) if name == field else array)
        with pytest.raises(DatasetError, match=message):
            Dataset.load(path)
        table.write_bytes(sound)


def test_whole_numbers_keep_their_digits_or_are_left_out(write):
    path = write("hdf5", nested=False)
    big = 2**60 + np.arange(5)
    with h5py.File(path / "data" / "main_data.hdf5", "r+") as file:
        for number, steps in enumerate(LENGTHS):
            file[f"episode_{number}/infos/stamp"] = 2**60 + np.arange(steps)
            file[f"episode_{number}/infos/mixed"] = np.arange(steps, dtype=np.int64 if number else np.float64)
            file[f"episode_{number}/infos/lit"] = np.arange(steps) == 0
    dataset = Dataset.load(path)
    assert dataset.infos["stamp"].dtype == np.int64 and dataset.infos["lit"].dtype == bool
    np.testing.assert_array_equal(dataset.infos["stamp"][3:8], big)
    assert "mixed" not in dataset.infos and "infos/mixed" in dataset.provenance["fields_not_read"]


def test_episodes_in_both_containers_are_told_apart_by_the_metadata(write):
    path = write("hdf5", nested=False)
    (path / "data" / "0").mkdir()
    assert len(Dataset.load(path)) == 10  # metadata.json says hdf5
    change_metadata(path, data_format=None)
    with pytest.raises(DatasetError, match=r"holds episodes in main_data.hdf5 and in folders .0, .*'data_format'"):
        Dataset.load(path)


def test_arrow_folder_with_a_missing_or_second_table(write):
    path = write("arrow", nested=False)
    table = path / "data" / "1" / "part-0.arrow"
    content = table.read_bytes()
    (table.parent / "part-1.arrow").write_bytes(content)
    with pytest.raises(DatasetError, match="expected one Arrow or Parquet file per episode, found .'part-0.arrow', 'p"):
        Dataset.load(path)
    (table.parent / "part-1.arrow").unlink()
    table.write_bytes(content[:-40])
    with pytest.raises(DatasetError, match="1/part-0.arrow: the file is damaged and cannot be read"):
        Dataset.load(path)
    table.unlink()
    with pytest.raises(DatasetError, match="expected one Arrow or Parquet file per episode, found .."):
        Dataset.load(path)


def test_arrow_without_pyarrow_names_the_extra(write, monkeypatch):
    import sys

    path = write("arrow", nested=False)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(DatasetError, match=r'need pyarrow, which is not installed .*; pip install "odaf\[minari\]"'):
        Dataset.load(path)


def test_a_recording_of_many_goals_is_told_for_one(tmp_path):
    """A robot that walks along a line and back, one metre a step, and one that stands at the goal at first."""
    walks = [[0, 1, 2, 3, 4, 4, 4, 3, 2, 1, 2, 3, 4, 5], [4, 4, 3, 2, 1, 0]]
    (tmp_path / "data").mkdir()
    with h5py.File(tmp_path / "data" / "main_data.hdf5", "w") as file:
        for number, walk in enumerate(walks):
            steps, places = len(walk) - 1, np.array([walk, [7.0] * len(walk)]).T
            group = file.create_group(f"episode_{number}")
            group["observations/achieved_goal"], group["observations/desired_goal"] = places, places + 1.0
            group["observations/observation"] = np.arange(len(walk), dtype=np.float64)[:, None] + 100 * number
            group["actions"], group["rewards"] = np.full((steps, 1), 0.5), np.ones(steps)
            group["terminations"], group["truncations"] = np.zeros(steps, bool), np.arange(steps) == steps - 1
            group["infos/goal"] = places + 1.0
    (tmp_path / "data" / "metadata.json").write_text(json.dumps({"data_format": "hdf5"}))

    def told(goal, entries=("achieved_goal", "observation"), **options):
        return Dataset.load(tmp_path, observations=entries, action_bounds=(-1.0, 1.0), goal=goal, **options)

    dataset = told((4.0, 7.0))
    # The goal's ring has a radius of 0.45, and four of them away, 1.8 m, the robot begins anew.
    assert dataset.observations[:, 2].tolist() == [0, 1, 2, 3, 8, 9, 10, 11, 103, 104]
    assert dataset.observations[:, 0].tolist() == [0, 1, 2, 3, 2, 1, 2, 3, 2, 1]
    assert dataset.next_observations[:, 2].tolist() == [1, 2, 3, 4, 9, 10, 11, 12, 104, 105]
    assert dataset.rewards.tolist() == dataset.terminated.tolist() == [0, 0, 0, 1, 0, 0, 0, 1, 0, 0]
    assert dataset.episode_lengths().tolist() == [4, 4, 2] and np.flatnonzero(dataset.truncated).tolist() == [9]
    assert dataset.infos["goal"][:, 0].tolist() == [1, 2, 3, 4, 3, 2, 3, 4, 3, 2]
    assert dataset.provenance["goal"] == [4.0, 7.0]
    (finding,) = [each for each in dataset.provenance["findings"] if each["finding"] == "rewards-from-goal"]
    assert finding["count"] == 2 and "8 rows that began there are left out" in finding["message"]
    far = told((4.0, 7.0), goal_radius=1.1)
    assert far.episode_lengths().tolist() == [3] and far.terminated.sum() == 1
    for wrong, message in (((4.0,), "give two numbers"), ((4.0, np.nan), "give two numbers")):
        with pytest.raises(DatasetError, match=message):
            told(wrong)
    with pytest.raises(DatasetError, match="no row begins away from it"):
        told((4.0, 7.0), goal_radius=50.0)
    with h5py.File(tmp_path / "data" / "main_data.hdf5", "r+") as file:
        for number in range(2):
            del file[f"episode_{number}/observations/achieved_goal"]
    with pytest.raises(DatasetError, match="needs positions in field 'observations/achieved_goal'"):
        told((4.0, 7.0), ["observation"])
