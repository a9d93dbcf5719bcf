"""The generators' study: it records what has policies, says what has not, and repeats nothing."""

import json

import pytest

from odaf.environments.locomotion_data import NAMES
from odaf.errors import ConfigError
from odaf.studies import generators as generators_study


@pytest.fixture
def small(monkeypatch):
    """Only two random sets of a few rows; no task has policies."""

    def nothing(task):
        raise ConfigError("none")

    monkeypatch.setattr(generators_study, "TRANSITIONS", 300)
    monkeypatch.setattr(generators_study, "shipped", nothing)
    monkeypatch.setattr(generators_study, "NAMES", ("hopper-random", "hopper-medium", "walker2d-random"))


def test_it_records_tables_and_does_not_repeat(small, tmp_path, capsys):
    generators_study.run(tmp_path)
    assert "2 of 3 sets to record" in capsys.readouterr().err
    record = json.loads((tmp_path / "hopper-random.json").read_text())
    assert record["origin"] == "locally generated data" and record["environment"]["id"] == "Hopper-v4"
    assert record["transitions_per_second"] == pytest.approx(300 / record["seconds"])
    table = (tmp_path / "table.md").read_text()
    assert "locally generated data" in table and "| hopper-medium | | | | | | | no policy shipped | | |" in table
    figures = record["statistics"]
    assert f"| {figures['mean']:,.1f} ± {figures['std']:,.1f} | {figures['normalised_mean']:.1f} " in table
    generators_study.run(tmp_path)
    assert "0 of 3 sets to record" in capsys.readouterr().err
    assert (tmp_path / "table.md").read_text() == table


def test_a_set_that_is_not_accepted_says_why():
    check = {"figure": "normalised_mean", "value": 9.0, "lowest": 41.3, "highest": 47.3, "passed": False}
    record = {
        "environment": {"id": "Hopper-v4"},
        "statistics": {
            "environment": "Hopper-v4",
            "whole_episodes": 3,
            "mean": 272.6,
            "std": 1.0,
            "normalised_mean": 9.0,
        }
        | {"terminal_row_share": 0.004},
        "acceptance": {"passed": False, "checks": [check]},
        "findings": [{"finding": "acceptance-failed", "count": 1, "message": "normalised_mean is 9"}],
        "transitions_per_second": 5000.0,
        "processor_seconds": 10.0,
    }
    table = generators_study.table({"hopper-medium": record})
    assert "| 272.6 ± 1.0 | 9.0 | 41.3 to 47.3 | 0.0040 | no | 5,000 | 10,000 |" in table
    assert "- `hopper-medium`: normalised_mean is 9" in table


def test_every_random_set_can_be_recorded_without_policies():
    assert [name for name in NAMES if generators_study.policy_mark(name) == "none"] == [
        "halfcheetah-random",
        "hopper-random",
        "walker2d-random",
    ]
