"""Observations made of readings: the same in the log and at work."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset
from odaf.data.derived import Derivation
from odaf.data.mixing import mix
from odaf.data.readers import tables
from odaf.errors import DatasetError

ROWS = 60
FORMULAS = ["error = level - setpoint", "square = error * error", "hot = temperature > 20"]


def plant() -> pl.DataFrame:
    """Three shifts of 20 rows, in numbers that float32 rounds."""
    rng = np.random.default_rng(0)
    return pl.DataFrame(
        {
            "shift": np.arange(ROWS) // 20,
            "level": rng.normal(size=ROWS),
            "setpoint": rng.normal(size=ROWS),
            "temperature": 20.0 + rng.normal(size=ROWS),
            "valve": rng.uniform(0, 100, ROWS),
            "pump": rng.uniform(0, 1, ROWS),
        }
    )


def read(frame: Any = None, **options: Any) -> Any:
    given = {
        "observations": ["level", *FORMULAS, "temperature"],
        "actions": ["valve", "pump"],
        "reward": "1 - abs(error)",
    }
    given |= {"episode": "shift", "reward": "1 - abs(level - setpoint)"} | options
    return tables.from_frame(plant() if frame is None else frame, **given)


def column(log: Any, field: str) -> np.ndarray:
    return np.asarray(log.columns[field])


def test_formulas_as_reward_and_observations():
    frame, log = plant(), read()
    level, setpoint, temperature = (frame[name].to_numpy() for name in ("level", "setpoint", "temperature"))
    error = level - setpoint
    expected = np.stack([level, error, error * error, temperature > 20, temperature], 1).astype(np.float32)
    np.testing.assert_array_equal(column(log, "observations"), expected)
    np.testing.assert_array_equal(column(log, "rewards"), (1.0 - np.abs(error)).astype(np.float32))
    assert log.observation_names == ("level", "error", "square", "hot", "temperature")
    assert log.provenance["derived"] == [
        {"recipe": "readings", "columns": ["level"]},
        {"recipe": "expression", "name": "error", "expression": "level - setpoint"},
        {"recipe": "expression", "name": "square", "expression": "error * error"},
        {"recipe": "expression", "name": "hot", "expression": "temperature > 20"},
        {"recipe": "readings", "columns": ["temperature"]},
        {"recipe": "reward", "expression": "1 - abs(level - setpoint)"},
    ]
    assert "setpoint" not in log.provenance["columns_not_read"]


@pytest.mark.parametrize("lags", [0, 1, 3])
@pytest.mark.parametrize("differences", [False, True])
def test_earlier_rows_and_changes_stay_inside_their_episode(lags: int, differences: bool):
    frame, history = plant(), max(lags, int(differences))
    log = read(observations=["level", "temperature"], lags=lags, differences=differences)
    rows = np.array([row for row in range(ROWS) if row % 20 >= history])
    own = frame.select("level", "temperature").to_numpy().astype(np.float32)
    acted = frame.select("valve", "pump").to_numpy().astype(np.float32)
    parts = [own[rows]]
    names = ["level", "temperature"]
    if differences:
        parts.append(own[rows] - own[rows - 1])
        names += ["level_change", "temperature_change"]
    for lag in range(1, lags + 1):
        parts += [own[rows - lag], acted[rows - lag]]
        names += [f"{name}_lag{lag}" for name in ("level", "temperature", "valve", "pump")]
    np.testing.assert_array_equal(column(log, "observations"), np.concatenate(parts, axis=1))
    np.testing.assert_array_equal(column(log, "actions"), acted[rows])
    assert log.observation_names == tuple(names) and np.asarray(log.row_numbers).tolist() == rows.tolist()
    found = {finding["finding"]: finding["count"] for finding in log.findings}
    assert found.get("rows-without-history", 0) == 3 * history


def test_units_go_with_what_was_made_of_a_column():
    log = read(observations=["level"], lags=1, differences=True, units={"level": "m", "valve": "%"})
    assert log.observation_units == ("m", "m", "m", "%", "")


def replayed(log: Any, frame: pl.DataFrame) -> np.ndarray:
    """Observations as they arise at work, step by step, for the rows of the log."""
    provenance = json.loads(json.dumps(dict(log.provenance)))
    derivation = Derivation.from_provenance(provenance)
    assert derivation is not None and derivation.names == log.observation_names
    found, shift, memory = [], None, derivation.begin()
    for row in frame.iter_rows(named=True):
        if row["shift"] != shift:
            shift, memory = row["shift"], derivation.begin()
        observation, memory = derivation.step(np.array([[row[name] for name in derivation.readings]]), memory)
        if not np.isnan(observation).any():
            found.append(observation[0])
        memory = derivation.acted(np.array([[row["valve"], row["pump"]]]), memory)
    return np.stack(found)


@pytest.mark.parametrize("options", [{}, {"lags": 2}, {"differences": True}, {"lags": 3, "differences": True}])
@pytest.mark.parametrize("form", ["frame", "csv"])
def test_at_work_the_readings_give_the_very_observations_of_the_log(form: str, options: dict[str, Any], tmp_path: Path):
    frame = plant()
    if form == "csv":
        frame.write_csv(tmp_path / "log.csv")
        roles = {
            "observations": ["level", *FORMULAS],
            "actions": ["valve", "pump"],
            "reward": "level",
            "episode": "shift",
        }
        log = tables.read(tmp_path / "log.csv", **roles, **options)
    else:
        log = read(**options)
    seen = replayed(log, frame)
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen, column(log, "observations"))


def test_the_recipes_go_with_the_data(tmp_path: Path):
    dataset = Dataset.from_log(read(lags=1))
    dataset.save(tmp_path / "log.h5")
    train, _ = Dataset.load(tmp_path / "log.h5").split(0.4)
    mixed = mix(dataset, dataset, 0.5)
    with pytest.raises(DatasetError, match="the two differ in what observations are made of"):
        mix(
            dataset,
            Dataset.from_log(
                read(observations=["level", *FORMULAS[:2], "hot = temperature > 19", "temperature"], lags=1)
            ),
            0.5,
        )
    for provenance in (dataset.provenance, train.provenance, mixed.provenance):
        derivation = Derivation.from_provenance(provenance)
        assert derivation is not None and derivation.lags == 1 and derivation.names == dataset.observation_names
    assert Derivation.from_provenance(Dataset.from_log(read(observations=["level"])).provenance) is None


def test_what_is_missing_at_work_is_named():
    derivation = Derivation.from_provenance(dict(read(lags=1).provenance))
    assert derivation is not None and derivation.readings == ("level", "setpoint", "temperature")
    readings, first = np.array([[1.0, 1.0, 20.0]]), derivation.begin()
    with pytest.raises(DatasetError, match="reading 'level' is not a finite number; a policy"):
        derivation.step(np.array([[np.nan, 1.0, 20.0]]), first)
    with pytest.raises(DatasetError, match="reading 'temperature' is not a finite number in row 1"):
        derivation.step(np.array([[1.0, 1.0, 20.0], [1.0, 1.0, np.inf]]), derivation.begin(2))
    nothing, memory = derivation.step(readings, first)
    assert np.isnan(nothing).any()
    with pytest.raises(DatasetError, match="the action of the step before is part of this observation"):
        derivation.step(readings, memory)
    observation, _ = derivation.step(readings, derivation.acted(np.array([[1.0, 2.0]]), memory))
    assert observation[0, -2:].tolist() == [1.0, 2.0]


def test_a_formula_without_a_value_is_named_with_its_readings():
    derivation = Derivation.from_recipes([{"recipe": "expression", "name": "root", "expression": "sqrt(level)"}])
    with pytest.raises(DatasetError, match=r"'root = sqrt.level.' has no finite value for these readings .level -4"):
        derivation.step(np.array([[-4.0]]), derivation.begin())


@pytest.mark.parametrize(
    ("recipes", "message"),
    [
        ([{"recipe": "wavelet"}], "recipe 'wavelet' is unknown to this version"),
        ([{"recipe": "lags", "rows": 0, "actions": []}], "recipe 'lags' is unknown"),
        ([{"recipe": "lags", "rows": 10**9, "actions": []}], "recipe 'lags' is unknown"),
        ([{"recipe": "lags", "rows": "x", "actions": []}], "recipe 'lags' is damaged"),
        ([{"recipe": "readings"}], "recipe 'readings' is damaged"),
        ([{"recipe": "readings", "columns": [1]}], "recipe 'readings' is damaged"),
        ([{"recipe": "expression", "name": "x", "expression": "exec(level)"}], "function exec is unknown"),
        (["level"], "recipe None is unknown"),
        ([{"recipe": "differences"}], "recipes name no reading and no formula"),
    ],
)
def test_recipes_that_are_none_are_refused(recipes: list[Any], message: str):
    with pytest.raises(DatasetError, match=message):
        Derivation.from_recipes(recipes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"observations": ["gap = level - setpiont"]},
            "frame: expression 'level - setpiont': column 'setpiont' not found; did",
        ),
        ({"observations": ["level = level - 1"]}, "there is a column 'level' already; give it another name"),
        ({"observations": ["e = level", "e = setpoint"]}, "there is a column 'e' already"),
        ({"observations": ["late = soon", "soon = level"]}, "column 'soon' not found"),
        ({"observations": ["level", "level_lag1 = setpoint"], "lags": 1}, "observation 'level_lag1' is there twice"),
        ({"reward": "1 - abs(levle)"}, "frame: expression '1 - abs.levle.': column 'levle' not found"),
        ({"reward": "cost"}, "frame: column 'cost' not found"),
        ({"lags": -1}, "lags is -1; give the number of earlier rows"),
        ({"lags": 20}, "no episode is longer than 20 rows"),
        ({"lags": 1_000}, "no episode is longer than 1000 rows"),
        (
            {"observations": ["x = 1 / (level - level)"]},
            r"expression 'x = 1 / .*' is infinite in 60 of 60 rows.*level 0.1257",
        ),
        ({"observations": ["x = ln(level)"]}, r"column 'x = ln.level.' has no value .*on_missing"),
        ({"reward": "shift - shift / 0"}, "is infinite"),
        (
            {"observations": ["level"], "next_observations": ["setpoint"], "lags": 1},
            "next_observations= gives successors without formulas, lags and differences; leave it out",
        ),
        (
            {"observations": ["e = level - setpoint"], "next_observations": ["setpoint"]},
            "next_observations= .*leave it out",
        ),
    ],
)
def test_what_cannot_be_derived(options: dict[str, Any], message: str):
    with pytest.raises(DatasetError, match=message):
        read(**options)


def test_what_cannot_be_computed_is_missing():
    frame = plant()
    log = read(observations=["x = sqrt(level)"], on_missing="break")
    assert len(log) == int((frame["level"].to_numpy() >= 0).sum())
    (finding,) = (entry for entry in log.findings if entry["finding"] == "missing-cells")
    assert finding["count"] == ROWS - len(log) and "by column: x" in finding["message"]
