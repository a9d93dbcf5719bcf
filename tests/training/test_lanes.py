"""Many runs in one program: each as if it were alone, however it is cut, whoever is trained beside it."""

import json
import signal

import jax
import numpy as np
import pytest

import odaf
from odaf.errors import ConfigError, DivergenceError
from odaf.runs.many import Plan, combinations, fit_many
from odaf.training import lanes as engine
from odaf.training import seeds as seed_training
from odaf.training.run_directory import RunDirectory

SETTINGS = {"steps": 12, "stretch": 2, "checkpoint_every": 4, "seeds": (0, 5), "progress": False}
RATES = (0.1, 0.05)


@pytest.fixture
def logs(tiny):
    """Two of different lengths."""
    return tiny.tiny_dataset(), tiny.tiny_dataset(45)


def _plans(tiny, logs, folder):
    return [
        Plan(tiny.TinyLearner(learning_rate=rate), log, folder / f"{len(log)}-{rate}") for log in logs for rate in RATES
    ]


def _train(tiny, runs, lanes=8, **changes):
    return fit_many(runs, lanes=lanes, evaluate=tiny.TinyEvaluator(every=4), **{**SETTINGS, **changes})


def _same_content(tiny, ours, theirs):
    assert tiny.arrays_of(ours) == tiny.arrays_of(theirs)
    for seed in SETTINGS["seeds"]:
        assert tiny.lines_of(ours, seed) == tiny.lines_of(theirs, seed)
    names = [{path.relative_to(folder) for path in folder.rglob("*")} for folder in (ours, theirs)]
    assert names[0] == names[1]


def test_each_lane_leaves_what_its_run_alone_leaves(tiny, logs, tmp_path, monkeypatch):
    runs, pretrain, fitted = _plans(tiny, logs, tmp_path / "lanes"), tiny.TinyLearner.pretrain, []

    def counting(self, dataset, *others):
        fitted.append(len(dataset))
        return pretrain(self, dataset, *others)

    with monkeypatch.context() as patch:
        patch.setattr(tiny.TinyLearner, "pretrain", counting)
        done = _train(tiny, runs)
    assert sorted(fitted) == sorted(2 * [len(log) for log in logs])  # for each log and seed once, whatever the rate
    assert [run.directory for run in done] == [plan.directory for plan in runs]
    for plan, run in zip(runs, done, strict=True):
        alone = odaf.fit(
            plan.algorithm, plan.dataset, directory=tmp_path / "alone" / plan.directory.name,
            evaluate=tiny.TinyEvaluator(every=4), **SETTINGS,
        )  # fmt: skip
        assert (run.files.config["lanes"], alone.files.config["lanes"]) == (8, 1)
        names = [
            {path.relative_to(folder) for path in folder.rglob("*")} for folder in (run.directory, alone.directory)
        ]
        assert names[0] == names[1]
        for seed in SETTINGS["seeds"]:
            ours, theirs = run.summary[seed], alone.summary[seed]
            assert ours["status"] == "finished" and ours["warnings"] == theirs["warnings"]
            assert ours["pretrain"] == theirs["pretrain"] == {"error": 0.25}
            assert ours["evaluation"]["mean_return"] == pytest.approx(theirs["evaluation"]["mean_return"], rel=1e-5)
            for one, other in zip(run.files.metrics(seed), alone.files.metrics(seed), strict=True):
                timeless = [{name: one[name] for name in one if not name.startswith("time/")} for one in (one, other)]
                assert timeless[0] == pytest.approx(timeless[1], rel=1e-5, abs=1e-6)
            leaves = zip(jax.tree.leaves(run.files.state(seed)), jax.tree.leaves(alone.files.state(seed)), strict=True)
            for one, other in leaves:
                np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


class _Crash(BaseException):
    pass


@pytest.mark.parametrize("saves", [9, 19])
def test_a_crash_between_two_lanes_loses_nothing(tiny, logs, tmp_path, monkeypatch, saves):
    """Eight lanes save one after another, so some are further than others when the process ends in between."""
    unbroken, broken = _plans(tiny, logs, tmp_path / "unbroken"), _plans(tiny, logs, tmp_path / "broken")
    _train(tiny, unbroken)
    save, count = seed_training.SeedTraining._save, 0

    def crashing(self, state):
        nonlocal count
        count += 1
        if count > saves:
            raise _Crash
        save(self, state)

    with monkeypatch.context() as patch:
        patch.setattr(seed_training.SeedTraining, "_save", crashing)
        with pytest.raises(_Crash):
            _train(tiny, broken)
    _train(tiny, broken)
    for ours, theirs in zip(broken, unbroken, strict=True):
        _same_content(tiny, ours.directory, theirs.directory)


