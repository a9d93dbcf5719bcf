"""What makes a record count: fields that differ, were added, renamed or removed."""

from typing import Any

import pytest

from odaf.algorithms import config
from odaf.runs import presets
from odaf.studies.identity import ANY, Migration, by_name, differences, todays_learner


def test_every_field_that_differs_is_named() -> None:
    old = {"seed": 0, "learner": {"discount": 0.99, "hidden_sizes": [8, 8], "terms": {"outcome": {"weight": 1.0}}}}
    new = {"seed": 0, "learner": {"discount": 0.995, "hidden_sizes": (8, 8), "terms": {"outcome": {"weight": 3.0}}}}
    assert differences(old, old) == []
    assert differences(old, new) == [
        "learner.discount was 0.99, is 0.995",
        "learner.terms.outcome.weight was 1.0, is 3.0",
    ]
    assert differences({"a": 1, "gone": 2}, {"a": 1}) == ["gone was 2, is no longer there"]
    assert differences({"learner": "cannot be read"}, new | {"seed": 0}) == [
        "seed is 0, was not recorded",
        "learner was 'cannot be read', is a table",
    ]


def test_a_field_that_was_not_recorded_counts_as_what_held_before() -> None:
    new = {"evaluation": {"every": 5}}
    assert differences({}, new, {"evaluation.every": 5}) == []
    assert differences({}, new, {"evaluation.every": 4}) == ["evaluation.every was 4, is 5"]
    assert differences({}, new) == ["evaluation.every is 5, was not recorded"]
    assert differences({"evaluation": {"every": 3}}, new, {"evaluation.every": 5}) == ["evaluation.every was 3, is 5"]


@pytest.fixture
def odaf() -> dict[str, Any]:
    return config.to_dict(presets.load("odaf"))


def test_fields_added_since_with_their_defaults_change_nothing(odaf: dict[str, Any]) -> None:
    old = {name: value for name, value in odaf.items() if name not in ("products", "prior_scale")}
    old["terms"] = [{name: value for name, value in old["terms"][0].items() if name != "next_action_at"}]
    assert todays_learner(old) == by_name(odaf)
    changed = config.to_dict(presets.load("odaf", {"products": "bfloat16"}))
    recorded = todays_learner(old)
    assert differences({"learner": recorded}, {"learner": by_name(changed)}) == [
        "learner.products was 'float32', is 'bfloat16'"
    ]


def test_a_field_that_is_gone_or_has_another_name_needs_a_migration(odaf: dict[str, Any]) -> None:
    removed = odaf | {"momentum": 0.9}
    assert "has no field 'momentum'" in str(todays_learner(removed))
    assert todays_learner(removed, [Migration("ensemble-sac", "momentum", "removed", 0.9)]) == by_name(odaf)
    assert todays_learner(removed, [Migration("ensemble-sac", "momentum", "removed", ANY)]) == by_name(odaf)
    assert "momentum" in str(todays_learner(removed, [Migration("ensemble-sac", "momentum", "removed", 0.5)]))
    assert "momentum" in str(todays_learner(removed, [Migration("behaviour-cloning", "momentum", "removed", 0.9)]))

    term = dict(odaf["terms"][0])
    term["strength"] = term.pop("weight") + 1.0
    renamed = odaf | {"terms": [term]}
    found = todays_learner(renamed, [Migration("ensemble-sac", "outcome.strength", "renamed", "weight")])
    assert isinstance(found, dict) and found["terms"]["outcome"]["weight"] == odaf["terms"][0]["weight"] + 1.0
    assert renamed["terms"][0] is term and "strength" in term  # the record itself is left as it is


def test_a_field_whose_default_is_not_what_held_before_is_told_what_did(odaf: dict[str, Any]) -> None:
    old = {name: value for name, value in odaf.items() if name != "num_critics"}
    then = [Migration("ensemble-sac", "num_critics", "added", 7)]
    assert todays_learner(old, then) == by_name(odaf | {"num_critics": 7})
    assert todays_learner(odaf, then) == by_name(odaf)  # a record that states it is believed


def test_records_from_before_there_was_a_choice_had_1e_3_added_to_spreads() -> None:
    for preset in ("odaf", "behaviour-cloning"):
        today = config.to_dict(presets.load(preset))
        old = {name: value for name, value in today.items() if name != "normaliser_epsilon"}
        assert differences({"learner": todays_learner(old)}, {"learner": by_name(today)}) == [
            "learner.normaliser_epsilon was 0.001, is 0.0"
        ]
    assert todays_learner(old | {"discount": 0.5}) == todays_learner(old)  # it did nothing
