"""Mixtures of two data sets: which rows they take, and that nothing is torn where the parts meet."""

import dataclasses

import h5py
import numpy as np
import pytest

from odaf.data import Dataset, convert
from odaf.data.checks import open_log
from odaf.data.mixing import first_rows, mix, mix_per_batch
from odaf.data.mixture import Mixture
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
    assert [part["sha256"] for part in mixture["parts"]] == [expert.file_fingerprint(), other.file_fingerprint()]
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


def test_per_batch_keeps_all_rows_and_says_how_to_draw_them():
    expert, other = walk(1), walk(2, episodes=4)
    mixed = mix_per_batch(expert, other, 0.9)
    assert mixed.mixture == Mixture(border=100, ratio=0.9)
    assert (len(mixed), mixed.num_episodes) == (140, 14)
    for name in ("observations", "actions", "rewards", "next_observations", "terminated", "truncated"):
        np.testing.assert_array_equal(
            getattr(mixed, name), np.concatenate([getattr(expert, name), getattr(other, name)])
        )
    assert mixed.provenance["mixture"]["construction"] == "per-batch"
    assert mixed.environment == expert.environment
    assert mix(expert, other, 0.5, transitions=40).mixture is None


def test_the_mixture_is_stored_and_part_of_the_fingerprint(tmp_path):
    mixed = mix_per_batch(walk(1), walk(2), 0.9)
    mixed.save(tmp_path / "mixed.h5")
    read = Dataset.load(tmp_path / "mixed.h5")
    assert read.mixture == mixed.mixture
    assert read.fingerprint() == mixed.fingerprint()
    assert read.summary()["mixture"] == {"border": 100, "ratio": 0.9}
    plain, other = (dataclasses.replace(mixed, mixture=mixture) for mixture in (None, Mixture(100, 0.8)))
    assert len({data.fingerprint() for data in (mixed, plain, other)}) == 3
    assert "mixture" not in plain.summary()
    assert Dataset.from_log(open_log(tmp_path / "mixed.h5")).mixture == mixed.mixture


def test_only_a_file_with_a_mixture_needs_the_newer_format(tmp_path):
    mixed = mix_per_batch(walk(1), walk(2), 0.9)
    for data, version in ((mixed, 2), (dataclasses.replace(mixed, mixture=None), 1)):
        data.save(tmp_path / "data.h5")
        with h5py.File(tmp_path / "data.h5") as file:
            assert file.attrs["version"] == version


def test_a_split_keeps_both_parts_apart():
    mixed = mix_per_batch(walk(1), walk(2), 0.9)
    train, holdout = mixed.split(0.25, seed=0)
    assert len(train) + len(holdout) == 200
    for part in (train, holdout):
        assert part.mixture is not None and part.mixture.ratio == 0.9
        border = part.mixture.border
        assert (part.observations[:border, 0] < 150).all()  # the walks of the two seeds begin near 100 and 200
        assert (part.observations[border:, 0] > 150).all()


@pytest.mark.parametrize(
    ("chosen", "fact"), [([0, 1], "only of one part"), ([12], "only of"), ([3, 12, 4], "in order")]
)
def test_episodes_that_make_no_mixture(chosen, fact):
    with pytest.raises(DatasetError, match=f"mixed from two parts.*{fact}.*before the parts are mixed"):
        mix_per_batch(walk(1), walk(2), 0.9).select(chosen)


def test_what_a_mixture_cannot_become(tmp_path):
    mixed = mix_per_batch(walk(1), walk(2), 0.9)
    for write in (convert.to_d4rl, convert.to_minari):
        with pytest.raises(DatasetError, match="layout cannot say"):
            write(mixed, tmp_path / "other")
        assert not (tmp_path / "other").exists()
    for again in (mix, mix_per_batch):
        with pytest.raises(DatasetError, match="mix: the data are a mixture themselves"):
            again(mixed, walk(2), 0.5)
    with pytest.raises(DatasetError, match="first_rows: the data are a mixture"):
        first_rows(mixed, 20)


@pytest.mark.parametrize("border", [0, 5, 140, -100])
def test_a_border_inside_an_episode(border):
    with pytest.raises(DatasetError, match="no second part begins in row"):
        dataclasses.replace(mix_per_batch(walk(1), walk(2, episodes=4), 0.9), mixture=Mixture(border, 0.5))


def test_a_per_batch_ratio_that_is_none():
    with pytest.raises(DatasetError, match="ratio is 1.0; give the share"):
        mix_per_batch(walk(1), walk(2), 1.0)
