"""Files in the D4RL layout, written here by hand in the variants that exist, and rows compared with D4RL's own rule."""

from typing import Any

import h5py
import numpy as np
import pytest

from odaf.data import Dataset, readers, storage
from odaf.data.dataset import COLUMNS
from odaf.data.readers import d4rl, hdf5
from odaf.errors import DatasetError

ROWS = 12


def columns():
    """Episode one falls in row 4; episode two times out in row 8; the collector stopped after row 11."""
    rng = np.random.default_rng(1)
    observations = np.arange(ROWS, dtype=np.float32)[:, None] * [1, 10]
    return {
        "observations": observations.astype(np.float32),
        "actions": rng.uniform(-1, 1, (ROWS, 3)).astype(np.float32),
        "next_observations": (observations + np.array([0.5, 5])).astype(np.float32),  # not the shifted rows
        "rewards": rng.normal(size=ROWS).astype(np.float32),
        "terminals": np.arange(ROWS) == 4,
        "timeouts": np.arange(ROWS) == 8,
    }


@pytest.fixture
def write(tmp_path):
    def write(without=(), **changes):
        path = tmp_path / "hopper.hdf5"
        with h5py.File(path, "w") as file:
            for name, values in {**columns(), **changes}.items():
                if name not in without:
                    file[name] = values
        return path

    return write


def findings(dataset):
    return {finding["finding"]: finding["count"] for finding in dataset.provenance["findings"]}


def qlearning_rows(data, limit=0):
    """Rows of D4RL's `qlearning_dataset` by its description: (s, a, r, observation of the next row, terminal)."""
    kept, step = [], 0
    for row in range(len(data["rewards"]) - 1):
        final = data["timeouts"][row] if "timeouts" in data else step == limit - 1
        if final:
            step = 0
            continue
        if data["terminals"][row]:
            step = 0
        kept.append(row)
        step += 1
    kept = np.array(kept)
    return {
        "observations": data["observations"][kept],
        "actions": data["actions"][kept],
        "rewards": data["rewards"][kept],
        "next_observations": data["observations"][kept + 1],
        "terminated": data["terminals"][kept],
    }


def assert_columns(dataset, expected):
    for name, values in expected.items():
        np.testing.assert_array_equal(getattr(dataset, name), values, err_msg=name)


def test_stored_successors_are_used_and_no_row_is_lost(write):
    dataset = Dataset.load(write())
    expected = {name: values for name, values in columns().items() if name not in ("terminals", "timeouts")}
    assert_columns(dataset, expected)
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [4])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [8, 11])
    np.testing.assert_array_equal(dataset.episode_starts, [0, 5, 9])
    assert findings(dataset) == {"unfinished-episodes": 1, "successor-differs-from-next-row": 9}
    assert dataset.provenance["format"] == "d4rl" and dataset.provenance["file"] == "hopper.hdf5"
    assert dataset.environment is None
    np.testing.assert_array_equal(dataset.action_low, [-1, -1, -1])


def test_without_successors_the_shift_stays_inside_episodes(write):
    dataset = Dataset.load(write(without=["next_observations"]))
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 3, 4, 5, 6, 7, 9, 10])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 3, 4, 4, 6, 7, 8, 10, 11])
    assert findings(dataset) == {
        "unfinished-episodes": 1,
        "dropped-without-successor": 2,
        "terminal-successor-unknown": 1,
    }


def test_file_without_timeouts_needs_the_time_limit(write):
    path = write(without=["timeouts", "next_observations"])
    with pytest.raises(DatasetError, match=r"hopper.hdf5: field 'timeouts' is missing .*; pass max_episode_steps="):
        Dataset.load(path)
    dataset = Dataset.load(path, max_episode_steps=4)
    # Rows 0-3 time out, row 4 falls at once, rows 5-8 time out, 9-11 are unfinished; each cut loses its last row.
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 4, 5, 6, 7, 9, 10])
    np.testing.assert_array_equal(dataset.episode_starts, [0, 3, 4, 7])
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [3])
    with pytest.raises(DatasetError, match="max_episode_steps=0: give the time limit"):
        Dataset.load(path, max_episode_steps=0)


def test_a_time_limit_reached_by_a_fall_is_a_fall(write):
    dataset = Dataset.load(write(without=["timeouts"]), max_episode_steps=5)
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [4])
    np.testing.assert_array_equal(np.flatnonzero(dataset.truncated), [9, 11])


