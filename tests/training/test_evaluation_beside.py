"""Policies that are played while training goes on leave what they leave when training waits for them."""

import json
import shutil
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf import training
from odaf.environments import stitch_data
from odaf.errors import ConfigError
from odaf.runs.beside import Players
from odaf.training.run_directory import RunDirectory
from odaf.training.seeds import SeedTraining

SETTINGS = {"steps": 20, "stretch": 2, "checkpoint_every": 4, "progress": False, "keep_checkpoints": "all"}


def _beside(tiny, late: int, fails_at: int | None = None):
    """The tiny evaluator, whose answer comes when `late` more policies were handed in, or is waited for."""

    class Answer(Future):
        def __init__(self, evaluator, step, found):
            super().__init__()
            self.evaluator, self.step, self.found = evaluator, step, found

        def result(self, timeout=None):
            self.evaluator.waited.append(len([each for each in self.evaluator.open if not each.done()]))
            self.evaluator.answer(self)
            return super().result(timeout)

    class Beside(tiny.TinyEvaluator):
        def __init__(self):
            super().__init__(every=4)
            self.open, self.waited = [], []

        def answer(self, one):
            if one.done():
                return
            if one.step == fails_at:
                one.set_exception(ConfigError("the environment failed"))
            else:
                one.set_result(one.found)

        def submit(self, policy, directory, step):
            self.open.append(Answer(self, step, self(policy, directory, step)))
            for each in self.open[: max(0, len(self.open) - late)]:
                self.answer(each)
            return self.open[-1]

    return Beside()


def _fit(tiny, directory, evaluate, **changes):
    return training.fit(
        tiny.TinyLearner(), tiny.tiny_dataset(), directory=directory, evaluate=evaluate, **{**SETTINGS, **changes}
    )


def _same(tiny, ours, theirs):
    assert tiny.arrays_of(ours.path) == tiny.arrays_of(theirs.path)
    assert tiny.lines_of(ours.path) == tiny.lines_of(theirs.path)
    headers = [[checkpoint.header()["summary"] for checkpoint in run.checkpoints(0)] for run in (ours, theirs)]
    for one, other in zip(*headers, strict=True):
        assert (one["step"], one["evaluation_due"], one["status"]) == (other["step"], False, other["status"])
        assert one["evaluation"] == other["evaluation"]
    for run in (ours, theirs):
        written = json.loads((run.path / "seed-0" / "summary.json").read_text())
        assert written == run.summary(0) and written["status"] == "finished"
    names = [{path.relative_to(run.path) for path in run.path.rglob("*")} for run in (ours, theirs)]
    assert names[0] == names[1]


@pytest.mark.parametrize("late", [0, 1, 2, 99])
def test_what_is_left_is_the_same_however_late_the_answers_come(tiny, tmp_path, late):
    waiting = _fit(tiny, tmp_path / "waiting", tiny.TinyEvaluator(every=4))
    evaluator = _beside(tiny, late)
    _same(tiny, _fit(tiny, tmp_path / "beside", evaluator), waiting)
    if late == 99:  # training went on until three checkpoints were behind, and then waited for the oldest alone
        assert evaluator.waited[0] == 3


def test_evaluations_that_a_crash_cut_off_are_made_when_the_run_goes_on(tiny, tmp_path, monkeypatch):
    unbroken = _fit(tiny, tmp_path / "unbroken", tiny.TinyEvaluator(every=4))
    with monkeypatch.context() as patch:
        patch.setattr(SeedTraining, "collect", lambda self, wait_for=0: None)
        _fit(tiny, tmp_path / "broken", _beside(tiny, 99))  # as if the process had ended before any answer
    assert RunDirectory(tmp_path / "broken").summary(0)["evaluation_due"]
    for late in (0, 99):
        shutil.copytree(tmp_path / "broken", tmp_path / f"broken-{late}")
        _same(tiny, _fit(tiny, tmp_path / f"broken-{late}", _beside(tiny, late)), unbroken)
    _same(tiny, _fit(tiny, tmp_path / "broken", tiny.TinyEvaluator(every=4)), unbroken)


