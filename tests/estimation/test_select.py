"""Choosing among runs by estimates: what is ordered how, and a choice from the command line."""

import dataclasses
import importlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

import odaf
from estimation.grounds import ACTION, SMALL, constant, gliding
from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main
from odaf.errors import CheckpointError, ConfigError
from odaf.estimation import Interval, Valuation, ValueEstimate, estimate_many

select_module = importlib.import_module("odaf.estimation.select")


def says(value: float, verdict: Any = "not decided") -> tuple[Valuation, ...]:
    interval = Interval(value, value - 1.0, value + 1.0)
    wrong = Interval(-value, -value, -value)  # the calibrated one counts
    made = ValueEstimate("fqe", wrong, None, interval, verdict, "why", calibrated=interval, probability_better=0.5)
    own = Interval(0.0, -1.0, 1.0)
    return (Valuation({}, own, own, (made,), 5, 1.0, "mode", 9, 0.95, 0.0, None, ("beware",)),)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("select")
    log = dataset_of(3, 2, {"id": "Hopper-v4"})
    log.save(folder / "log.h5")
    for name in ("a", "b"):
        untrained_run(folder / "several" / name, BehaviourCloning(hidden_sizes=(4,)), log, data=folder / "log.h5")
    return folder


def test_the_highest_is_chosen_and_refused_ones_stand_behind(runs: Path, monkeypatch: pytest.MonkeyPatch):
    # a: seeds worth 0 and 4, b: 3 and 3; the best checkpoint is a's, the best run b. Then a's 4 is refused.
    calls: list[int] = []
    told = iter([says(1.0), says(5.0), says(4.0), says(4.0)])

    def estimates(policies: Sequence[Any], *rest: Any, **more: Any) -> list[tuple[Valuation, ...]]:
        calls.append(len(policies))
        more["progress"](5, 10)
        return [next(told) for _ in policies]

    monkeypatch.setattr(select_module, "estimate_many", estimates)
    monkeypatch.setattr(select_module, "AT_ONCE", 3)
    heard: list[tuple[int, int]] = []
    found = odaf.select(runs / "several", runs / "log.h5", progress=lambda *far: heard.append(far))
    assert calls == [3, 1] and heard == [(5, 20), (15, 20)]
    assert (Path(found.best.run).name, found.best.seed, found.best.worth) == ("a", 1, 4.0)
    assert Path(found.best_run).name == "b" and [run.worth for run in found.runs] == [3.0, 2.0]
    assert found.notes == ("beware",) and "best checkpoint" in str(found)
    told = iter([says(1.0), says(5.0, "refused"), says(-2.0), says(-3.0)])
    found = odaf.select([runs / "several" / name for name in "ab"], runs / "log.h5")
    assert [each.worth for each in found.candidates] == [0.0, -3.0, -4.0, 4.0]
    assert Path(found.best_run).name == "b" and [run.refused for run in found.runs] == [False, True]


def test_what_is_high_and_uncertain_stands_behind_what_is_lower_and_sure():
    sure, unsure = says(1.0)[0]["fqe"], says(5.0)[0]["fqe"]
    unsure = dataclasses.replace(unsure, difference=Interval(5.0, -1.0, 11.0))
    assert sure.least == 0.0 and unsure.least == -1.0
    assert dataclasses.replace(sure, difference=None).least == -np.inf
    assert dataclasses.replace(sure, difference=Interval(1.0, np.nan, np.nan)).least == -np.inf


def test_the_probability_is_that_of_the_difference():
    dataset = gliding(60, ends=True)
    good, bad = (
        each[0]["fqe"]
        for each in estimate_many(
            [constant(dataset), constant(dataset, -ACTION)], dataset, method="fqe", settings=SMALL
        )
    )
    assert good.probability_better and bad.probability_better is not None
    assert good.probability_better > 0.95 and bad.probability_better < 0.05
    difference = good.difference
    assert difference is not None
    error = (difference.high - difference.value) / student.ppf(0.975, SMALL.members - 1)
    np.testing.assert_allclose(good.probability_better, student.cdf(difference.value / error, SMALL.members - 1))


def test_a_choice_from_the_command_line(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "choice.json"
    words = ["select", str(runs / "several"), "--data", str(runs / "log.h5"), "--steps", "2", "--members", "2"]
    assert main([*words, "--json", str(out)]) == 0
    printed, record = capsys.readouterr().out, json.loads(out.read_text())
    assert "best run" in printed and "the policy learned from this very log" in printed
    assert len(record["candidates"]) == 4 and record["best"] == record["candidates"][0]
    assert record["best_run"] == record["runs"][0]["run"]


def test_mistakes_are_explained(runs: Path, tmp_path: Path):
    log = runs / "log.h5"
    with pytest.raises(CheckpointError, match="config"):
        odaf.select(tmp_path, log)
    with pytest.raises(ConfigError, match="one estimator chooses"):
        odaf.select(runs / "several", log, method="all")