def test_time_limit_beside_timeouts_is_refused(write):
    with pytest.raises(DatasetError, match="max_episode_steps=1000 was given but the file has its own 'timeouts'"):
        Dataset.load(write(), max_episode_steps=1000)


def test_no_end_marked_anywhere(write):
    path = write(terminals=np.zeros(ROWS, bool), timeouts=np.zeros(ROWS, bool))
    with pytest.raises(DatasetError, match="'timeouts' is missing or marks nothing"):
        Dataset.load(path)
    assert Dataset.load(path, max_episode_steps=4).num_episodes == 3


def test_terminal_and_timed_out_row_counts_as_terminal(write):
    dataset = Dataset.load(write(timeouts=np.isin(np.arange(ROWS), [4, 8])))
    assert dataset.terminated[4] and not dataset.truncated[4]
    assert findings(dataset)["terminated-and-truncated"] == 1


def test_time_limits_stored_as_terminals_are_suspected(write):
    both = np.isin(np.arange(ROWS), [3, 7, 11])
    assert findings(Dataset.load(write(terminals=both, timeouts=both)))["terminals-equal-timeouts"] == 3


def test_double_precision_tall_rewards_and_numeric_flags(write):
    original = columns()
    path = write(
        observations=original["observations"].astype(np.float64),
        rewards=original["rewards"].astype(np.float64)[:, None],
        terminals=original["terminals"].astype(np.float32),
        timeouts=original["timeouts"].astype(np.uint8),
    )
    dataset = Dataset.load(path)
    assert dataset.observations.dtype == np.float32
    assert_columns(dataset, {"observations": original["observations"], "rewards": original["rewards"]})
    np.testing.assert_array_equal(np.flatnonzero(dataset.terminated), [4])


POLICY = {
    "infos/qpos": np.arange(ROWS * 6.0).reshape(ROWS, 6),
    "infos/qvel": np.ones((ROWS, 6), np.float32),
    "infos/action_log_probs": np.zeros(ROWS, np.float32),
    "infos/short": np.zeros(ROWS - 1),
    "metadata/algorithm": np.bytes_("SAC"),
    "metadata/iteration": 1000,
    "metadata/policy/fc0/weight": np.arange(8.0).reshape(4, 2),
    "metadata/policy/fc0/bias": np.zeros(4),
    "metadata/policy/nonlinearity": np.bytes_("relu"),
    "metadata/policy/output_distribution": np.bytes_("tanh_gaussian"),
}


def test_infos_are_kept_and_lose_the_rows_that_the_others_lose(write):
    dataset = Dataset.load(write(**POLICY, without=["next_observations"]))
    assert sorted(dataset.infos) == ["action_log_probs", "qpos", "qvel"]
    np.testing.assert_array_equal(dataset.infos["qpos"], POLICY["infos/qpos"][[0, 1, 2, 3, 4, 5, 6, 7, 9, 10]])
    compatible = Dataset.load(write(**POLICY), d4rl_compat=True)
    np.testing.assert_array_equal(compatible.infos["qpos"], POLICY["infos/qpos"][[0, 1, 2, 3, 4, 5, 6, 7, 9, 10]])


def test_policy_is_described_and_its_arrays_can_be_had(write):
    path = write(**POLICY)
    provenance = Dataset.load(path).provenance
    assert (provenance["algorithm"], provenance["iteration"]) == ("SAC", 1000)
    assert provenance["behaviour_policy"] == {
        "arrays": {"fc0/weight": [4, 2], "fc0/bias": [4]},
        "nonlinearity": "relu",
        "output_distribution": "tanh_gaussian",
    }
    assert provenance["fields_not_read"] == sorted(name for name in POLICY if name[:7] == "infos/s" or name[0] == "m")
    arrays = d4rl.behaviour_policy(path)
    assert sorted(arrays) == ["fc0/bias", "fc0/weight"]
    np.testing.assert_array_equal(arrays["fc0/weight"], POLICY["metadata/policy/fc0/weight"])
    with pytest.raises(DatasetError, match="hopper.hdf5: holds no policy"):
        d4rl.behaviour_policy(write())


