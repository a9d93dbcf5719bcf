"""One object for how a run is to go: argument, options, record, comparison."""

import dataclasses
import typing

import jax
import pytest

from odaf.errors import ConfigError
from odaf.training.settings import RunSettings, SettingChanges, differences, products_in


def test_keyword_arguments_are_the_fields():
    assert typing.get_type_hints(SettingChanges) == typing.get_type_hints(RunSettings)


def test_a_record_says_everything_and_gives_the_settings_back(tiny):
    settings = RunSettings(
        steps=7, seeds=range(2), evaluate=tiny.TinyEvaluator(every=3), keep_checkpoints=(2, 0), precision="high"
    ).resolved()
    record = settings.to_dict()
    assert set(record) == {field.name for field in dataclasses.fields(RunSettings)}
    assert not [name for name, value in record.items() if value is None]
    assert RunSettings.recorded(record) == dataclasses.replace(settings, evaluate=None)
    assert record["seeds"] == [0, 1] and record["evaluate"] == {"kind": "tiny", "every": 3}


def test_what_is_open_is_taken_from_the_run_before_from_this_process(monkeypatch):
    monkeypatch.setattr("odaf.training.settings.usable_cores", lambda: 8)
    fresh = RunSettings(seeds=range(4), workers=3).resolved()
    assert (fresh.workers, fresh.cores, fresh.device, fresh.precision) == (3, 2, jax.default_backend(), "default")
    assert RunSettings(seeds=(0,), workers=3).resolved().cores == 8  # one seed has all cores
    gone_on_with = RunSettings().resolved({"workers": 2, "cores": 5, "device": "gpu", "precision": "highest"})
    assert (gone_on_with.workers, gone_on_with.cores) == (2, 5)
    assert (gone_on_with.device, gone_on_with.precision) == ("gpu", "highest")


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


def test_products_have_the_precision_of_the_run():
    def precision_inside(precision):
        with products_in(precision):
            text = jax.jit(lambda x: x @ x).lower(jax.ShapeDtypeStruct((2, 2), "float32")).as_text()
        return "HIGHEST" in text

    assert [precision_inside(precision) for precision in ("default", "highest", None)] == [False, True, False]