def test_one_run_of_several_is_gone_on_with_to_the_same_bits(tiny, logs, tmp_path):
    longer, shorter = _plans(tiny, logs, tmp_path / "longer"), _plans(tiny, logs, tmp_path / "shorter")
    _train(tiny, longer)
    _train(tiny, shorter, steps=8)
    for place in (0, 3):
        plan = shorter[place]
        odaf.resume(plan.directory, 12, dataset=plan.dataset, evaluate=tiny.TinyEvaluator(every=4), progress=False)
        assert RunDirectory(plan.directory).config["lanes"] == 8
        state, other = (RunDirectory(runs[place].directory).state(5) for runs in (longer, shorter))
        for one, two in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(one, two)


def test_more_trainings_than_lanes_take_turns_and_give_the_same(tiny, logs, tmp_path, capsys):
    turns = _plans(tiny, logs, tmp_path / "turns")
    _train(tiny, turns, lanes=3, progress=True)
    told = "".join(capsys.readouterr().err.split())  # terminals break lines
    first, second = (plan.directory for plan in turns[:2])
    assert "8trainingstaketurnsinaprogramof3lanes" in told
    assert f"turn1of3:{first}:seeds05;{second}:seeds0" in told
    for plan in turns:
        assert [RunDirectory(plan.directory).summary(seed)["status"] for seed in (0, 5)] == ["finished"] * 2


def test_a_lane_that_diverges_stops_alone(tiny, logs, tmp_path):
    runs = _plans(tiny, logs, tmp_path)
    runs[1] = Plan(tiny.TinyLearner(learning_rate=1e30), runs[1].dataset, tmp_path / "wild")
    with pytest.raises(DivergenceError, match=r"wild.seed-0.*not finite"):
        _train(tiny, runs)
    for plan in runs:
        wanted = "diverged" if plan.directory.name == "wild" else "finished"
        assert [RunDirectory(plan.directory).summary(seed)["status"] for seed in (0, 5)] == [wanted] * 2


def test_learners_of_another_structure_get_a_program_of_their_own(tiny, logs, tmp_path, capsys):
    runs = [*_plans(tiny, logs, tmp_path), Plan(tiny.TinyLearner(batch_size=4), logs[0], tmp_path / "other")]
    done = _train(tiny, runs, progress=True)
    assert [run.files.config["lanes"] for run in done] == [8, 8, 8, 8, 2]
    assert "program 2 of 2" in capsys.readouterr().err


def test_a_program_is_made_smaller_until_the_memory_holds_it(monkeypatch):
    class Analysis:
        def __init__(self, lanes):
            self.output_size_in_bytes = self.argument_size_in_bytes = self.alias_size_in_bytes = 100 * lanes
            self.temp_size_in_bytes = 50 * lanes

    class Program:
        def __init__(self, lanes):
            self.lanes = lanes

        def memory_analysis(self):
            return Analysis(self.lanes)

    class Device:
        def __init__(self, limit):
            self.limit = limit

        def memory_stats(self):
            return {"bytes_limit": self.limit}

    for limit, lanes in ((10_000, 16), (2_000, 8), (1_000, 6), (200, 1)):  # 150 bytes a lane, 90 % may be taken
        monkeypatch.setattr(jax, "devices", lambda limit=limit: [Device(limit)])
        assert engine._that_fits(Program, 16)[0] == lanes
    monkeypatch.setattr(jax, "devices", lambda: [Device(160)])
    with pytest.raises(ConfigError, match="smaller batch"):
        engine._that_fits(Program, 16)