@pytest.mark.parametrize("packing", [{}, {"chunks": (5, 2), "compression": "gzip"}])
@pytest.mark.parametrize("rows", [1, 4, 5, ROWS, 100])
def test_log_is_read_in_blocks_from_the_file(write, packing, rows):
    path = write(without=["observations"])
    with h5py.File(path, "r+") as file:
        file.create_dataset("observations", data=columns()["observations"], **packing)
    log = readers.read(path)
    assert not any(isinstance(log.columns[name], np.ndarray) for name in ("observations", "actions", "rewards"))
    firsts, blocks = zip(*log.blocks(rows), strict=True)
    assert list(firsts) == list(range(0, ROWS, rows))
    for name in ("observations", "actions", "rewards", "next_observations"):
        np.testing.assert_array_equal(np.concatenate([block[name] for block in blocks]), columns()[name])
    np.testing.assert_array_equal(np.concatenate([block["episode"] for block in blocks]), [0] * 5 + [1] * 4 + [2] * 3)


def test_array_that_was_never_written_in_full_is_refused(write):
    path = write(without=["rewards", "actions"])
    with h5py.File(path, "r+") as file:
        file.create_dataset("rewards", (ROWS,), "f4")
        file.create_dataset("actions", (ROWS, 3), "f4", chunks=(4, 3))[:5] = 1
    with pytest.raises(DatasetError, match="field 'actions' misses 1 of the 3 pieces"):
        Dataset.load(path)
    with h5py.File(path, "r+") as file:
        del file["actions"]
        file["actions"] = columns()["actions"]
    with pytest.raises(DatasetError, match=r"field 'rewards' has shape \(12,\), 48 bytes, but 0 are there"):
        Dataset.load(path)


def test_links_out_of_the_file_are_not_followed(write, tmp_path):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["policy/weight"] = np.zeros((ROWS, 3))
    path = write(without=["actions"])
    with h5py.File(path, "r+") as file:
        file["metadata"] = h5py.ExternalLink(str(other), "/")
        file["actions"] = h5py.ExternalLink(str(other), "/policy/weight")
    with pytest.raises(DatasetError, match="field 'actions' is a link to another place"):
        Dataset.load(path)
    with pytest.raises(DatasetError, match="holds no policy"):
        d4rl.behaviour_policy(path)


TEXTS = {"short": "relu", "empty": "", "eight": "12345678", "letters": "Füllstand °C", "long": "x" * 5000}


@pytest.mark.parametrize("block", [0, 512])
def test_texts_of_variable_length_are_read_as_the_library_reads_them(tmp_path, block):
    path = tmp_path / "texts.h5"
    with h5py.File(path, "w", userblock_size=block) as file:
        for name, text in TEXTS.items():
            file[name] = text
            file[f"fixed {name}"] = np.bytes_(text.encode() or b" ")
    with storage.opened(path) as (file, source):
        for name, text in TEXTS.items():
            assert hdf5.scalar(file, source, name) == np.asarray(file[name]).item().decode() == text
            assert hdf5.scalar(file, source, f"fixed {name}") == (text or " ")


def test_damaged_heap_of_texts_does_not_hang(write):
    """An object of no size in front of the text, on which the HDF5 library would walk on the spot."""
    path = write(**{"metadata/first": "first", "metadata/algorithm": "SAC"})
    content = path.read_bytes()
    start = content.index(b"GCOL") + 16
    path.write_bytes(content[:start] + bytes(16) + content[start + 16 :])
    with pytest.raises(DatasetError, match="field 'metadata/algorithm' has lost its text; the file is damaged"):
        Dataset.load(path)


def test_flag_bytes_other_than_zero_and_one_are_noticed(write):
    path = write()
    with h5py.File(path) as file:
        place = file["terminals"].id.get_offset() + 3
    content = bytearray(path.read_bytes())
    content[place] = 7
    path.write_bytes(content)
    with pytest.raises(DatasetError, match="field 'terminals' holds flags that are neither true nor false in row 3"):
        Dataset.load(path)


@pytest.mark.parametrize("both_in_row", [4, 6])
def test_compatible_rows_with_timeouts(write, both_in_row):
    """Row 6: a fall at the time limit, which D4RL drops. Row 4 marks the first episode's fall as one too."""
    original = columns()
    original["terminals"][both_in_row] = original["timeouts"][both_in_row] = True
    path = write(**original)
    dataset = Dataset.load(path, d4rl_compat=True)
    assert_columns(dataset, qlearning_rows(original))
    assert len(dataset) == ROWS - 1 - original["timeouts"].sum()
    assert dataset.provenance["d4rl_compat"]


