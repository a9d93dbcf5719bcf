"""Missing values are missing in every way into memory, and no number is changed in silence."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset, convert, readers
from odaf.data.mixing import mix
from odaf.errors import DatasetError

ROWS, HOLE = 40, 17


class NAType:
    """As pandas' NA: it is equal to nothing, and has no truth value."""

    def __eq__(self, other: object) -> Any:
        return self

    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        raise TypeError("boolean value of NA is ambiguous")


class Nullable:
    """As pandas' series of a nullable type: an array of objects, and a mask."""

    def __init__(self, values: np.ndarray, missing: np.ndarray):
        self._values, self._missing = values.astype(object), missing
        self._values[missing] = NAType()

    def isna(self) -> np.ndarray:
        return self._missing

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._values

    def __len__(self) -> int:
        return len(self._values)


def _objects(values: np.ndarray, missing: np.ndarray) -> np.ndarray:
    result = values.astype(object)
    result[missing] = None
    return result


# Ways to say that an entry of a column has no value; the number behind it is -999, or 1 in a flag.
WAYS: dict[str, Callable[[np.ndarray, np.ndarray], Any]] = {
    "masked": np.ma.masked_array,
    "list of masked": lambda values, missing: list(np.ma.masked_array(values, missing)),
    "None": _objects,
    "nested lists": lambda values, missing: _objects(values, missing).tolist(),
    "pandas": Nullable,
    "polars": lambda values, missing: pl.Series(values).zip_with(pl.Series(~missing), pl.Series([None], dtype=pl.Null)),
    "polars frame": lambda values, missing: pl.DataFrame(
        {str(index): _objects(part, missing[:, index]).tolist() for index, part in enumerate(values.T)}
    ),
    "NaN": lambda values, missing: np.where(missing, np.nan, values.astype(float)),
}
COLUMNS = {"observations": 2, "actions": 1, "next_observations": 2, "rewards": 0, "terminated": 0, "truncated": 0}


def columns() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "observations": rng.normal(size=(ROWS, 2)),
        "actions": rng.uniform(-1, 1, (ROWS, 1)),
        "rewards": rng.normal(size=ROWS),
        "next_observations": rng.normal(size=(ROWS, 2)),
        "terminated": np.arange(ROWS) % 10 == 9,
        "truncated": np.zeros(ROWS, bool),
    }


def spoiled(values: np.ndarray, way: str) -> Any:
    missing = np.zeros(values.shape, bool)
    missing.reshape(ROWS, -1)[HOLE, 0] = True
    return WAYS[way](np.where(missing, True if values.dtype == bool else -999, values), missing)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("field", COLUMNS)
