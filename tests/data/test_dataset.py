"""Episodes, ends and findings of `Dataset.from_arrays`; its error messages; summary, selection and split."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odaf.data import Dataset, Spec
from odaf.errors import DatasetError


def five_rows(**changes):
    """Columns of an episode of three rows that terminates and one of two that is cut; observations count the rows."""
    columns = {
        "observations": np.arange(10.0).reshape(5, 2),
        "actions": np.array([[0.0], [0.5], [-0.5], [1.0], [-1.0]]),
        "rewards": np.array([1.0, 2.0, 3.0, 10.0, 20.0]),
        "next_observations": np.arange(10.0).reshape(5, 2) + 2.0,
        "terminated": np.array([False, False, True, False, False]),
        "truncated": np.array([False, False, False, False, True]),
        "action_bounds": (-1.0, 1.0),
    }
    return {**columns, **changes}


def findings(dataset):
    return {finding["finding"]: finding["count"] for finding in dataset.provenance["findings"]}


def test_columns_episodes_and_types():
    dataset = Dataset.from_arrays(**five_rows())
    assert len(dataset) == 5 and dataset.obs_dim == 2 and dataset.act_dim == 1 and dataset.num_episodes == 2
    np.testing.assert_array_equal(dataset.episode_starts, [0, 3])
    np.testing.assert_array_equal(dataset.episode_lengths(), [3, 2])
    np.testing.assert_array_equal(dataset.episode_returns(), [6.0, 30.0])
    assert dataset.episode(0) == slice(0, 3) and dataset.episode(1) == slice(3, 5) == dataset.episode(-1)
    assert dataset.observations.dtype == dataset.actions.dtype == dataset.rewards.dtype == np.float32
    assert dataset.terminated.dtype == dataset.truncated.dtype == bool and dataset.episode_starts.dtype == np.int64
    assert dataset.observation_names == ("observation_0", "observation_1") and dataset.action_names == ("action_0",)
    assert findings(dataset) == {}
    with pytest.raises(IndexError, match="episode 2 of 2"):
        dataset.episode(2)


def test_spec_and_summary_by_hand():
    dataset = Dataset.from_arrays(**five_rows(action_bounds=([-2.0], [3.0])))
    spec = dataset.spec()
    assert spec == Spec(2, 1, (-2.0,), (3.0,), 1.0, 20.0, True, 3)
    assert Spec.from_dict(json.loads(json.dumps(spec.to_dict()))) == spec
    assert hash(spec) == hash(Spec.from_dict(spec.to_dict()))
    summary = json.loads(json.dumps(dataset.summary()))
    expected = {"transitions": 5, "episodes": 2, "mean_return": 18.0, "std_return": 12.0, "best_return": 30.0}
    expected |= {"worst_return": 6.0, "mean_length": 2.5, "terminal_share": 0.5, "action_low": [-2.0]}
    assert {key: summary[key] for key in expected} == expected


def test_the_best_logged_episode_is_not_the_shortest_fragment():
    """Every step costs 1, more or less: what was cut after three steps has the highest return and says nothing."""
    lengths = [10, 3, 12, 10, 4]
    rewards = np.concatenate([np.full(length, -1.0 - 0.1 * index) for index, length in enumerate(lengths)])
    ends = np.cumsum(lengths) - 1
    terminated = np.isin(np.arange(39), ends[-1])  # the last one reached its goal: short because it is good
    arrays = {"observations": np.zeros((39, 1)), "actions": np.zeros((39, 1)), "rewards": rewards}
    given = {"next_observations": np.zeros((39, 1)), "terminated": terminated, "action_bounds": (-1, 1)}
    dataset = Dataset.from_arrays(**arrays, **given, episode=np.repeat(np.arange(5), lengths))
    summary = dataset.summary()
    expected = {"best_return": -5.6, "worst_return": -14.4, "fragments": 1, "best_mean_reward": -1.0}
    expected |= {"worst_mean_reward": -1.4, "mean_reward": rewards.mean()}
    assert {key: summary[key] for key in expected} == pytest.approx(expected)
    (finding,) = [entry for entry in dataset.check().findings if entry.check == "returns-by-length"]
    assert finding.rows == (10,)
    assert "-3.3, is that of a fragment: 3 rows" in finding.message


def test_shift_inside_episodes_drops_only_rows_without_successor():
    dataset = Dataset.from_arrays(**five_rows(next_observations=None))
    # Row 2 terminated: kept, its own observation stands in. Row 4 was cut: nobody saw what followed.
    np.testing.assert_array_equal(dataset.observations[:, 0], [0.0, 2.0, 4.0, 6.0])
    np.testing.assert_array_equal(dataset.next_observations[:, 0], [2.0, 4.0, 4.0, 8.0])
    np.testing.assert_array_equal(dataset.terminated, [False, False, True, False])
    np.testing.assert_array_equal(dataset.truncated, [False, False, False, True])
    assert findings(dataset) == {"terminal-successor-unknown": 1, "dropped-without-successor": 1}


def test_shift_drops_an_episode_of_one_cut_row():
    dataset = Dataset.from_arrays(
        np.arange(4.0)[:, None],
        np.zeros((4, 1)),
        np.arange(4.0),
        episode=["a", "b", "b", "b"],
        terminated=[False, False, False, True],
        action_bounds=(-1, 1),
    )
    np.testing.assert_array_equal(dataset.observations[:, 0], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(dataset.episode_starts, [0])
    assert findings(dataset)["dropped-without-successor"] == 1


def test_unfinished_last_episode_is_truncated():
    dataset = Dataset.from_arrays(**five_rows(truncated=np.zeros(5, bool)))
    assert dataset.truncated[-1] and dataset.num_episodes == 2
    assert findings(dataset) == {"unfinished-episodes": 1}


def test_both_ends_in_one_row_count_as_terminated():
    dataset = Dataset.from_arrays(**five_rows(truncated=np.array([False, False, True, False, True])))
    np.testing.assert_array_equal(dataset.truncated, [False, False, False, False, True])
    assert findings(dataset) == {"terminated-and-truncated": 1}


def test_successor_that_is_not_the_next_row_is_kept_and_reported():
    logged = five_rows()["next_observations"]
    logged[0] = 99.0
    dataset = Dataset.from_arrays(**five_rows(next_observations=logged))
    assert dataset.next_observations[0, 0] == 99.0
    assert findings(dataset) == {"successor-differs-from-next-row": 1}


def test_bounds_from_data_and_by_name():
    dataset = Dataset.from_arrays(**five_rows(action_bounds=None))
    np.testing.assert_array_equal([dataset.action_low, dataset.action_high], [[-1.0], [1.0]])
    assert findings(dataset) == {"action-bounds-from-data": 1}
    named = Dataset.from_arrays(**five_rows(action_bounds={"valve": (-3.0, 4.0)}, action_names=["valve"]))
    np.testing.assert_array_equal([named.action_low, named.action_high], [[-3.0], [4.0]])


def test_actions_off_by_rounding_are_clipped_and_counted():
    dataset = Dataset.from_arrays(**five_rows(action_bounds=(-1.0, 0.9995)))
    assert dataset.actions[3, 0] == np.float32(0.9995)
    assert findings(dataset) == {"actions-clipped": 1}


def test_arrays_are_copies_and_read_only():
    columns = five_rows()
    before = {name: np.array(value) for name, value in columns.items()}
    dataset = Dataset.from_arrays(**columns)
    for field in dataclasses.fields(dataset):
        value = getattr(dataset, field.name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[0] = 0
    for name, value in columns.items():
        np.testing.assert_array_equal(value, before[name])
        assert not isinstance(value, np.ndarray) or value.flags.writeable
    columns["observations"][0, 0] = 77.0
    assert dataset.observations[0, 0] == 0.0


def test_a_column_vector_is_accepted_for_one_value_per_row():
    tall = Dataset.from_arrays(**five_rows(rewards=np.array([[1], [2], [3], [10], [20]]), terminated=[[0]] * 5))
    np.testing.assert_array_equal(tall.rewards, [1.0, 2.0, 3.0, 10.0, 20.0])


NAN_REWARDS = np.array([1.0, np.nan, 3.0, np.inf, 20.0])

WRONG = {
    "strings": ({"actions": [["a"]] * 5}, "'actions' holds <U1 values, not real numbers; convert"),
    "objects": ({"rewards": np.array([1, "2", 3, 4, 5], object)}, "'rewards' holds object values"),
    "ragged": ({"observations": [[1.0], [1.0, 2.0]]}, "'observations' is not a rectangular array"),
    "flat": (
        {"actions": np.zeros(5)},
        r"'actions' must be \[rows, dimensions\], got shape \(5,\); pass actions\[:, None",
    ),
    "images": ({"observations": np.zeros((5, 2, 2))}, r"'observations' must be .* \(5, 2, 2\); flatten each row"),
    "no columns": ({"actions": np.zeros((5, 0))}, "'actions' has no columns"),
    "wide rewards": ({"rewards": np.zeros((5, 2))}, r"'rewards' must be \[rows\], one value per step"),
    "short": ({"rewards": np.zeros(4)}, "'rewards' has 4 rows, 'observations' has 5; every field needs one entry"),
    "no rows": (
        {name: np.zeros((0, 2)) for name in ("observations", "next_observations", "actions")}
        | {name: np.zeros(0) for name in ("rewards", "terminated", "truncated")},
        "there are no rows",
    ),
    "nan": ({"rewards": NAN_REWARDS}, "'rewards' holds NaN or infinity in 2 of 5 rows, the first of them 1, 3; repair"),
    "nan cell": (
        {"observations": np.where(np.arange(10).reshape(5, 2) == 7, np.nan, 0.0)},
        r"'observations' holds NaN or infinity in row 3 of 5 \(columns \[1\]\)",
    ),
    "too large": (
        {"rewards": [1.0, 1e300, 3.0, 4.0, 5.0]},
        "'rewards' is too large for single precision in row 1 of 5",
    ),
    "next width": ({"next_observations": np.zeros((5, 3))}, "'next_observations' has 3 columns, 'observations' has 2"),
    "odd flag": ({"terminated": [0, 0, 2, 0, 1]}, "'terminated' must hold only true and false.*row 2 of 5: "),
    "beyond": (
        {"actions": np.array([[0.0], [0.5], [-0.5], [1.5], [-1.0]])},
        r"'actions' leaves its bounds in row 3 of 5: column 0 is 1.5 in row 3, allowed \[-1.0, 1.0\]; pass the true",
    ),
    "no range": ({"actions": np.ones((5, 1)), "action_bounds": None}, "'action_0' .* never changes"),
    "upside down": ({"action_bounds": (1.0, -1.0)}, "'action_0' .* give .low, high. with low below high"),
    "three bounds": ({"action_bounds": (1, 2, 3)}, r"action_bounds must be \(low, high\)"),
    "bounds of whom": ({"action_bounds": {"valve": (0, 1)}}, r"missing \['action_0'\], unknown \['valve'\]"),
    "same names": ({"observation_names": ["x", "x"]}, "observation_names must be 2 different names"),
    "name count": ({"action_names": ["a", "b"]}, "action_names must be 1 different names"),
    "no flags": ({"terminated": None, "truncated": None}, "no end of an episode was given.*pass terminated="),
    "no ends": ({"terminated": np.zeros(5), "truncated": None}, "no row is marked in 'terminated' or 'truncated'"),
    "id again": ({"episode": [7, 7, 7, 8, 7]}, "id 7 appears in 2 separate blocks, which start in rows 0, 4; sort"),
    "id shape": ({"episode": [7]}, "'episode' must be .rows., one id per step"),
    "end inside id": ({"episode": [7, 7, 7, 7, 7]}, "'terminated' marks an end inside an episode id, row 2 of 5"),
    "provenance": ({"provenance": {"when": np.zeros(2)}}, "provenance must consist of JSON types"),
    "no successors": (
        {"next_observations": None, "terminated": None, "truncated": None, "episode": [1, 2, 3, 4, 5]},
        "every episode is one row long",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_input_names_source_field_rows_and_remedy(name):
    changes, message = WRONG[name]
    with pytest.raises(DatasetError, match=f"^pump.csv: .*{message}"):
        Dataset.from_arrays(**five_rows(**changes), source="pump.csv")


# What is wrong with which row of five, and how a spreadsheet counts that row.
NUMBERED = {
    "nan": ({"rewards": NAN_REWARDS}, "'rewards' holds NaN or infinity in 2 of 5 rows, the first of them 3, 5; repair"),
    "too large": ({"rewards": [1.0, 1e300, 3.0, 4.0, 5.0]}, "'rewards' is too large for single precision in row 3;"),
    "odd flag": ({"terminated": [0, 0, 2, 0, 1]}, "'terminated' must hold only true and false.*row 4: "),
    "beyond": (
        {"actions": np.array([[0.0], [0.5], [-0.5], [1.5], [-1.0]])},
        "'actions' leaves its bounds in row 5: column 0 is 1.5 in row 5, allowed",
    ),
    "id again": ({"episode": [7, 7, 7, 8, 7]}, "id 7 appears in 2 separate blocks, which start in rows 2, 6; sort"),
    "end inside id": ({"episode": [7, 7, 7, 7, 7]}, "'terminated' marks an end inside an episode id, row 4;"),
    # A column of another length is no part of the numbered rows, and is counted from 0.
    "longer": ({"rewards": np.full(7, np.nan)}, "NaN or infinity in 7 of 7 rows, the first of them 0, 1, 2, 3, 4;"),
    "numbers": ({"row_numbers": range(4)}, "row_numbers names 4 rows, there are 5"),
}


@pytest.mark.parametrize("name", NUMBERED)
def test_messages_number_rows_as_the_source_does(name):
    changes, message = NUMBERED[name]
    with pytest.raises(DatasetError, match=message):
        Dataset.from_arrays(**{**five_rows(), "row_numbers": range(2, 7), **changes})


def test_findings_number_rows_as_the_source_does():
    found = {}
    for changes in (
        {"next_observations": None},
        {"truncated": np.zeros(5, bool)},
        {"truncated": np.array([False, False, True, False, True])},
        {"next_observations": np.zeros((5, 2))},
        {"action_bounds": (-1.0, 0.9995)},
    ):
        dataset = Dataset.from_arrays(**five_rows(**changes), row_numbers=np.array([40, 50, 60, 70, 80]))
        found |= {entry["finding"]: entry["message"].rpartition("row")[2] for entry in dataset.provenance["findings"]}
    assert found == {
        "terminal-successor-unknown": " 60",
        "dropped-without-successor": " 80",
        "unfinished-episodes": " 80",
        "terminated-and-truncated": " 60",
        "successor-differs-from-next-row": "s, the first of them 40, 50, 70",
        "actions-clipped": " 70",
    }


INCONSISTENT = {
    "not from zero": ({"episode_starts": np.array([1, 3])}, "'episode_starts' begins with 1"),
    "falling": ({"episode_starts": np.array([0, 3, 3])}, "'episode_starts' must ascend"),
    "too far": ({"episode_starts": np.array([0, 3, 5])}, "'episode_starts' names row 5, there are only 5 rows"),
    "fractions": ({"episode_starts": np.array([0.0, 3.0])}, "'episode_starts' must be .episodes. whole numbers"),
    "end inside": ({"episode_starts": np.array([0])}, "an episode end is marked inside an episode, row 2 of 5"),
    "no end": ({"episode_starts": np.array([0, 1, 3])}, "stops without 'terminated' or 'truncated', row 0 of 5"),
    "two ends": ({"truncated": np.array([0, 0, 1, 0, 1], bool)}, "both terminated and truncated, row 2 of 5"),
    "off by rounding": ({"action_high": np.array([0.9995], np.float32)}, "Dataset.from_arrays, which clips"),
}


@pytest.mark.parametrize("name", INCONSISTENT)
def test_constructor_refuses_columns_that_contradict_each_other(name):
    changes, message = INCONSISTENT[name]
    with pytest.raises(DatasetError, match=message):
        dataclasses.replace(Dataset.from_arrays(**five_rows()), **changes, source="file.h5")


@st.composite
def logs(draw):
    """Episodes as (length, how it ends); rows are numbered so that successors can be told apart."""
    return draw(
        st.lists(
            st.tuples(st.integers(1, 5), st.sampled_from(["terminated", "truncated", "unmarked"])),
            min_size=1,
            max_size=6,
        )
    )


@given(logs(), st.booleans())
def test_no_transition_crosses_an_episode(log, with_successors):
    """Observation = 100 * episode + step, so a successor tells which episode it is from and which step it follows."""
    observations = np.concatenate([100.0 * number + np.arange(length) for number, (length, _) in enumerate(log)])
    last = np.cumsum([length for length, _ in log]) - 1
    ends = {name: np.zeros(len(observations), bool) for name in ("terminated", "truncated")}
    for row, (_, end) in zip(last, log, strict=True):
        if end != "unmarked":
            ends[end][row] = True
    columns = {
        "observations": observations[:, None],
        "actions": np.zeros((len(observations), 1)),
        "rewards": observations,
        "next_observations": observations[:, None] + 1 if with_successors else None,
        "episode": np.repeat(np.arange(len(log)), [length for length, _ in log]),
        "action_bounds": (-1, 1),
        **ends,
    }
    if not with_successors and all(length == 1 and end != "terminated" for length, end in log):
        with pytest.raises(DatasetError, match="one row long"):
            Dataset.from_arrays(**columns)
        return
    dataset = Dataset.from_arrays(**columns)
    same_episode = dataset.next_observations[:, 0] // 100 == dataset.observations[:, 0] // 100
    one_step_on = dataset.next_observations[:, 0] == dataset.observations[:, 0] + 1
    assert same_episode.all()
    assert (one_step_on | dataset.terminated).all()
    # Nothing is lost but the cut rows nobody saw the end of, and these are counted.
    dropped = 0 if with_successors else sum(end != "terminated" for _, end in log)
    assert len(dataset) == len(observations) - dropped
    assert findings(dataset).get("dropped-without-successor", 0) == dropped
    assert dataset.terminated.sum() == sum(end == "terminated" for _, end in log)
    for index in range(dataset.num_episodes):
        rows = dataset.episode(index)
        assert len(set((dataset.observations[rows, 0] // 100).tolist())) == 1
        assert (dataset.terminated ^ dataset.truncated)[rows.stop - 1]


@given(logs().filter(lambda log: len(log) > 1), st.floats(0.05, 0.95), st.integers(0, 5))
def test_split_partitions_whole_episodes(log, holdout, seed):
    lengths = [length for length, _ in log]
    observations = np.concatenate([100.0 * number + np.arange(length) for number, length in enumerate(lengths)])[
        :, None
    ]
    dataset = Dataset.from_arrays(
        observations,
        np.zeros_like(observations),
        observations[:, 0],
        observations + 1,
        episode=np.repeat(np.arange(len(log)), lengths),
        action_bounds=(-1, 1),
    )
    parts = dataset.split(holdout, seed)
    together = np.concatenate([part.observations[:, 0] for part in parts])
    np.testing.assert_array_equal(np.sort(together), dataset.observations[:, 0])
    train, held = ({int(row) // 100 for row in part.observations[:, 0]} for part in parts)
    assert not train & held and len(train | held) == len(log)
    assert len(held) == min(max(round(holdout * len(log)), 1), len(log) - 1) == parts[1].num_episodes
    assert parts[1].fingerprint() == dataset.split(holdout, seed)[1].fingerprint()
    assert [part.provenance["split"]["part"] for part in parts] == ["train", "holdout"]


def test_split_refuses_what_it_cannot_do():
    dataset = Dataset.from_arrays(**five_rows())
    with pytest.raises(DatasetError, match=r"holdout is 1\.0; give a share between 0 and 1"):
        dataset.split(1.0)
    with pytest.raises(DatasetError, match="one episode cannot be split"):
        dataset.select([1]).split()
    with pytest.raises(DatasetError, match="no episode was chosen"):
        dataset.select([])


def test_select_keeps_the_order_asked_for():
    chosen = Dataset.from_arrays(**five_rows()).select([1, 0])
    np.testing.assert_array_equal(chosen.rewards, [10.0, 20.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(chosen.episode_starts, [0, 2])


def test_environment_comes_from_the_provenance():
    known = Dataset.from_arrays(**five_rows(provenance={"environment": {"name": "gymnasium", "id": "Hopper-v5"}}))
    assert known.environment == {"name": "gymnasium", "id": "Hopper-v5"}
    assert Dataset.from_arrays(**five_rows()).environment is None


def test_loading_and_summary_need_no_accelerator_library(tmp_path):
    Dataset.from_arrays(**five_rows()).save(tmp_path / "log.h5")
    program = (
        "import sys, odaf.data\n"
        f"odaf.data.Dataset.load({str(tmp_path / 'log.h5')!r}).summary()\n"
        "assert not {'jax', 'equinox', 'gymnasium'} & set(sys.modules), sorted(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, env={"PYTHONPATH": ":".join(sys.path)})