@pytest.mark.parametrize("limit", [2, 3, 4, 5, 11])
def test_compatible_rows_with_a_step_counter(write, limit):
    path = write(without=["timeouts", "next_observations"])
    original = columns()
    del original["timeouts"]
    dataset = Dataset.load(path, d4rl_compat=True, max_episode_steps=limit)
    assert_columns(dataset, qlearning_rows(original, limit))


def test_compatible_rows_by_hand(write):
    dataset = Dataset.load(write(), d4rl_compat=True)
    # Row 8 timed out, row 11 is the last of the file; the fall in row 4 is followed by another episode's row.
    np.testing.assert_array_equal(dataset.observations[:, 0], [0, 1, 2, 3, 4, 5, 6, 7, 9, 10])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [1, 2, 3, 4, 5, 6, 7, 8, 10, 11])
    np.testing.assert_array_equal(dataset.episode_starts, [0, 5, 8])


def test_compatible_rows_are_numbered_as_in_the_file(write):
    """Row 8 timed out and is left out, so row 10 of the file is the tenth that is kept."""
    actions = columns()["actions"]
    actions[10] = 3.0
    with pytest.raises(DatasetError, match="leaves its bounds in row 10: column 0 is 3.0 in row 10"):
        Dataset.load(write(actions=actions), d4rl_compat=True)


def test_nothing_left_in_compatible_mode(write):
    path = write(**{name: values[:1] for name, values in columns().items()}, without=["timeouts"])
    with pytest.raises(DatasetError, match="d4rl_compat= drops all 1 rows"):
        Dataset.load(path, d4rl_compat=True, max_episode_steps=3)


def test_saved_again_in_our_own_format(write, tmp_path):
    dataset = Dataset.load(write())
    dataset.save(tmp_path / "own.h5")
    assert Dataset.load(tmp_path / "own.h5").fingerprint() == dataset.fingerprint()


WRONG = {
    "missing": ({"without": ["rewards"]}, r"field 'rewards' is missing; the file has \['actions', 'next_observations'"),
    "length": ({"actions": np.zeros((11, 3))}, "field 'actions' has 11 rows, 'observations' has 12"),
    "nan": (
        {"observations": np.full((ROWS, 2), np.nan)},
        "field 'observations' holds NaN or infinity in 12 of 12 rows",
    ),
    "beyond": (
        {"actions": np.full((ROWS, 3), 1.5)},
        "field 'actions' leaves its bounds .* pass the true action_bounds",
    ),
    "flag": ({"terminals": np.arange(ROWS)}, "field 'terminals' must hold only true and false"),
    "text": ({"rewards": np.array([b"1"] * ROWS)}, r"field 'rewards' holds \|S1 values"),
    "group": ({"without": ["rewards"], "rewards/x": np.zeros(3)}, "field 'rewards' is a group, expected an array"),
}


def test_an_archive_of_the_same_keys_is_read_alike(write, tmp_path):
    fields = {**columns(), "infos/qpos": np.arange(ROWS) + 2**40, "metadata/algorithm": np.array("SAC")}
    fields |= {"infos/when": np.arange(ROWS).astype("M8[ms]"), "infos/gap": np.full(ROWS, "NaT", "M8[s]")}
    np.savez(tmp_path / "hopper.npz", **fields)
    archive, file = Dataset.load(tmp_path / "hopper.npz"), Dataset.load(write(**{"infos/qpos": fields["infos/qpos"]}))
    for name in (*COLUMNS, "episode_starts"):
        np.testing.assert_array_equal(getattr(archive, name), getattr(file, name))
    assert archive.infos["qpos"].dtype == np.int64 and archive.infos["qpos"][3] == 2**40 + 3
    assert sorted(archive.infos) == ["qpos", "when"] and archive.infos["when"][:4].tolist() == [0, 1, 2, 3]
    assert archive.provenance["fields_not_read"] == ["infos/gap", "metadata/algorithm"]
    assert archive.provenance["algorithm"] == "SAC" and archive.provenance["format"] == "d4rl"
    np.savez(tmp_path / "hopper.npz", **{name: fields[name] for name in fields if name != "rewards"})
    with pytest.raises(DatasetError, match=r"hopper.npz: field 'rewards' is missing; the file has \['actions'"):
        Dataset.load(tmp_path / "hopper.npz")


def test_masks_that_contradict_the_terminals_are_those_of_another_layout(write):
    fell = columns()["terminals"]
    assert Dataset.load(write(masks=~fell)).terminated.sum() == 1
    with pytest.raises(DatasetError, match=r"'masks' says that the task goes on after row 4 of 12, .*two layouts fit"):
        Dataset.load(write(masks=np.ones(ROWS)))


