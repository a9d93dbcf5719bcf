"""Training, resuming, and what they leave on the disk."""

import json
import shutil

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf import training
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import device_columns, sample
from odaf.errors import CheckpointError, ConfigError, DatasetError, DivergenceError
from odaf.training import loop, run_writing
from odaf.training.progress import Silent


def _fit(tiny, directory, **changes):
    settings = {"steps": 12, "checkpoint_every": 4, "stretch": 4, "progress": False} | changes
    algorithm = settings.pop("algorithm", tiny.TinyLearner())
    return training.fit(algorithm, settings.pop("dataset", tiny.tiny_dataset()), directory=directory, **settings)


def test_training_equals_the_same_updates_called_one_by_one(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run", steps=7, stretch=3, seeds=(3,))
    learner, dataset = tiny.TinyLearner(), tiny.tiny_dataset()
    columns = device_columns(dataset, Normaliser.fit(dataset.observations))
    offset = jr.normal(loop.pretrain_key(3), (2,))
    state = learner.init(loop.init_key(3), dataset.spec(), offset)
    for step in range(7):
        key_sample, key_update = jr.split(jr.fold_in(loop.training_key(3), step))
        state, _ = learner.update(state, sample(columns, key_sample, learner.batch_size), key_update)
    found = run.state(3)
    assert int(found.step) == 7
    np.testing.assert_allclose(found.weights, state.weights, rtol=1e-5)
    np.testing.assert_allclose(found.slow, state.slow, rtol=1e-5)
    np.testing.assert_array_equal(found.offset, offset)


def test_metrics_are_reduced_over_their_stretch_by_the_end_of_their_name(tiny, tmp_path):
    lines = _fit(tiny, tmp_path / "run", steps=10).metrics(0)
    assert [line["step"] for line in lines] == [4, 8, 10]
    assert [line["tiny/step"] for line in lines] == [1.5, 5.5, 8.5]
    assert [line["tiny/step/max"] for line in lines] == [3.0, 7.0, 9.0]
    assert [line["tiny/step/min"] for line in lines] == [0.0, 4.0, 8.0]
    assert all(line["time/updates_per_second"] > 0 and line["time/seconds"] > 0 for line in lines)


def test_where_a_run_is_cut_into_stretches_changes_no_bit(tiny, tmp_path):
    whole = _fit(tiny, tmp_path / "whole", stretch=12, checkpoint_every=12)
    cut = _fit(tiny, tmp_path / "cut", stretch=5, checkpoint_every=1)
    for ours, theirs in zip(jax.tree.leaves(whole.state(0)), jax.tree.leaves(cut.state(0)), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_two_runs_of_one_seed_agree_bit_for_bit_and_two_seeds_differ(tiny, tmp_path):
    first, second = _fit(tiny, tmp_path / "a", seeds=(0, 1)), _fit(tiny, tmp_path / "b", seeds=(0, 1))
    assert tiny.arrays_of(first.path) == tiny.arrays_of(second.path)
    assert not np.array_equal(first.state(0).weights, first.state(1).weights)
    assert not np.array_equal(first.state(0, 0).weights, first.state(1, 0).weights)
    assert not np.array_equal(first.state(0).offset, first.state(1).offset)


def test_one_compilation_serves_all_seeds_lengths_and_runs(tiny, tmp_path, monkeypatch):
    traces = []
    update = tiny.TinyLearner.update
    monkeypatch.setattr(tiny.TinyLearner, "update", lambda *args: traces.append(1) or update(*args))
    learner = tiny.TinyLearner(batch_size=7)  # a program that no other test compiles
    _fit(tiny, tmp_path / "a", algorithm=learner, seeds=(0, 1), steps=11)
    once = len(traces)
    assert 1 <= once <= 2  # shapes of the metrics, and the loop
    _fit(tiny, tmp_path / "b", algorithm=learner, seeds=(2,), steps=9, stretch=2)
    assert len(traces) == once


def test_longer_resumed_run_equals_one_that_was_longer_from_the_start(tiny, tmp_path):
    long = _fit(tiny, tmp_path / "long", steps=18, evaluate=tiny.TinyEvaluator())
    _fit(tiny, tmp_path / "short", steps=12, evaluate=tiny.TinyEvaluator())
    with pytest.raises(ConfigError, match=r"odaf resume .*short --steps 18"):
        _fit(tiny, tmp_path / "short", steps=18, evaluate=tiny.TinyEvaluator())
    resumed = training.resume(
        tmp_path / "short", 18, dataset=tiny.tiny_dataset(), evaluate=tiny.TinyEvaluator(), progress=False
    )
    assert tiny.arrays_of(resumed.path) == tiny.arrays_of(long.path)
    assert tiny.lines_of(resumed.path) == tiny.lines_of(long.path)
    assert resumed.summary(0)["evaluation"] == long.summary(0)["evaluation"]
    assert resumed.config["steps"] == 18
    assert len(json.loads((resumed.path / "environment.json").read_text())["resumed"]) == 1


def test_run_that_was_made_longer_and_cut_off_does_not_claim_to_be_finished(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run")
    assert run.summary(0)["status"] == "finished"
    config = json.loads((run.path / "config.json").read_text())
    (run.path / "config.json").write_text(json.dumps(config | {"steps": 100}))
    assert training.load_run(run.path).summary(0)["status"] == "running"


def test_what_lies_beyond_the_checkpoint_is_removed_before_training_goes_on(tiny, tmp_path):
    seed = tmp_path / "seed-0"
    (seed / "evaluations").mkdir(parents=True)
    (seed / "checkpoints" / ".writing-7-00000008").mkdir(parents=True)
    for name in ("evaluations/00000004.npz", "evaluations/00000008.npz", "notes.txt", ".writing-7-summary.json"):
        (seed / name).write_text("")
    run_writing.clean(seed, 4)
    left = {str(path.relative_to(seed)) for path in seed.rglob("*")}
    assert left == {"evaluations", "evaluations/00000004.npz", "checkpoints", "notes.txt"}


class _Crash(BaseException):
    """Stands for the end of the process: nothing that runs afterwards may reach the disk."""


def _crash_at(monkeypatch, count):
    seen = 0

    def mortal(function):
        def call(*args, **kwargs):
            nonlocal seen
            seen += 1
            if seen >= count:
                raise _Crash
            return function(*args, **kwargs)

        return call

    for owner, name in (("os", "fsync"), ("os", "replace"), ("shutil", "rmtree"), ("pathlib.Path", "unlink")):
        monkeypatch.setattr(f"{owner}.{name}", mortal(getattr(_resolve(owner), name)))


def _resolve(name):
    import os
    import pathlib

    return {"os": os, "shutil": shutil, "pathlib.Path": pathlib.Path}[name]


def test_crash_at_every_single_write_loses_nothing(tiny, tmp_path, monkeypatch):
    compiled, program = loop.compiled_stretch, []

    def compiled_once(*shapes):
        program.extend([] if program else [compiled(*shapes)])
        return program[0]

    monkeypatch.setattr(loop, "compiled_stretch", compiled_once)  # one program for a hundred fits

    def fit(directory):
        return _fit(tiny, directory, steps=4, stretch=2, evaluate=tiny.TinyEvaluator(every=2), seeds=(5,))

    unbroken = fit(tmp_path / "unbroken")
    broken, crashes = tmp_path / "broken", 0
    for count in range(1, 1000):
        shutil.rmtree(broken, ignore_errors=True)
        with monkeypatch.context() as patch:
            _crash_at(patch, count)
            try:
                fit(broken)
                break
            except _Crash:
                crashes += 1
        if (broken / "config.json").exists():  # whatever the moment, what is there can be read
            run = training.load_run(broken)
            for seed in run.seeds:
                assert run.summary(seed)["seed"] == seed and isinstance(run.metrics(seed), list)
                if run.checkpoints(seed):
                    run.policy(seed)
        run = fit(broken)
        assert tiny.arrays_of(broken) == tiny.arrays_of(unbroken.path), count
        for seed in run.seeds:
            assert tiny.lines_of(broken, seed) == tiny.lines_of(unbroken.path, seed), count
            summary = json.loads((broken / f"seed-{seed}" / "summary.json").read_text())
            assert summary == run.summary(seed) and summary["status"] == "finished"
            assert summary["evaluation"] == unbroken.summary(seed)["evaluation"]
        assert not list(broken.rglob(".writing-*")), count
        names = {path.relative_to(broken) for path in broken.rglob("*")}
        assert names == {path.relative_to(unbroken.path) for path in unbroken.path.rglob("*")}, count
    assert crashes > 25


def test_directory_with_other_settings_or_foreign_files_is_refused_and_untouched(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run")
    before = {path: path.stat().st_mtime_ns for path in run.path.rglob("*") if path.name not in ("run", ".lock")}
    for changes, named in (
        ({"algorithm": tiny.TinyLearner(learning_rate=0.5)}, r"algorithm\.learning_rate was 0\.1, now 0\.5"),
        ({"seeds": (0, 1)}, "seeds was"),
        ({"checkpoint_every": 6}, "checkpoint_every was 4, now 6"),
        ({"dataset": tiny.tiny_dataset(75)}, "data was"),
        ({"evaluate": tiny.TinyEvaluator()}, "evaluate was None"),
    ):
        with pytest.raises(ConfigError, match=named):
            _fit(tiny, run.path, **changes)
    assert {path: path.stat().st_mtime_ns for path in before} == before

    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "home.txt").write_text("dear all")
    with pytest.raises(ConfigError, match=r"home\.txt.*holds no run.*--out"):
        _fit(tiny, tmp_path / "letters")
    assert [path.name for path in (tmp_path / "letters").iterdir()] == ["home.txt"]
    with pytest.raises(ConfigError, match="is a file"):
        _fit(tiny, tmp_path / "letters" / "home.txt")


def test_same_call_again_continues_and_then_does_nothing(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run")
    arrays = tiny.arrays_of(run.path)
    shutil.rmtree(run.checkpoint(0).path)
    assert training.load_run(run.path).summary(0)["step"] == 8
    _fit(tiny, tmp_path / "run")
    assert tiny.arrays_of(run.path) == arrays
    _fit(tiny, tmp_path / "run")
    assert tiny.arrays_of(run.path) == arrays and [line["step"] for line in run.metrics(0)] == [4, 8, 12]


# A misspelt on_divergence never gets this far here: tests check every annotation at run time.
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"steps": 0}, "steps"),
        ({"stretch": 0}, "stretch"),
        ({"checkpoint_every": -1}, "checkpoint_every"),
        ({"seeds": ()}, "seeds"),
        ({"seeds": (1, 1)}, "seeds"),
        ({"seeds": (-1,)}, "seeds"),
        ({"steps": 2**31}, "steps"),
    ],
)
def test_settings_out_of_range_are_named(tiny, tmp_path, changes, named):
    with pytest.raises(ConfigError, match=f"^{named}: "):
        _fit(tiny, tmp_path / "run", **changes)
    assert not (tmp_path / "run").exists()