def test_a_missing_entry_is_refused_with_its_row(field, way):
    if (way == "polars frame") == (COLUMNS[field] == 0) or (way == "polars" and COLUMNS[field] > 0):
        return  # a frame has columns, a series one
    given = {**columns(), field: spoiled(columns()[field], way)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # NumPy tells that it makes NaN of a masked element
        with pytest.raises(DatasetError, match=rf"'{field}'.* row {HOLE}( of {ROWS})?[ :;]"):
            Dataset.from_arrays(**given)
    with pytest.raises(DatasetError, match=rf"'{field}'.* row {100 + HOLE}[ :;]"):
        Dataset.from_arrays(**given, row_numbers=range(100, 100 + ROWS))


@pytest.mark.parametrize("way", ["masked", "None", "pandas", "NaN"])
def test_a_missing_entry_of_an_episode_is_refused_with_its_row(way):
    whole = {name: values for name, values in columns().items() if name != "next_observations"}
    for field in whole:
        episode = {**whole, "truncated": False, "terminated": np.arange(ROWS) == ROWS - 1}
        if field != "truncated":
            episode[field] = spoiled(np.asarray(episode[field]), way)
            with pytest.raises(DatasetError, match=rf"'{field}'.* row {HOLE}( of {ROWS})?[ :;]"):
                Dataset.from_episodes([episode])


@pytest.mark.parametrize("way", ["masked", "None", "pandas", "polars", "NaN"])
def test_a_row_without_the_id_of_its_episode_is_refused(way):
    ids = spoiled(np.repeat(np.arange(4), 10), way)
    with pytest.raises(DatasetError, match=rf"'episode' has no value in row {HOLE} of"):
        Dataset.from_arrays(**{**columns(), "terminated": None}, episode=ids)


def test_ids_of_several_kinds_get_a_message():
    for ids, message in (
        (np.array([*range(39), "last"], object), "int and str"),
        (np.array([2**100] * 40, object), "int"),
        (np.ones(40, complex), "complex128"),
    ):
        with pytest.raises(DatasetError, match=message):
            Dataset.from_arrays(**{**columns(), "terminated": None}, episode=ids)
    texts = np.array(["a"] * 20 + ["b"] * 20, object)
    assert Dataset.from_arrays(**{**columns(), "terminated": None}, episode=texts).num_episodes == 2


@pytest.mark.parametrize("way", ["masked", "None", "pandas", "polars"])
def test_an_info_that_misses_a_value_is_nan_or_refused(way):
    small = Dataset.from_arrays(**columns(), infos={"pressure": spoiled(columns()["rewards"], way)}).infos["pressure"]
    assert np.flatnonzero(np.isnan(small)).tolist() == [HOLE] and small.dtype == np.float64
    for values in (np.arange(ROWS), np.arange(ROWS) + 2**60, columns()["terminated"]):
        with pytest.raises(DatasetError, match=rf"'infos/counter' has no value .*cannot say in row {HOLE}"):
            Dataset.from_arrays(**columns(), infos={"counter": spoiled(values, way)})


def test_masked_bounds_are_unknown_bounds():
    with pytest.raises(DatasetError, match="'action_bounds'"):
        Dataset.from_arrays(**columns(), action_bounds=(np.ma.masked_array([-5.0], [True]), np.array([5.0])))


EXACT: dict[str, np.ndarray] = {
    "int64": np.array([2**63 - 1, -(2**63), 2**53 + 1] * 10),
    "uint64": np.array([2**64 - 1, 0, 2**53 + 1] * 10, np.uint64),
    "int32": (np.arange(30) + 2**31 - 40).astype(np.int32),
    "int8": np.arange(30, dtype=np.int8),
    "float64": np.array([np.pi, np.nan, 1e300] * 10),
    "float16": np.linspace(0, 1, 30).astype(np.float16),
    "bool": np.arange(30) % 3 == 0,
    "vectors": np.arange(90).reshape(30, 3) + 2**40,
    "longdouble": np.full(30, np.longdouble(1) / 3),
    "big-endian": (np.arange(30) + 2**40).astype(">i8"),
}


def counted(infos: dict[str, np.ndarray]) -> Dataset:
    rng = np.random.default_rng(0)
    return Dataset.from_arrays(
        rng.normal(size=(31, 2)),
        rng.uniform(-1, 1, (31, 1)),
        rng.normal(size=31),
        terminated=np.arange(31) % 6 == 5,
        action_bounds=(-1, 1),
        infos={name: np.concatenate([values, values[:1]]) for name, values in infos.items()},
    )


def test_infos_keep_type_and_precision_through_memory_and_files(tmp_path):
    # The last row has no successor and is dropped, and with it its infos.
    dataset = counted(EXACT)
    dataset.save(tmp_path / "set.h5")
    whole = dataset.select(range(dataset.num_episodes))
    convert.to_d4rl(
        counted({name: EXACT[name] for name in ("int64", "uint64", "float64", "bool")}), tmp_path / "d.hdf5"
    )
    for read, names in (
        (dataset, EXACT),
        (whole, EXACT),
        (Dataset.load(tmp_path / "set.h5"), EXACT),
        (Dataset.from_log(readers.read(tmp_path / "d.hdf5")), ("int64", "uint64", "float64", "bool")),
    ):
        for name in names:
            assert read.infos[name].dtype.newbyteorder("=") == EXACT[name].dtype.newbyteorder("="), name
            np.testing.assert_array_equal(read.infos[name], EXACT[name])


def test_dates_become_whole_numbers_in_their_own_resolution():
    stamps = np.datetime64("2024-05-01T12:00:00.123456789", "ns") + np.arange(30).astype("m8[ns]")
    kept = counted({"stamp": stamps, "pause": np.arange(30).astype("m8[ms]")}).infos
    assert kept["stamp"].dtype == np.int64 and (kept["stamp"].view("M8[ns]") == stamps).all()
    np.testing.assert_array_equal(kept["pause"], np.arange(30))
    series = pl.Series(stamps)
    np.testing.assert_array_equal(counted({"stamp": series.to_numpy()}).infos["stamp"], kept["stamp"])
    with pytest.raises(DatasetError, match="'infos/stamp' has no value"):
        counted({"stamp": np.append(stamps[:-1], np.datetime64("NaT"))})


def test_mixing_keeps_the_infos_that_keep_their_numbers():
    one = counted({"step": np.arange(30), "id": EXACT["int64"], "flag": EXACT["bool"]})
    other = counted({"step": np.arange(30, dtype=np.int16), "id": EXACT["uint64"], "flag": EXACT["bool"]})
    mixed = mix(one, other, 0.5)
    assert sorted(mixed.infos) == ["flag", "step"] and mixed.infos["step"].dtype == np.int64
    assert any(entry["finding"] == "infos-dropped" and "id" in entry["message"] for entry in
               mixed.provenance["findings"])  # fmt: skip


@pytest.mark.parametrize(
    "column",
    [
        2**24 + np.arange(ROWS),
        1_700_000_000 + np.arange(ROWS, dtype=np.uint32),
        1_700_000_000.0 + np.arange(ROWS),
        1.7e9 + np.linspace(0, 1, ROWS),
        2**60 + np.arange(ROWS),
        np.array([2**62 + row for row in range(ROWS)], object),
    ],
)
def test_numbers_that_single_precision_takes_for_one_another_are_refused(column):
    for field in ("observations", "rewards"):
        given = columns()
        given[field] = column if field == "rewards" else np.stack([np.arange(ROWS).astype(column.dtype), column], 1)
        with pytest.raises(DatasetError, match=rf"'{field}'.*40 different numbers.*keeps \d+ apart, .*among the infos"):
            Dataset.from_arrays(**given)
    assert Dataset.from_arrays(**columns(), infos={"counter": column}).infos["counter"][-1] == column[-1]


@pytest.mark.parametrize(
    "column",
    [
        np.arange(ROWS),
        2**24 - ROWS + np.arange(ROWS),
        2**30 + 2**10 * np.arange(ROWS),
        np.random.default_rng(0).normal(size=ROWS) * 1e12,
        np.array([True, False] * (ROWS // 2)),
    ],
)
def test_numbers_that_single_precision_tells_apart_are_taken(column):
    assert len(np.unique(Dataset.from_arrays(**{**columns(), "rewards": column}).rewards)) == len(np.unique(column))


def test_whole_numbers_beyond_64_bits_are_refused():
    for values in (np.array([2**70] * ROWS, object), np.array([2**63, -1] * (ROWS // 2), object)):
        with pytest.raises(DatasetError, match="'infos/big' holds object"):
            Dataset.from_arrays(**columns(), infos={"big": values})