class _Crash(BaseException):
    pass


@pytest.mark.parametrize("late", [0, 1, 3])
def test_a_crash_at_any_answer_loses_nothing(tiny, tmp_path, monkeypatch, late):
    """The process ends when the n-th answer was taken, or just before; then again in each process that goes on."""
    unbroken = _fit(tiny, tmp_path / "unbroken", tiny.TinyEvaluator(every=4))
    take, crashes = SeedTraining._take, 0
    for before in (True, False):
        for answer in (1, 2, 3):
            out = tmp_path / f"{before}-{answer}"
            for _ in range(9):
                count = 0

                def crashing(self, *arguments, before=before, answer=answer):
                    nonlocal count
                    count += 1
                    if before and count == answer:
                        raise _Crash
                    take(self, *arguments)
                    if not before and count == answer:
                        raise _Crash

                try:
                    with monkeypatch.context() as patch:
                        patch.setattr(SeedTraining, "_take", crashing)
                        _fit(tiny, out, _beside(tiny, late))
                    break
                except _Crash:
                    crashes += 1
            _same(tiny, _fit(tiny, out, _beside(tiny, late)), unbroken)
    assert crashes > 9


def test_an_environment_that_fails_is_named_and_its_evaluation_stays_due(tiny, tmp_path):
    with pytest.raises(ConfigError, match="the environment failed"):
        _fit(tiny, tmp_path / "run", _beside(tiny, 99, fails_at=8))
    due = [
        each.step
        for each in RunDirectory(tmp_path / "run").checkpoints(0)
        if each.header()["summary"]["evaluation_due"]
    ]
    assert 8 in due and 4 not in due
    unbroken = _fit(tiny, tmp_path / "unbroken", tiny.TinyEvaluator(every=4))
    _same(tiny, _fit(tiny, tmp_path / "run", tiny.TinyEvaluator(every=4)), unbroken)


def test_processes_play_what_this_one_plays(tmp_path):
    log = stitch_data.generate(stitch_data.CONFIGS["stitch"].with_repeats(1), seed=0)
    learner = odaf.BehaviourCloning(hidden_sizes=(8,), batch_size=8)
    settings = {"steps": 8, "seeds": (0, 1), "lanes": 2, "progress": False}
    rollouts = odaf.Rollouts(episodes=2, every=4)
    runs = [
        odaf.fit(learner, log, directory=tmp_path / name, evaluate=rollouts, workers=workers, **settings)
        for name, workers in (("beside", 2), ("waiting", 1))
    ]
    for seed in (0, 1):
        beside, waiting = (run.summary[seed] for run in runs)
        assert beside["status"] == "finished" and beside["evaluation"] == waiting["evaluation"]
        for step in ("00000004", "00000008"):
            files = [run.directory / f"seed-{seed}" / "evaluations" / f"{step}.npz" for run in runs]
            with np.load(files[0]) as ours, np.load(files[1]) as theirs:
                for name in ours.files:
                    np.testing.assert_array_equal(ours[name], theirs[name])


def test_an_environment_that_cannot_be_sent_is_named_with_the_remedy(tmp_path):
    log = stitch_data.generate(stitch_data.CONFIGS["stitch"].with_repeats(1), seed=0)
    assert log.environment is not None
    environment = odaf.environments.make(log.environment)
    rollouts = odaf.Rollouts(lambda: environment(), episodes=1, every=4)  # a function without a name
    with pytest.raises(ConfigError, match=r"cannot be sent to another process.*workers=1"):
        odaf.fit(
            odaf.BehaviourCloning(), log, directory=tmp_path, evaluate=rollouts, seeds=(0, 1), lanes=2, workers=2,
            progress=False,
        )  # fmt: skip


def test_nothing_is_left_behind_by_the_processes(tmp_path):
    players = Players(1)
    folder = Path(players._policies.name)
    players.close()
    assert not folder.exists()
