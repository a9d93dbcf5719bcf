"""Knock scores of a run, against plain evaluations."""

import dataclasses
import json

import numpy as np
import pytest

from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.environments.knocks import Knock
from odaf.environments.maze import STITCH
from odaf.errors import ConfigError, DatasetError
from odaf.runs.evaluate import evaluate
from odaf.runs.evaluate_knocks import knock_scores
from odaf.training.files import plain

MAZE = {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 8}
HOPPER = {"name": "gymnasium", "id": "Hopper-v5", "kwargs": {}}
LEARNER = BehaviourCloning(hidden_sizes=(4,))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("knocks")
    log = dataset_of(4, 2, MAZE)
    log.save(folder / "maze.h5")
    return untrained_run(folder / "run", LEARNER, log, data=folder / "maze.h5")


def test_no_knock_is_the_plain_evaluation(run):
    found = knock_scores(run, Knock(steps=0), episodes=2, seed=1)
    assert found.counted_steps == 8 and found.recovery is None and found.no_recovery == ""
    peaceful = evaluate(run, episodes=2, seed=1)
    assert [score.returns for score in found.scores.by_seed] == [score.returns for score in peaceful.by_seed]
    assert found.scores.rate("survived_rate") == 1.0 and found.scores.rate("knocked_rate") == 0.0


def test_a_knock_changes_what_comes_after_and_is_recovered_from(run):
    found = knock_scores(run, Knock(steps=30, at=3), episodes=2)
    assert found.scores.rate("knocked_rate") == 1.0 and found.scores.rate("success_rate") is not None
    assert found.scores.mean != evaluate(run, episodes=2).mean
    recovery = found.recovery
    # The maze is 4 wide and the log standard normal in all four dimensions, so every start lies among its states.
    assert recovery is not None and recovery.episodes == 4 and recovery.rows == 30
    assert recovery.median == 0.0 and recovery.recovered_rate == 1.0 and recovery.threshold > 0.0
    record = plain(found.to_dict())
    assert record["knock"] == {"steps": 30, "at": 3, "action": "motors-off"} and record["recovery"]["median"] == 0.0
    json.dumps(record)


def test_without_the_data_the_recovery_time_is_left_out_and_the_reason_told(run, tmp_path):
    knock, other = Knock(steps=2, at=3), tmp_path / "other.h5"
    known = dataset_of(4, 2, MAZE)
    dataclasses.replace(known, rewards=known.rewards + 1.0).save(other)
    lost = untrained_run(tmp_path / "lost", LEARNER, dataset_of(4, 2, MAZE), (0,), data=tmp_path / "gone.h5")
    found = knock_scores(lost, knock, episodes=1)
    assert found.recovery is None and "gone.h5: the run's data are not there" in found.no_recovery
    # The file that holds the run's data is found anew; another is refused.
    assert knock_scores(lost, knock, data=run.parent / "maze.h5", episodes=1).recovery is not None
    with pytest.raises(DatasetError, match="other.h5: is not what the run was trained on"):
        knock_scores(lost, knock, data=other, episodes=1)
    memory = untrained_run(tmp_path / "memory", LEARNER, dataset_of(4, 2, MAZE), (0,))
    assert "from memory" in knock_scores(memory, knock, episodes=1).no_recovery


def test_knocks_that_come_too_late_are_refused(run):
    with pytest.raises(ConfigError, match="500, but an episode has 8 counted steps"):
        knock_scores(run, Knock(), episodes=1)
    with pytest.raises(ConfigError, match="HalfCheetah, Hopper, Walker2d"):
        knock_scores(run, Knock(steps=0), initial_noise=0.1, episodes=1)


def test_a_falling_hopper(tmp_path):
    """An untrained policy stands almost still: it falls by itself, later than one that starts far off its pose."""
    run = untrained_run(tmp_path / "run", LEARNER, dataset_of(11, 3, HOPPER), (0,))
    still = knock_scores(run, Knock(steps=0), episodes=3)
    assert still.counted_steps == 1000 and still.scores.rate("survived_rate") == 0.0
    assert still.normalised is not None and still.normalised.mean < 10.0
    far = knock_scores(run, Knock(steps=0), initial_noise=1.0, episodes=3)  # the log's states spread by 1
    assert np.mean(far.scores.by_seed[0].returns) < np.mean(still.scores.by_seed[0].returns)
    late = knock_scores(run, Knock(steps=5, at=900), episodes=1, environment="Hopper-v5")
    assert late.scores.rate("knocked_rate") == 0.0
