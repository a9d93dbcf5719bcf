"""`odaf evaluate` under attack and with knocks, on policies that were never trained."""

import json
import math
from pathlib import Path
from typing import get_args

import pytest

from golden.runs import dataset_of, untrained_run
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.cli import main
from odaf.cli.evaluate import Attack, Level
from odaf.environments.knocks import LEVELS
from odaf.environments.maze import STITCH
from odaf.evaluation.attacks import ATTACKS
from odaf.evaluation.scores import Scores, SeedScore

ENVIRONMENT = {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 6}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluate")
    log = dataset_of(4, 2, ENVIRONMENT)
    log.save(folder / "maze.h5")
    return untrained_run(folder / "run", EnsembleSAC(num_critics=2, hidden_sizes=(4,)), log, data=folder / "maze.h5")


def test_the_options_name_every_attack_and_level():
    assert list(get_args(Attack)) == list(ATTACKS)
    assert list(get_args(Level)) == list(LEVELS)


def test_an_attack_prints_writes_and_draws_its_curve(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, picture = tmp_path / "curve.json", tmp_path / "curve.svg"
    words = ["evaluate", str(run), "--attack", "min-q-first-order", "--eps", "0", "0.2", "--attack-steps", "rorl"]
    assert main([*words, "--episodes", "2", "--json", str(file), "--plot", str(picture)]) == 0
    record, out = json.loads(file.read_text()), capsys.readouterr().out
    assert [entry["eps"] for entry in record["budgets"]] == [0.0, 0.2]
    assert record["attack"] == "min-q-first-order" and record["attack_steps"] == "rorl"
    assert set(record["budgets"][1]["seeds"]) == {"0", "1"}
    mean = record["budgets"][1]["mean_return"]
    assert f"{mean:.1f}" in out and "environment steps/s" in out and "area under the curve" in out
    assert "run under min-q-first-order" in picture.read_text() and str(picture) in out


def test_success_in_an_ant_maze_is_the_normalised_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    environment = {"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0", "kwargs": {}, "max_episode_steps": 3}
    learner = EnsembleSAC(num_critics=2, hidden_sizes=(4,))
    run = untrained_run(tmp_path / "run", learner, dataset_of(29, 8, environment), seeds=(0,))
    assert main(["evaluate", str(run), "--episodes", "2"]) == 0
    out = capsys.readouterr().out
    assert "odaf/AntMaze-UMaze-v0: normalised score 0.0 (0 never at the goal, 100 always), raw return 0.0" in out
    assert "success" in out and "the larger contact margin counted" in out


def test_without_eps_the_published_budgets_and_ten_episodes_are_played(run: Path, tmp_path: Path):
    file = tmp_path / "curve.json"
    assert main(["evaluate", str(run), "--attack", "random", "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    assert [entry["eps"] for entry in record["budgets"]] == [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
    assert record["environment_steps"] == 7 * 2 * 10 * 6


def test_a_knock_prints_and_writes_survival_and_recovery(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "knock.json"
    words = ["evaluate", str(run), "--knock", "extra-large", "--knock-at", "2", "--knock-action", "uniform"]
    assert main([*words, "--episodes", "2", "--json", str(file)]) == 0
    record, out = json.loads(file.read_text()), capsys.readouterr().out
    assert record["knock"] == {"steps": 30, "at": 2, "action": "uniform"} and record["survived_rate"] == 1.0
    assert "survived" in out and "back on logged ground" in out and "of one of 30 logged states" in out
    words = ["evaluate", str(run), "--knock-steps", "7", "--knock-at", "2", "--episodes", "1", "--json", str(file)]
    assert main(words) == 0
    assert json.loads(file.read_text())["knock"]["steps"] == 7


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--eps", "0.1"], "--eps: means nothing without --attack NAME"),
        (["--plot", "x.svg", "--attack-steps", "pgd"], "--attack-steps, --plot: means nothing without --attack"),
        (["--knock-at", "5"], "--knock-at: means nothing without --knock LEVEL"),
        (["--attack", "random", "--knock", "slight"], "--attack: goes with neither --knock"),
        (["--attack", "random", "--data", "x.h5"], "--data: means nothing without --knock"),
        (["--attack", "random", "--plot", "x.html"], "x.html: a picture is written as SVG or PNG"),
        (["--attack", "random", "--eps", "-1"], "eps: must be one or more numbers from 0"),
        (["--knock", "slight"], "give an earlier step, for instance --knock-at 3"),
        (["--initial-noise", "0.1"], "it can be put on HalfCheetah, Hopper, Walker2d"),
    ],
)
def test_options_that_do_not_fit_are_explained(
    words: list[str], named: str, run: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["evaluate", str(run), *words]) == 2
    captured = capsys.readouterr()
    assert named in captured.err and len(captured.err.splitlines()) == 1
    assert captured.out == ""


def test_scores_without_a_mean_are_said_and_no_number_is_printed(monkeypatch, tmp_path, capsys):
    broken = SeedScore(0, 5, math.nan, math.nan, {}, (math.nan, math.nan))
    scores = Scores((broken,), "Hopper-v5", notes=("2 of 2 episodes broke off",))
    monkeypatch.setattr("odaf.runs.evaluate.evaluate", lambda *_, **__: scores)
    assert main(["evaluate", str(tmp_path), "--json", str(tmp_path / "scores.json")]) == 0
    out = capsys.readouterr().out
    assert "no mean return: every episode of seeds 0 broke off" in out and "2 of 2 episodes broke off" in out
    assert "nan" not in out
    assert json.loads((tmp_path / "scores.json").read_text())["seeds"]["0"]["returns"] == [None, None]
