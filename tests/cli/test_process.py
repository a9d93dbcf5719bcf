"""What is settled before JAX is loaded: cores, device, and the order in which a GPU adds."""

import importlib
import json
import os
import sys

import pytest

from golden import tiny
from odaf import BehaviourCloning, training
from odaf.cli import main, process
from odaf.training import process_record

DETERMINISTIC = "--xla_gpu_deterministic_ops=true"


@pytest.fixture
def fresh(monkeypatch):
    """As in a process that has not loaded JAX, on a machine that shows a GPU."""
    monkeypatch.delitem(sys.modules, "jax")
    for name in ("NPROC", "XLA_FLAGS", "JAX_PLATFORMS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(process, "_has_gpu", lambda: True)


@pytest.mark.parametrize(
    ("given", "options", "wanted"),
    [
        (None, {}, DETERMINISTIC),
        ("--xla_dump_to=x", {}, f"--xla_dump_to=x {DETERMINISTIC}"),
        ("--xla_gpu_deterministic_ops=false", {}, "--xla_gpu_deterministic_ops=false"),
        ("--xla_gpu_exclude_nondeterministic_ops=true", {}, "--xla_gpu_exclude_nondeterministic_ops=true"),
        (None, {"deterministic": False}, None),
        (None, {"device": "cpu"}, None),
    ],
)
def test_a_gpu_is_asked_for_sums_in_a_fixed_order(fresh, monkeypatch, given, options, wanted):
    if given is not None:
        monkeypatch.setenv("XLA_FLAGS", given)
    process.prepare_process(None, **options)
    assert os.environ.get("XLA_FLAGS") == wanted


@pytest.mark.parametrize(
    ("words", "wanted"),
    [(["reproduce"], DETERMINISTIC), (["behaviour", "train"], DETERMINISTIC), (["data", "info"], None)],
)
def test_commands_that_fit_ask_for_them(fresh, capsys, words, wanted):
    main([*words, "--help"])
    assert os.environ.get("XLA_FLAGS") == wanted


def test_without_a_gpu_and_with_jax_loaded_nothing_is_set(fresh, monkeypatch):
    monkeypatch.setattr(process, "_has_gpu", lambda: False)
    process.prepare_process(None)
    assert "XLA_FLAGS" not in os.environ
    monkeypatch.setattr(process, "_has_gpu", lambda: True)
    monkeypatch.setitem(sys.modules, "jax", sys)
    process.prepare_process(None, cores="3")
    assert "XLA_FLAGS" not in os.environ and "NPROC" not in os.environ


def test_cores_and_device_come_from_the_record_and_the_command_goes_before_it(fresh, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"cores": 2, "device": "cpu"}))
    process.prepare_process(tmp_path)
    assert os.environ["NPROC"] == "2" and os.environ["JAX_PLATFORMS"] == "cpu"
    del os.environ["NPROC"]
    process.prepare_process(tmp_path, cores="5")
    assert os.environ["NPROC"] == "5"


def test_a_run_whose_bits_will_not_repeat_says_so_once(monkeypatch, tmp_path, capsys):
    real, module = process_record.process_record, importlib.import_module("odaf.training.fit")
    gpu = {"device": "gpu: some card x 1", "xla_flags": ""}
    monkeypatch.setattr(module, "process_record", lambda *given: {**real(*given), **gpu})
    learner, log = BehaviourCloning(hidden_sizes=(4,), batch_size=4), tiny.linear_dataset(2, 5)
    training.fit(learner, log, directory=tmp_path / "run", steps=2)
    said = capsys.readouterr().err
    assert said.count("will not repeat") == 1 and DETERMINISTIC in said
    gpu["xla_flags"] = DETERMINISTIC
    training.fit(learner, log, directory=tmp_path / "other", steps=2)
    assert "will not repeat" not in capsys.readouterr().err