def test_values_that_were_never_written_are_missing(write):
    """NetCDF's libraries write HDF5 files and name in an attribute the number that stands for nothing."""
    path = write(**{"infos/lamp": np.arange(ROWS), "infos/speed": np.where(np.arange(ROWS) == 2, -999.0, 1.0)})
    with h5py.File(path, "r+") as file:
        file["infos/speed"].attrs["missing_value"] = np.array([-999.0])
        file["infos/lamp"].attrs["_FillValue"] = -1
    infos = Dataset.load(path).infos
    np.testing.assert_array_equal(np.isnan(infos["speed"]), np.arange(ROWS) == 2)
    assert infos["lamp"].dtype == np.int64
    for name, message in (
        ("rewards", "field 'rewards' holds NaN or infinity in row 7"),
        ("infos/lamp", "field 'infos/lamp' lacks a value in row 7, where it holds 7, its attribute '_FillValue'"),
        ("terminals", "field 'terminals' lacks a value in 11 of 12 rows, the first of them 0, 1"),
    ):
        path = write(**{"infos/lamp": np.arange(ROWS)})
        with h5py.File(path, "r+") as file:
            file[name].attrs["_FillValue"] = np.asarray(file[name])[7]
        with pytest.raises(DatasetError, match=message):
            Dataset.load(path)


def test_packed_numbers_are_not_taken_for_the_values(write):
    path = write(actions=np.arange(3 * ROWS, dtype=np.int16).reshape(ROWS, 3))
    with h5py.File(path, "r+") as file:
        file["actions"].attrs["scale_factor"] = 0.01
    with pytest.raises(DatasetError, match="'actions' holds packed numbers, .*'scale_factor'.*; unpack them"):
        Dataset.load(path)


def test_flat_arrays_beside_episodes_as_groups(write):
    """Which of the two is meant must be said; the flat arrays alone are then not taken for the whole file."""
    path = write(**{"episode_0/actions": np.zeros((3, 1))})
    with pytest.raises(DatasetError, match="hopper.hdf5: two layouts fit, .* write the one that counts into a file"):
        Dataset.load(path)
    with pytest.raises(DatasetError, match="hopper.hdf5: .*one group per episode .*as Minari writes; give Minari"):
        Dataset.load(path, format="d4rl")


@pytest.mark.parametrize("name", WRONG)
def test_bad_file_names_field_rows_and_remedy(write, name):
    changes, message = WRONG[name]
    with pytest.raises(DatasetError, match=f"hopper.hdf5: .*({message})"):
        Dataset.load(write(**changes))


def test_flags_of_another_length(write):
    with pytest.raises(DatasetError, match="field 'timeouts' has 11 rows, 'terminals' has 12"):
        Dataset.load(write(timeouts=columns()["timeouts"][1:]))
    path = write(rewards=columns()["rewards"][1:])
    choices: list[dict[str, Any]] = [{}, {"d4rl_compat": True}]
    for options in choices:
        with pytest.raises(DatasetError, match="field 'rewards' has 11 rows, '(observations|terminals)' has 12"):
            Dataset.load(path, **options)


def test_options_of_other_layouts_are_refused_with_those_it_takes(write):
    with pytest.raises(
        DatasetError,
        match="hopper.hdf5: option goal= does not apply to D4RL HDF5; it takes max_episode_steps=, action_bounds=, "
        "d4rl_compat=",
    ):
        Dataset.load(write(), goal=(1.0, 2.0))
    with pytest.raises(DatasetError, match="hopper.hdf5: format 'rlds' is unknown; known are d4rl, minari"):
        Dataset.load(write(), format="rlds")
    assert len(Dataset.load(write(), action_bounds=None, max_episode_steps=None)) == ROWS  # None: not given


def test_wider_bounds_can_be_given(write):
    dataset = Dataset.load(write(actions=np.full((ROWS, 3), 1.5)), action_bounds=(-2.0, 2.0))
    np.testing.assert_array_equal(dataset.action_high, [2, 2, 2])


def test_hdf5_without_any_known_field(tmp_path):
    with h5py.File(tmp_path / "weights.h5", "w") as file:
        file["kernel"] = np.zeros(3)
    with pytest.raises(DatasetError, match=r"neither an odaf dataset .* nor in the D4RL layout .*\['kernel'\]"):
        Dataset.load(tmp_path / "weights.h5")