def test_a_run_whose_program_was_made_smaller_keeps_its_width(tiny, logs, tmp_path, monkeypatch, capsys):
    """Gone on with alone it meets the lanes that the memory held when it was begun, not those asked for."""
    begun, unbroken = _plans(tiny, logs, tmp_path / "begun"), _plans(tiny, logs, tmp_path / "unbroken")
    asked = []

    def held(most):
        def fitting(compile_for, width):
            asked.append(width)
            return min(width, most), compile_for(min(width, most))

        monkeypatch.setattr(engine, "_that_fits", fitting)

    held(3)
    _train(tiny, unbroken)
    _train(tiny, begun, steps=8)
    for plan in begun:
        config = RunDirectory(plan.directory).config
        assert (config["lanes"], config["lanes_that_fit"]) == (8, 3)
    held(8)  # one run's rows alone would leave room for all
    plan = begun[1]
    odaf.resume(plan.directory, 12, dataset=plan.dataset, evaluate=tiny.TinyEvaluator(every=4), progress=False)
    assert asked == [8, 8, 3]
    for seed in SETTINGS["seeds"]:
        states = [RunDirectory(runs[1].directory).state(seed) for runs in (begun, unbroken)]
        for one, two in zip(*map(jax.tree.leaves, states), strict=True):
            np.testing.assert_array_equal(one, two)
    held(2)
    plan = begun[2]
    odaf.resume(plan.directory, 12, dataset=plan.dataset, evaluate=tiny.TinyEvaluator(every=4), progress=True)
    assert "begunin" + "aprogramof3lanes,andthismemoryholds2" in "".join(capsys.readouterr().err.split())
    assert RunDirectory(plan.directory).config["lanes_that_fit"] == 2


def test_combinations_are_named_by_what_sets_them_apart(tiny, tmp_path):
    for name in ("a", "b"):
        tiny.tiny_dataset().save(tmp_path / f"{name}.h5")
    data = [tmp_path / "a.h5", tmp_path / "b.h5"]
    values = {"learning_rate": [0.1, 0.2], "batch_size": [4]}
    found = combinations(tiny.TinyLearner(), data, values, tmp_path / "runs")
    assert [plan.directory.name for plan in found] == [
        f"{name},learning_rate={rate}" for name in "ab" for rate in (0.1, 0.2)
    ]
    assert {plan.algorithm.batch_size for plan in found} == {4}
    assert found[0].dataset is found[1].dataset is not found[2].dataset
    (alone,) = combinations(tiny.TinyLearner(), data[:1], {"batch_size": [4]}, tmp_path / "run")
    assert alone.directory == tmp_path / "run"
    for wrong, match in (({"batch": [1, 2]}, "unknown field 'batch'"), ({"learning_rate": [0.1, 0.1]}, "twice|once")):
        with pytest.raises(ConfigError, match=match):
            combinations(tiny.TinyLearner(), data, wrong, tmp_path / "runs")
    with pytest.raises(ConfigError, match="named twice"):
        combinations(tiny.TinyLearner(), [data[0], data[0]], {}, tmp_path / "runs")


def test_a_run_of_lanes_is_not_gone_on_with_in_another_number(tiny, logs, tmp_path):
    runs = _plans(tiny, logs, tmp_path / "runs")
    _train(tiny, runs)
    with pytest.raises(ConfigError, match="lanes was 8, now 4"):
        _train(tiny, runs, lanes=4)
    config = json.loads((runs[0].directory / "config.json").read_text())
    assert config["workers"] == 1


def test_an_interrupt_between_two_lanes_saves_all_of_them_at_one_update(tiny, logs, tmp_path, monkeypatch):
    runs, count, trained_to = _plans(tiny, logs, tmp_path / "runs"), 0, seed_training.SeedTraining.trained_to

    def interrupting(self, *arguments):
        nonlocal count
        count += 1
        if count == 3:
            signal.raise_signal(signal.SIGINT)
        trained_to(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(seed_training.SeedTraining, "trained_to", interrupting)
        with pytest.raises(KeyboardInterrupt, match="8 lanes are saved at update 4"):
            _train(tiny, runs)
    for plan in runs:
        assert [RunDirectory(plan.directory).summary(seed)["step"] for seed in (0, 5)] == [4, 4]
    unbroken = _plans(tiny, logs, tmp_path / "unbroken")
    _train(tiny, unbroken)
    _train(tiny, runs)
    for ours, theirs in zip(runs, unbroken, strict=True):
        _same_content(tiny, ours.directory, theirs.directory)
