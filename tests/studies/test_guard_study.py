"""The guard's study on a handful of short episodes: figures, table and summary."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from odaf.studies import guard as study
from odaf.studies.guard import Guarding, _avoided, _Watched
from odaf.studies.registry import STUDIES
from odaf.training.progress import Silent

pytest.importorskip("mujoco")


def test_a_robot_is_guarded_knocked_and_attacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(study, "RATES", (0.2, 0.5))
    settings = (("steps", 2), ("hidden_sizes", (4,)), ("references", 20), ("members", 2))
    sizes: dict[str, Any] = {
        "calibration": 5,
        "fresh": 3,
        "disturbed": 2,
        "counted": 12,
        "at": 4,
        "window": 8,
        "knocks": (2,),
        "budgets": (0.1,),
    }
    work = Guarding("hopper", steps=2, rows=2_000, settings=settings, **sizes)
    record = work.do(tmp_path, Silent())
    assert record["episodes"] == {"calibration": 5, "fresh": 3, "own": 3}
    assert set(record["rates"]) == {"0.2", "0.5"}
    for each in record["rates"].values():
        assert all(0.0 <= each[name] <= 1.0 for name in ("false_alarms", "false_alarms_policy", "detected"))
        assert set(each["by_disturbance"]) == {"nothing", "knock, 2 steps", "attack, 0.1"}
        assert each["guard"]["calibration"]["episodes"] == 5
    assert work.recorded(json.loads(json.dumps(record)), {}) == work.identity()
    assert "% detected" in work.said(record)

    found = json.loads(study.summary([record]))
    assert set(found["hopper"]["0.2"]) >= {"false_alarms", "detected", "falls_avoided"}
    assert study.table([record]).count("| hopper |") == 2 + 3


def test_alarms_after_an_end_do_not_count():
    watched = _Watched([])
    watched._noted = [np.ones((2, 3), bool) for _ in range(4)]
    watched.ended(np.array([4, 2, 0]))
    assert watched.alarms().sum(axis=0).tolist() == [[4, 2, 0], [4, 2, 0]]


def test_what_is_seen_is_moved_from_the_disturbance_on():
    seen = list[float]()

    class Sees:
        def begin(self, rows: int) -> Any:
            return SimpleNamespace(alarm=np.zeros(rows, bool))

        def act(self, carry: Any, observations: np.ndarray) -> Any:
            seen.append(float(observations[0, 0]))
            return observations, carry

    watched: Any = _Watched([cast(Any, Sees())], lambda observations: observations + 10.0, since=2)
    carry = watched.begin(1)
    for _ in range(4):
        _, carry = watched.act(carry, np.zeros((1, 1)))
    assert seen == [0.0, 0.0, 10.0, 10.0]


def test_falls_avoided_are_net():
    figures = [{"falls": 6, "falls_guarded": 2}, {"falls": 2, "falls_guarded": 4}]
    assert _avoided(figures) == 0.25
    assert _avoided([{"falls": 0, "falls_guarded": 0}]) is None


def test_the_plan_asks_for_enough_episodes():
    jobs = STUDIES["guard"].jobs()
    assert [job.name for job in jobs] == ["hopper", "walker2d", "halfcheetah"]
    for job in jobs:
        assert isinstance(job.do, Guarding) and job.do.calibration >= 200 and job.do.fresh >= 500
