"""A run's policies played in several processes."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from golden.runs import dataset_of, untrained_run
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.environments.maze import STITCH
from odaf.errors import ConfigError
from odaf.evaluation.scores import Scores
from odaf.runs import evaluate_apart
from odaf.runs.evaluate import evaluate
from odaf.runs.evaluate_apart import parts_of

MAZE = {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 6}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("apart") / "run"
    return untrained_run(directory, BehaviourCloning(hidden_sizes=(4,)), dataset_of(4, 2, MAZE), seeds=(0, 1))


def in_this_process(seen: list[Any]) -> Callable[..., Iterator[tuple[Any, Any]]]:
    """`run_jobs` with everything sent through a pickle, and the last job done first."""

    def run_jobs(function: Any, jobs: Sequence[Any], workers: int, *, prepare: Any, always_apart: bool) -> Any:
        assert always_apart
        seen.append((workers, list(jobs)))
        pickle.loads(pickle.dumps(prepare))()
        for job in reversed(jobs):
            yield job, pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(function))(job)))

    return run_jobs


def test_scores_are_those_of_one_process(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(evaluate_apart, "run_jobs", in_this_process(seen))
    alone, apart = (evaluate(run, episodes=5, seed=1, workers=workers) for workers in (1, 4))
    ((workers, jobs),) = seen
    assert workers == 4 and [(job.policy_seed, job.first, job.episodes) for job in jobs] == [
        (0, 0, 2), (0, 2, 3), (1, 0, 2), (1, 2, 3)
    ]  # fmt: skip
    assert returns(apart) == [pytest.approx(each, rel=1e-3) for each in returns(alone)]
    assert [score.rates for score in apart.by_seed] == [score.rates for score in alone.by_seed]


def returns(scores: Scores) -> list[list[float]]:
    return [list(score.returns) for score in scores.by_seed]


def test_episodes_are_cut_into_as_few_parts_as_keep_all_workers_busy() -> None:
    assert parts_of(seeds=4, episodes=100, workers=2) == [(0, 100)]
    assert parts_of(seeds=1, episodes=100, workers=3) == [(0, 33), (33, 33), (66, 34)]
    assert parts_of(seeds=1, episodes=2, workers=8) == [(0, 1), (1, 1)]


def test_what_cannot_be_played_apart_is_refused(run: Path) -> None:
    from odaf.environments.registry import make

    with pytest.raises(ConfigError, match="workers=0: must be at least 1"):
        evaluate(run, workers=0)
    with pytest.raises(ConfigError, match="cannot be sent to another process.*workers=1"):
        evaluate(run, episodes=1, environment=lambda: make(MAZE)(), workers=2)
