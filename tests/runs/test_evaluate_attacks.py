"""Attack curves of a run, against plain evaluations and by hand."""

import json

import numpy as np
import pytest

from golden import tiny
from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.environments.maze import STITCH
from odaf.errors import ConfigError
from odaf.evaluation.attacks import Judge
from odaf.evaluation.scores import Scores, SeedScore
from odaf.report.figures import attack_figure
from odaf.runs.evaluate import evaluate
from odaf.runs.evaluate_attacks import AttackCurve, attack_curve
from odaf.training.files import plain
from odaf.training.run_directory import RunDirectory

ENVIRONMENT = {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 6}


@pytest.fixture(scope="module")
def run_directory(tmp_path_factory):
    learner = EnsembleSAC(num_critics=2, hidden_sizes=(4,))
    return untrained_run(tmp_path_factory.mktemp("runs") / "maze", learner, dataset_of(4, 2, ENVIRONMENT))


def test_a_curve_begins_with_the_plain_evaluation(run_directory):
    curve = attack_curve(run_directory, "min-q", budgets=(0.3, 0.0), episodes=3, seed=2)
    assert curve.budgets == (0.0, 0.3) and curve.environment_steps == 2 * 2 * 3 * 6 and curve.seconds > 0
    peaceful = evaluate(run_directory, episodes=3, seed=2)
    assert curve.scores[0] == peaceful
    assert curve.scores[1] != peaceful and [score.seed for score in curve.scores[1].by_seed] == [0, 1]
    assert attack_curve(run_directory, "min-q", budgets=(0.3,), episodes=3, seed=2).scores == curve.scores[1:]
    assert not list(run_directory.rglob("evaluations")), "the run is left alone"


def _curve(environment: str | None) -> AttackCurve:
    def scores(*means: float) -> Scores:
        return Scores(tuple(SeedScore(seed, 1, mean, 0.0, {}, (mean,)) for seed, mean in enumerate(means)), environment)

    every = (scores(3000.0, 2600.0), scores(2000.0, 2600.0), scores(1000.0, 600.0))
    return AttackCurve("min-q", "pgd", (0.0, 0.1, 0.4), every, environment_steps=50, seconds=2.0)


def test_the_area_is_the_mean_height_of_each_seeds_curve():
    # Seed 0: (0.1 * 2500 + 0.3 * 1500) / 0.4 = 1750. Seed 1: (0.1 * 2600 + 0.3 * 1600) / 0.4 = 1850.
    area = _curve(None).area()
    assert area is not None and area.mean == pytest.approx(1800.0) and area.std == pytest.approx(np.sqrt(5000.0))
    assert area.low == pytest.approx(1800.0 - 12.7062 * 50.0, rel=1e-4)  # Student's t for one degree of freedom
    normalised = _curve("Hopper-v4").normalised_area()
    assert normalised is not None and normalised.mean == pytest.approx(100 * (1800 + 20.272305) / (3234.3 + 20.272305))
    assert _curve("Ant-v4").normalised is None and _curve(None).normalised_area() is None


def test_the_record_holds_both_units_with_intervals():
    record = plain(_curve("Hopper-v4").to_dict())
    assert [entry["eps"] for entry in record["budgets"]] == [0.0, 0.1, 0.4]
    first = record["budgets"][0]
    assert first["mean_return"] == 2800.0 and first["interval"][0] == pytest.approx(2800 - 12.7062 * 200, rel=1e-4)
    low, high = first["normalised"]["interval"]
    assert (low + high) / 2 == pytest.approx(first["normalised"]["normalised_score"])
    assert (high - low) / (first["interval"][1] - first["interval"][0]) == pytest.approx(100 / (3234.3 + 20.272305))
    assert record["environment_steps_per_second"] == 25.0 and record["attack_steps"] == "pgd"
    json.dumps(record)


def test_the_picture_shows_budgets_and_scores(tmp_path):
    text = attack_figure(_curve("Hopper-v4"), tmp_path / "new" / "curve.svg", "my $run").read_text()
    assert "my $run under min-q" in text and "normalised score, Hopper-v4" in text and "0.4" in text
    again = attack_figure(_curve("Hopper-v4"), tmp_path / "curve.svg", "my $run")
    assert again.read_text() == text
    assert attack_figure(_curve(None), tmp_path / "curve.png", "run").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match=r"curve.html: .*\.svg or \.png"):
        attack_figure(_curve(None), tmp_path / "curve.html", "run")


@pytest.mark.parametrize(
    ("attack", "budgets", "message"),
    [
        ("gentle", (0.1,), "'gentle' is not known; known are random, action-diff"),
        ("random", (), "one or more numbers from 0"),
        ("random", (-0.1, 0.2), "numbers from 0, got"),
        ("random", (float("nan"),), "numbers from 0, got"),
        ("random", (0.1, 0.1), "twice"),
    ],
)
def test_what_is_refused(run_directory, attack, budgets, message):
    with pytest.raises(ConfigError, match=message):
        attack_curve(run_directory, attack, budgets=budgets)


def test_behaviour_cloning_is_attacked_at_random_or_with_the_critics_of_another_run(run_directory, tmp_path):
    run = untrained_run(tmp_path / "run", BehaviourCloning(hidden_sizes=(4,)), dataset_of(4, 2, ENVIRONMENT), (0,))
    with pytest.raises(ConfigError, match="'behaviour-cloning' is not"):
        attack_curve(run, "action-diff", episodes=1)
    with pytest.raises(ConfigError, match="'behaviour-cloning' has none.*--attacker"):
        attack_curve(run, "min-q", episodes=1)
    curve = attack_curve(run, "random", budgets=(0.5,), episodes=1)
    assert curve.area() is None and np.isnan(curve.returns[0].low) and curve.attacker is None
    judged = attack_curve(run, "min-q", budgets=(0.5,), episodes=1, attacker=run_directory)
    assert judged.to_dict()["attacker"] == str(run_directory)
    assert judged.scores != curve.scores
    with pytest.raises(ConfigError, match="'behaviour-cloning' has none"):
        attack_curve(run_directory, "min-q", episodes=1, attacker=run)


def test_a_policy_is_attacked_as_it_is_deployed_with_the_critics_of_the_same_checkpoint(tmp_path):
    learner = EnsembleSAC(num_critics=2, hidden_sizes=(4,), deployed_actor="slow")
    run = RunDirectory(untrained_run(tmp_path / "run", learner, dataset_of(4, 2, ENVIRONMENT), (0,)))
    state = run.state(0)
    policy, judge = run.policy(0), Judge.of(run, 0)
    for found, wanted in ((policy.actor, state.slow_actor), (judge.critics, state.online_critics)):
        tiny.assert_same_bits(found, wanted)
    assert (judge.action_low, judge.action_high) == (run.spec.action_low, run.spec.action_high)
    np.testing.assert_array_equal(judge.scale, run.normaliser.scale)
