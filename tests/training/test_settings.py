"""One object for how a run is to go: argument, options, record, comparison."""

import dataclasses
import re
import typing

import jax
import pytest

from odaf.errors import ConfigError
from odaf.training.process_record import process_record, why_bits_differ
from odaf.training.settings import RunSettings, SettingChanges, differences, named_precision, products_in


def test_keyword_arguments_are_the_fields():
    assert typing.get_type_hints(SettingChanges) == typing.get_type_hints(RunSettings)


def test_a_record_says_everything_and_gives_the_settings_back(tiny):
    settings = RunSettings(
        steps=7, seeds=range(2), evaluate=tiny.TinyEvaluator(every=3), keep_checkpoints=(2, 0), precision="float32"
    ).resolved()
    record = settings.to_dict()
    assert set(record) == {field.name for field in dataclasses.fields(RunSettings)}
    assert [name for name, value in record.items() if value is None] == ["widths"]  # of lanes that are not padded
    assert RunSettings.recorded(record) == dataclasses.replace(settings, evaluate=None)
    assert record["seeds"] == [0, 1] and record["evaluate"] == {"kind": "tiny", "every": 3}


def test_what_is_open_is_taken_from_the_run_before_from_this_process(monkeypatch):
    monkeypatch.setattr("odaf.training.settings.usable_cores", lambda: 8)
    fresh = RunSettings(seeds=range(4), workers=3).resolved()
    assert (fresh.workers, fresh.cores, fresh.device, fresh.precision) == (3, 2, jax.default_backend(), "float32")
    assert RunSettings(seeds=(0,), workers=3).resolved().cores == 8  # one seed has all cores
    gone_on_with = RunSettings().resolved({"workers": 2, "cores": 5, "device": "gpu", "precision": "tensorfloat32"})
    assert (gone_on_with.workers, gone_on_with.cores) == (2, 5)
    assert (gone_on_with.device, gone_on_with.precision) == ("gpu", "tensorfloat32")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"keep_checkpoints": (0, 10)}, r"keep_checkpoints: .*got \(0, 10\)"),
        ({"keep_checkpoints": (3, -1)}, "keep_checkpoints"),
        ({"workers": 0}, "workers: must be at least 1, got 0"),
        ({"cores": 0}, "cores: must be at least 1"),
    ],
)
def test_what_cannot_be_meant_is_refused(changes, named):
    with pytest.raises(ConfigError, match=f"^{named}"):
        RunSettings(**changes)


def test_a_setting_that_does_not_exist_is_named():
    with pytest.raises(ConfigError, match=r"step: no such setting of a run; known are steps, seeds, "):
        RunSettings().with_changes({"step": 3})


def test_differences_are_told_in_words_and_workers_are_none():
    old = RunSettings(workers=1, cores=1).resolved().to_dict()
    new = RunSettings(workers=4, cores=1, on_divergence="stop", steps=5).resolved().to_dict()
    assert differences(old, new) == {"steps": "steps was 20000, now 5"}


@pytest.mark.parametrize(
    ("device", "precision", "written"),
    [
        ("gpu", "float32", "HIGHEST"),  # by itself a GPU multiplies float32 numbers as TF32
        ("gpu", "tensorfloat32", "HIGH"),
        ("tpu", "float32", "HIGHEST"),
        ("tpu", "tensorfloat32", "HIGHEST"),  # a run that was begun on a GPU, gone on with elsewhere
        ("cpu", "float32", None),
        ("gpu", None, None),
    ],
)
def test_products_are_what_their_name_says(monkeypatch, device, precision, written):
    monkeypatch.setattr(jax, "default_backend", lambda: device)
    with products_in(precision):
        text = jax.jit(lambda x: x @ x).lower(jax.ShapeDtypeStruct((2, 2), "float32")).as_text()
    assert set(re.findall(r"precision = \[(\w+), (\w+)\]", text)) == {((written or "DEFAULT"),) * 2}


def test_a_run_records_what_jax_was_set_to(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    for named, recorded in (("default", "tensorfloat32"), ("bfloat16", "tensorfloat32"), ("highest", "float32")):
        with jax.default_matmul_precision(named):
            assert RunSettings().resolved().precision == recorded
    assert RunSettings().resolved().precision == "float32"
    with jax.default_matmul_precision("BF16_BF16_F32"), pytest.raises(ConfigError, match="cannot record"):
        RunSettings().resolved()


def test_tensorfloat32_is_refused_where_there_is_none():
    with pytest.raises(ConfigError, match="precision: tensorfloat32 is a format of GPUs, this is a cpu; take float32"):
        RunSettings(precision="tensorfloat32", device="cpu").resolved()


def test_records_from_before_formats_had_names_are_read():
    old = [named_precision(grade, device) for grade in ("default", "high", "highest") for device in ("cpu", "gpu")]
    assert old == ["float32", "tensorfloat32", "float32", "tensorfloat32", "float32", "float32"]
    assert named_precision("tensorfloat32", "gpu") == "tensorfloat32"
    process = process_record(2, "float32")
    before = {**process, "precision": "default"}
    assert why_bits_differ(before, process) == "" or process["device"].startswith("gpu")