def test_a_setting_that_no_learner_can_have_is_refused_before_anything_is_written(tiny, tmp_path):
    with pytest.raises(ConfigError, match=r"^learning_rate=-0\.1 must not be negative"):
        _fit(tiny, tmp_path / "run", algorithm=tiny.TinyLearner(learning_rate=-0.1))
    assert not (tmp_path / "run").exists()


def test_a_run_that_ends_in_its_warm_up_is_told_of(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(tiny.TinyLearner, "warm_up", "batch_size")  # 8
    heard = []

    class Report(Silent):
        def message(self, text):
            heard.append(text)

    _fit(tiny, tmp_path / "long", steps=9, progress=Report())
    assert not any("only fits the log" in text for text in heard)
    run = _fit(tiny, tmp_path / "short", steps=8, progress=Report())
    words = f"{run.path}: in all 8 updates the actor only fits the log, because batch_size=8; take more steps"
    assert any(text.startswith(words) for text in heard)


def test_resume_refuses_what_would_not_be_the_same_run(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run")
    with pytest.raises(ConfigError, match="came from memory"):
        training.resume(run.path, progress=False)
    with pytest.raises(DatasetError, match="fingerprint"):
        training.resume(run.path, dataset=tiny.tiny_dataset(75), progress=False)
    with pytest.raises(ConfigError, match="steps: 3 asked"):
        training.resume(run.path, 3, dataset=tiny.tiny_dataset(), progress=False)
    _fit(tiny, tmp_path / "evaluated", steps=4, evaluate=tiny.TinyEvaluator())
    with pytest.raises(ConfigError, match=r"evaluate: the run was begun with .*or None to go on without"):
        training.resume(tmp_path / "evaluated", dataset=tiny.tiny_dataset(), progress=False)
    with pytest.raises(CheckpointError, match=r"nowhere.*no such file.*odaf train --out"):
        training.resume(tmp_path / "nowhere", progress=False)


def test_a_note_beside_the_rows_forbids_no_resume(tiny, tmp_path):
    run, noted = _fit(tiny, tmp_path / "run", steps=4), tiny.tiny_dataset().with_provenance(plant="Nord")
    assert training.resume(run.path, 6, dataset=noted, progress=False).checkpoint(0).step == 6
    again = {"checkpoint_every": run.config["checkpoint_every"], "stretch": run.config["stretch"], "progress": False}
    assert training.fit(tiny.TinyLearner(), noted, steps=6, directory=run.path, **again).checkpoint(0).step == 6


def test_a_run_from_before_prints_of_rows_is_compared_by_its_file(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run", steps=4)
    record = json.loads((run.path / "data.json").read_text())
    assert record.pop("rows_sha256") == tiny.tiny_dataset().fingerprint()
    (run.path / "data.json").write_text(json.dumps(record))
    assert training.resume(run.path, 6, dataset=tiny.tiny_dataset(), progress=False).checkpoint(0).step == 6
    for other in (tiny.tiny_dataset(75), tiny.tiny_dataset().with_provenance(plant="Nord")):
        with pytest.raises(DatasetError, match="fingerprint"):
            training.resume(run.path, 7, dataset=other, progress=False)


def test_resume_reads_the_data_from_the_path_as_the_user_gave_it(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tiny.tiny_dataset().save("log.h5")
    run = _fit(tiny, "run", data_path="log.h5")
    assert json.loads((run.path / "data.json").read_text())["path"] == "log.h5"
    assert training.resume("run", 16, progress=False).checkpoint(0).step == 16


def test_second_process_in_one_directory_is_refused(tiny, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    run = _fit(tiny, tmp_path / "run", steps=4)
    with (run.path / ".lock").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(ConfigError, match="another process"):
            _fit(tiny, run.path, steps=4)
    _fit(tiny, run.path, steps=4)


def test_stop_on_divergence_saves_first_and_resume_goes_on(tiny, tmp_path):
    learner = tiny.TinyLearner(blow_up_at=5)
    with pytest.raises(DivergenceError, match=r"critic/max.*value_range.*saved at step 6.*odaf resume"):
        _fit(tiny, tmp_path / "run", algorithm=learner, stretch=2, on_divergence="stop")
    run = training.load_run(tmp_path / "run")
    assert run.checkpoint(0).step == 6 and run.summary(0)["status"] == "diverged"
    training.resume(tmp_path / "run", dataset=tiny.tiny_dataset(), progress=False)
    warned = _fit(tiny, tmp_path / "warned", algorithm=learner, stretch=2)
    kinds = [warning["kind"] for warning in warned.summary(0)["warnings"]]
    assert kinds == ["pretrain", "above-range"]  # once, though every later stretch is out of range
    assert [w["kind"] for w in run.summary(0)["warnings"]] == kinds
    assert (
        tiny.arrays_of(warned.path)["seed-0/checkpoints/00000012/state.eqx"]
        == (tiny.arrays_of(run.path)["seed-0/checkpoints/00000012/state.eqx"])
    )
    assert run.summary(0)["status"] == "finished"


@pytest.mark.parametrize("on_divergence", ["warn", "stop"])
def test_lost_parameters_always_end_training_and_earlier_checkpoints_stay(tiny, tmp_path, on_divergence):
    learner = tiny.TinyLearner(learning_rate=1e15)
    with pytest.raises(
        DivergenceError, match=r"seed-0: after update 4 the parameters are not finite .*tiny/loss is not"
    ):
        _fit(
            tiny,
            tmp_path / "run",
            algorithm=learner,
            checkpoint_every=2,
            stretch=2,
            evaluate=tiny.TinyEvaluator(),
            on_divergence=on_divergence,
        )
    run = training.load_run(tmp_path / "run")
    summary = run.summary(0)
    assert (summary["step"], summary["status"], summary["evaluation"]) == (4, "diverged", None)
    assert np.isfinite(run.policy(0, 2)(np.zeros(3, np.float32))).all()
    with pytest.raises(DivergenceError, match="earlier checkpoint"):
        run.policy(0)(np.ones(3, np.float32))
    with pytest.raises(DivergenceError, match="after update 6"):
        training.resume(run.path, dataset=tiny.tiny_dataset(), evaluate=tiny.TinyEvaluator(), progress=False)


def test_run_directory_explains_itself_without_the_dataset(tiny, tmp_path):
    dataset = tiny.tiny_dataset()
    _fit(tiny, tmp_path / "run", preset="small", evaluate=tiny.TinyEvaluator(every=8))
    run = training.load_run(tmp_path / "run")
    assert run.algorithm == tiny.TinyLearner() and run.spec == dataset.spec() and run.config["preset"] == "small"
    assert run.data["sha256"] == dataset.file_fingerprint() and run.data["summary"] == dataset.summary()
    environment = json.loads((run.path / "environment.json").read_text())
    assert environment["versions"]["jax"] == jax.__version__ and environment["command"] and environment["device"]

    summary = json.loads((run.path / "seed-0" / "summary.json").read_text())
    assert summary["evaluation"]["step"] == 12 and summary["pretrain"] == {"error": 0.25}
    assert set(summary["seconds"]) == {"pretrain", "compile", "train", "evaluate", "total"}
    assert [line["step"] for line in run.metrics(0) if "evaluation/return_mean" in line] == [8, 12]

    with np.load(run.path / "data_sample.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["returns"], dataset.episode_returns(), rtol=1e-6)
        best = dataset.episode(int(np.argmax(dataset.episode_returns())))
        np.testing.assert_array_equal(arrays["best_observations"], dataset.observations[best])
        assert arrays["observations"].shape == (4, 15, 3)

    policy, state = run.policy(0), run.state(0)
    observation = np.array([1.0, -2.0, 5.0], np.float32)
    normalised = (observation - dataset.observations.mean(0)) / dataset.observations.std(0)
    expected = 1.5 + 2.5 * np.tanh(normalised @ np.asarray(state.weights) + np.asarray(state.offset))
    np.testing.assert_allclose(policy(observation), expected, rtol=1e-4)
    np.testing.assert_allclose(policy({"heat": 5.0, "level": 1.0, "flow": -2.0}), expected, rtol=1e-4)
    assert not np.array_equal(run.policy(0, 4)(observation), policy(observation))
    with pytest.raises(CheckpointError, match="there are: 0, 4, 8, 12"):
        run.policy(0, 5)
    with pytest.raises(ConfigError, match="no seed 7"):
        run.policy(7)


def test_checkpoint_of_another_seed_is_refused(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run", steps=4, seeds=(0, 1))
    shutil.rmtree(run.checkpoint(1).path)
    shutil.copytree(run.checkpoint(0).path, run.seed_directory(1) / "checkpoints" / "00000004")
    with pytest.raises(CheckpointError, match=r"seed-1.*header\.json: seed: expected 1, found 0"):
        run.policy(1)


def test_other_loggers_hear_what_the_file_holds(tiny, tmp_path):
    class Memory:
        def __init__(self):
            self.heard = []

        def open(self, directory, step):
            self.heard.append(("open", directory.name, step))

        def log(self, step, metrics):
            self.heard.append((step, set(metrics)))

        def close(self):
            self.heard.append("close")

    memory = Memory()
    run = _fit(tiny, tmp_path / "run", steps=8, loggers=(memory,))
    lines = [(line["step"], set(line) - {"step"}) for line in run.metrics(0)]
    assert memory.heard == [("open", "seed-0", 0), *lines, "close"]


def test_state_keeps_firm_types_and_separate_buffers():
    shared = jnp.ones(3)
    donatable = loop.donatable({"a": shared, "b": shared, "c": jnp.asarray(1.0)})
    assert donatable["a"].unsafe_buffer_pointer() != donatable["b"].unsafe_buffer_pointer()
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(donatable))


def test_training_is_compiled_before_anything_is_trained_and_once_for_all_seeds(tiny, tmp_path, monkeypatch):
    order, compile_it, pretrain = [], loop.compiled_stretch, tiny.TinyLearner.pretrain

    def told(name, function):
        return lambda *arguments: order.append(name) or function(*arguments)

    monkeypatch.setattr(loop, "compiled_stretch", told("compile", compile_it))
    monkeypatch.setattr(tiny.TinyLearner, "pretrain", told("pretrain", pretrain))
    _fit(tiny, tmp_path, seeds=(0, 1))
    assert order == ["compile", "pretrain", "pretrain"]


def _steps_kept(run, seed=0):
    return [checkpoint.step for checkpoint in run.checkpoints(seed)]


def test_old_checkpoints_go_but_for_the_last_three_and_every_tenth(tiny, tmp_path):
    run = _fit(tiny, tmp_path / "run", steps=25, checkpoint_every=1, stretch=25)
    assert _steps_kept(run) == [0, 10, 20, 23, 24, 25]
    with pytest.raises(CheckpointError, match=r"step 15 \(.*keeps the last 3 and one in 10.*there are: 0, 10, 20, 23"):
        run.policy(0, 15)
    run = _fit(tiny, tmp_path / "few", steps=8, checkpoint_every=3, keep_checkpoints=(1, 0))
    assert _steps_kept(run) == [8]
    assert run.summary(0)["status"] == "finished"
    run = _fit(tiny, tmp_path / "all", steps=6, checkpoint_every=1, keep_checkpoints="all")
    assert _steps_kept(run) == [0, 1, 2, 3, 4, 5, 6]


def test_a_diverged_run_keeps_what_it_had_before(tiny, tmp_path):
    with pytest.raises(DivergenceError):
        _fit(
            tiny,
            tmp_path / "run",
            algorithm=tiny.TinyLearner(learning_rate=1e15),
            checkpoint_every=2,
            stretch=2,
            keep_checkpoints=(1, 0),
        )
    assert _steps_kept(training.load_run(tmp_path / "run")) == [2, 4]


class _Failing:
    """An evaluation that the environment breaks off."""

    every = 5

    def __call__(self, policy, directory, step):
        raise ConfigError("the simulator is on fire")

    def to_dict(self):
        return {"kind": "failing"}


def test_a_failing_evaluation_costs_no_update_and_can_be_left_out_or_changed(tiny, tmp_path):
    with pytest.raises(ConfigError, match="on fire"):
        _fit(tiny, tmp_path / "run", evaluate=_Failing())
    run = training.load_run(tmp_path / "run")
    assert run.checkpoint(0).step == 5 and run.summary(0)["status"] == "running"
    with pytest.raises(ConfigError, match="on fire"):
        training.resume(run.path, dataset=tiny.tiny_dataset(), evaluate=_Failing(), progress=False)
    assert run.checkpoint(0).step == 5  # it is tried again before anything else
    training.resume(run.path, dataset=tiny.tiny_dataset(), evaluate=None, progress=False)
    run = training.load_run(run.path)
    assert run.summary(0)["status"] == "finished" and run.config["evaluate"] is None
    record = json.loads((run.path / "environment.json").read_text())["resumed"][-1]
    assert record["changed"] == {"evaluate": {"from": {"kind": "failing"}, "to": None}}
    # A finished run that is to be evaluated after all has its last checkpoint tried, and trains no more.
    training.resume(run.path, dataset=tiny.tiny_dataset(), evaluate=tiny.TinyEvaluator(), progress=False)
    summary = run.summary(0)
    assert summary["evaluation"]["step"] == 12 and summary["status"] == "finished"
    assert run.metrics(0)[-1] == {"step": 12, "evaluation/return_mean": summary["evaluation"]["mean_return"]}


def test_an_evaluation_that_fails_at_the_end_leaves_a_trained_run(tiny, tmp_path):
    with pytest.raises(ConfigError, match="on fire"):
        _fit(tiny, tmp_path / "run", steps=3, evaluate=_Failing())
    run = training.load_run(tmp_path / "run")
    assert run.checkpoint(0).step == 3 and run.summary(0)["status"] == "running"
    training.resume(run.path, dataset=tiny.tiny_dataset(), evaluate=None, progress=False)
    assert run.summary(0)["status"] == "finished"


def _begun_by_an_older_odaf(path):
    config, machine = (
        json.loads((path / "config.json").read_text()),
        json.loads((path / "environment.json").read_text()),
    )
    config |= {"version": 1}
    for name in ("keep_checkpoints", "workers", "cores", "device", "precision"):
        del config[name]
    (path / "config.json").write_text(json.dumps(config))
    machine["versions"]["odaf"] = "0.1.0"
    (path / "environment.json").write_text(json.dumps(machine))


def test_a_run_of_an_older_version_tells_its_scores_and_is_not_gone_on_with(tiny, tmp_path):
    path = _fit(tiny, tmp_path / "run", evaluate=tiny.TinyEvaluator()).path
    _begun_by_an_older_odaf(path)
    run = training.load_run(path)
    assert run.summary(0)["evaluation"]["step"] == 12 and run.series(0)["tiny/loss"].steps.tolist() == [4, 8, 12]
    data, words = tiny.tiny_dataset(), "was written by odaf 0.1.0"
    with pytest.raises(CheckpointError, match=f"{words}.*odaf==0.1.0.*train again"):
        run.policy(0)
    with pytest.raises(CheckpointError, match=words):
        training.resume(path, 16, dataset=data, evaluate=None, progress=False)
    with pytest.raises(CheckpointError, match=words):
        _fit(tiny, path, evaluate=tiny.TinyEvaluator())


def test_data_are_found_from_where_the_run_was_begun_beside_it_or_where_one_says(tiny, tmp_path, monkeypatch):
    (tmp_path / "project").mkdir()
    monkeypatch.chdir(tmp_path / "project")
    tiny.tiny_dataset().save("log.h5")
    _fit(tiny, "runs/a", steps=2, data_path="log.h5")
    monkeypatch.chdir(tmp_path)
    assert training.resume("project/runs/a", 3, progress=False).checkpoint(0).step == 3
    (tmp_path / "project").rename(tmp_path / "moved")  # the whole project, runs and all
    assert training.resume("moved/runs/a", 4, progress=False).checkpoint(0).step == 4
    (tmp_path / "moved" / "log.h5").rename(tmp_path / "elsewhere.h5")
    with pytest.raises(DatasetError, match=r"looked for .*project/log\.h5, .*moved/log\.h5.*--data FILE.*dataset=FILE"):
        training.resume("moved/runs/a", 5, progress=False)


def test_a_machine_that_cannot_give_the_same_bits_is_told_beforehand(tiny, tmp_path):
    heard = []

    class Report:
        def start(self, stage, total, done=0, unit="updates"):
            heard.append("start")

        def advance(self, done, note=""): ...

        def message(self, text):
            heard.append(text)

        def close(self): ...

    run = _fit(tiny, tmp_path / "run", steps=4)
    path = run.path / "environment.json"
    machine = json.loads(path.read_text())
    path.write_text(json.dumps(machine | {"processor": "Abacus 3000", "cores": 5}))
    training.resume(run.path, 6, dataset=tiny.tiny_dataset(), progress=Report())
    assert "processor was Abacus 3000, is" in heard[0] and "cores was 5, is" in heard[0]
    assert "not with the bits of an unbroken one" in heard[0] and heard[1] == "start"
    heard.clear()
    training.resume(run.path, 8, dataset=tiny.tiny_dataset(), progress=Report())
    assert heard[0] == "start"


def test_checkpoints_that_are_gone_are_missed(tiny, tmp_path, capsys):
    run = training.fit(
        tiny.TinyLearner(), tiny.tiny_dataset(), directory=tmp_path / "run", progress=False, steps=4, stretch=2
    )
    shutil.rmtree(run.path / "seed-0" / "checkpoints")
    capsys.readouterr()
    training.resume(run.path, dataset=tiny.tiny_dataset())
    assert "had made 4 updates, and its checkpoints are gone" in capsys.readouterr().err
    assert run.checkpoint(0).step == 4


def test_a_folder_of_runs_says_that_it_is_none(tiny, tmp_path):
    for name in ("one", "other"):
        training.fit(tiny.TinyLearner(), tiny.tiny_dataset(), directory=tmp_path / name, steps=2, progress=False)
    with pytest.raises(CheckpointError, match="holds 2 runs, such as one, and is none itself; the"):
        training.resume(tmp_path, dataset=tiny.tiny_dataset(), progress=False)
