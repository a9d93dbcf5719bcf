"""Mixtures of two data sets: which rows they take, and that nothing is torn where the parts meet."""

import numpy as np
import pytest

from odaf.data import Dataset
from odaf.data.mixing import first_rows, mix
from odaf.errors import DatasetError


def walk(seed: int, episodes: int = 10, steps: int = 10, **changes) -> Dataset:
    """Episodes of a walk; the last observation of each is in no row but as a successor."""
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(episodes, steps + 1, 2)).cumsum(axis=1) + 100 * seed
    rows = episodes * steps
    columns = {
        "observations": states[:, :-1].reshape(rows, 2),
        "actions": rng.uniform(-1, 1, (rows, 1)),
        "rewards": rng.normal(size=rows),
        "next_observations": states[:, 1:].reshape(rows, 2),
        "terminated": np.arange(rows) % (2 * steps) == steps - 1,
        "truncated": np.arange(rows) % (2 * steps) == 2 * steps - 1,
        "action_bounds": (-1.0, 1.0),
        "infos": {"row": np.arange(rows)},
        "provenance": {"environment": {"name": "gymnasium", "id": "Hopper-v4"}, "seed": seed},
    }
    return Dataset.from_arrays(**{**columns, **changes})


@pytest.mark.parametrize("ratio", [0.5, 0.6, 0.7, 0.8, 0.9])
def test_first_rows_of_each_part(ratio: float):
    expert, other = walk(1), walk(2)
    mixed = mix(expert, other, ratio)
    kept = round(100 * (1 - ratio))
    assert len(mixed) == 100
    for name in ("observations", "actions", "rewards", "next_observations", "terminated"):
        left, right = getattr(expert, name)[:kept], getattr(other, name)[: 100 - kept]
        np.testing.assert_array_equal(getattr(mixed, name), np.concatenate([left, right]))
    np.testing.assert_array_equal(mixed.infos["row"], [*range(kept), *range(100 - kept)])


def test_sizes_are_those_of_the_published_mixtures():
    """Rows of the half-cheetah mixtures at 999,000 rows, worked by hand from the share of each part."""
    shares = {0.5: 499_500, 0.6: 399_600, 0.7: 299_700, 0.8: 199_800, 0.9: 99_900}
    long = Dataset.from_arrays(
        np.zeros((999_000, 1)), np.zeros((999_000, 1)), np.zeros(999_000), episode=np.repeat(np.arange(999), 1_000),
        next_observations=np.zeros((999_000, 1)), action_bounds=(-1.0, 1.0),
    )  # fmt: skip
    for ratio in (0.5, 0.9):
        parts = mix(long, long, ratio).provenance["mixture"]["parts"]
        assert [part["rows"] for part in parts] == [shares[ratio], 999_000 - shares[ratio]]


def test_a_part_that_stops_inside_an_episode_keeps_the_logged_successor():
    expert, other = walk(1), walk(2)
    mixed = mix(expert, other, 0.45)  # 55 expert rows: the sixth episode is cut after five steps
    assert mixed.truncated[54]
    assert not mixed.terminated[54]
    np.testing.assert_array_equal(mixed.next_observations[54], expert.observations[55])
    assert mixed.episode_starts.tolist() == [0, 10, 20, 30, 40, 50, 55, 65, 75, 85, 95]
    assert mixed.truncated[99]


def test_a_part_that_stops_at_an_end_keeps_its_flag():
    mixed = mix(walk(1), walk(2), 0.9)
    assert mixed.terminated[9]
    assert not mixed.truncated[9]


def test_where_it_came_from():
    expert, other = walk(1), walk(2)
    mixed = mix(expert, other, 0.7, transitions=50)
    assert len(mixed) == 50
    mixture = mixed.provenance["mixture"]
    assert (mixture["construction"], mixture["ratio"]) == ("static", 0.7)
    assert [part["sha256"] for part in mixture["parts"]] == [expert.fingerprint(), other.fingerprint()]
    assert mixed.environment == expert.environment


def test_columns_that_only_one_part_has_are_left_out_and_counted():
    mixed = mix(walk(1), walk(2, infos={}), 0.5)
    assert mixed.infos == {}
    (finding,) = mixed.provenance["findings"]
    assert (finding["finding"], finding["count"]) == ("infos-dropped", 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action_bounds": (-2.0, 2.0)}, "differ in lowest action: .-1.0. and .-2.0."),
        ({"observation_names": ("a", "b")}, "differ in observation names"),
        ({"observations": np.zeros((100, 3)), "next_observations": np.zeros((100, 3))}, "numbers in an observation"),
    ],
)
def test_data_of_another_task(changes: dict, message: str):
    with pytest.raises(DatasetError, match=message):
        mix(walk(1), walk(2, **changes), 0.5)


@pytest.mark.parametrize("ratio", [0.0, 1.0, -0.2, 7.0])
def test_a_ratio_that_is_none(ratio: float):
    with pytest.raises(DatasetError, match="between 0 and 1"):
        mix(walk(1), walk(2), ratio)


def test_too_few_expert_rows():
    with pytest.raises(DatasetError, match="500 rows are wanted of the expert data, which have 100"):
        mix(walk(1), walk(2), 0.5, transitions=1_000)


def test_first_rows_of_a_dataset():
    part = first_rows(walk(1), 15)
    assert (len(part), part.num_episodes) == (15, 2)
    assert part.truncated[14]
    with pytest.raises(DatasetError, match="101 rows are wanted of 100"):
        first_rows(walk(1), 101)
