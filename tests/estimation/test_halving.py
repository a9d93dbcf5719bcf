"""Successive halving: who goes on for how long, and a search that is stopped and given again."""

import importlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from golden.runs import dataset_of
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.cli import main
from odaf.data import Dataset
from odaf.errors import CheckpointError, ConfigError
from odaf.estimation import Interval, RunWorth, Selection
from odaf.estimation.halving import Halving, rungs_of, train_halving
from odaf.runs.many import combinations
from odaf.training.settings import RunSettings

halving_module = importlib.import_module("odaf.estimation.halving")
RATES = [1e-3, 2e-3, 3e-3]


def test_the_rungs():
    assert rungs_of(9, 1_600) == [(9, 100), (5, 200), (3, 400), (2, 800), (1, 1_600)]
    assert rungs_of(2, 10) == [(2, 5), (1, 10)] and rungs_of(1, 7) == [(1, 7)]
    with pytest.raises(ConfigError, match="steps=3 cannot be halved 2 times for 3 runs"):
        rungs_of(3, 3)


@pytest.fixture
def logs(tmp_path: Path) -> tuple[Path, Path]:
    for name, episodes in (("log", 4), ("holdout", 3)):
        dataset_of(3, 2, {"id": "Hopper-v4"}, episodes=episodes).save(tmp_path / f"{name}.h5")
    return tmp_path / "log.h5", tmp_path / "holdout.h5"


class Select:
    """Puts runs in the order of their learning rate, the highest first, and can fail once."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []
        self.fails_at: int | None = None

    def __call__(self, runs: Any, holdout: Dataset, *, checkpoints: str = "all", **rest: Any) -> Any:
        names = [Path(run).name for run in (runs if isinstance(runs, list) else [runs])]
        self.asked.append(names)
        if len(self.asked) == self.fails_at:
            raise KeyboardInterrupt
        ordered = sorted(runs if isinstance(runs, list) else [runs], key=lambda run: Path(run).name, reverse=True)
        worths = tuple(RunWorth(str(run), 1.0, False) for run in ordered)
        return Selection((), worths, Interval(0.0, 0.0, 0.0), "fqe", 5, 1.0, "mode", ())


def search(logs: tuple[Path, Path], out: Path, steps: int = 40, said: list[str] | None = None) -> Halving:
    plans = combinations(BehaviourCloning(hidden_sizes=(4,), batch_size=8), [logs[0]], {"learning_rate": RATES}, out)
    settings = RunSettings(steps=steps, seeds=(0,), checkpoint_every=10, stretch=10)
    say = (said if said is not None else []).append
    return train_halving(plans, Dataset.load(logs[1]), out, settings=settings, progress=False, say=say)


def reached(out: Path) -> dict[str, int]:
    checkpoints = out.glob("*/seed-0/checkpoints/*")
    found: dict[str, int] = {}
    for path in checkpoints:
        name = path.parts[-4]
        found[name] = max(found.get(name, 0), int(path.name))
    return found


def test_the_better_half_goes_on_and_a_stopped_search_decides_nothing_twice(
    logs: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    stub, out = Select(), tmp_path / "runs"
    monkeypatch.setattr(halving_module, "select", stub)
    names = [f"learning_rate={rate}" for rate in RATES]
    stub.fails_at = 2
    with pytest.raises(KeyboardInterrupt):
        search(logs, out)
    assert reached(out) == {names[0]: 10, names[1]: 20, names[2]: 20}
    stub.fails_at = None
    said: list[str] = []
    found = search(logs, out, said=said)
    assert reached(out) == {names[0]: 10, names[1]: 20, names[2]: 40}
    assert sorted(stub.asked[0]) == names and [sorted(each) for each in stub.asked[1:]] == [
        names[1:], names[1:], names[2:], names[2:],
    ]  # fmt: skip
    assert [rung.kept for rung in found.rungs] == [(names[2], names[1]), (names[2],), (names[2],)]
    assert [rung.steps for rung in found.rungs] == [10, 20, 40]
    assert found.best.directory == out / names[2] and len(said) == 2 and said[0].startswith("after 20 updates")
    stub.asked.clear()
    assert search(logs, out).rungs == found.rungs and len(stub.asked) == 1  # the chosen run's checkpoints alone
    with pytest.raises(ConfigError, match="is of a search with other steps"):
        search(logs, out, steps=80)
    (out / "halving.json").write_text("[]")
    with pytest.raises(CheckpointError, match="cannot be read"):
        search(logs, out)


def test_a_run_does_not_choose_by_what_it_learns_from(logs: tuple[Path, Path], tmp_path: Path):
    with pytest.raises(ConfigError, match="the hold-out is the log that a run learns from"):
        search((logs[0], logs[0]), tmp_path / "runs")


def _words(logs: Sequence[Path], out: Path, *more: str) -> list[str]:
    return [
        *("train", "behaviour-cloning", "--data", str(logs[0]), "--out", str(out), "--steps", "4", "--quiet"),
        *("--seeds", "0", "--hidden-sizes", "4", "--batch-size", "8", "--evaluate-every", "0", *more),
    ]


def test_a_grid_is_culled_from_the_command_line(
    logs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    from odaf.estimation import EstimateSettings

    real, small = halving_module.select, EstimateSettings(members=2, hidden_sizes=(4,), steps=2, resamples=10)
    monkeypatch.setattr(halving_module, "select", lambda *rest, **more: real(*rest, **more, settings=small))
    out = tmp_path / "runs"
    words = _words(logs, out, "--set", "learning_rate=1e-3,2e-3", "--halving", str(logs[1]))
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "after 2 updates" in printed.err and "best checkpoint" in printed.out
    rungs = json.loads((out / "halving.json").read_text())["rungs"]
    assert [len(rung["runs"]) for rung in rungs] == [2, 1] and rungs[-1]["steps"] == 4
    assert main(_words(logs, tmp_path / "one", "--halving", str(logs[1]))) == 2
    assert "--halving: chooses among values of --set" in capsys.readouterr().err
