"""The generators' study: it records what has policies, says what has not, and knows the policies of its records."""

from pathlib import Path

import numpy as np
import pytest

from odaf.environments.locomotion_data import NAMES
from odaf.errors import ConfigError
from odaf.studies import ant_maze_recordings, logs
from odaf.studies import generators as generators_study
from odaf.studies.ant_maze_recordings import AntMazeRecording
from odaf.studies.generators import Recording
from odaf.studies.ledger import Ledger
from odaf.training.progress import Silent


def test_a_record_and_its_line(tmp_path: Path) -> None:
    ledger = Ledger(generators_study.STUDY, tmp_path)
    job = next(job for job in ledger.study.jobs() if job.name == "hopper-random")
    small = Recording("hopper-random", transitions=300)
    record = small.do(tmp_path, Silent())
    assert record["origin"] == "locally generated data" and record["environment"]["id"] == "Hopper-v4"
    assert record["transitions_per_second"] == pytest.approx(300 / record["seconds"])
    with pytest.raises(ConfigError, match="transitions was 300, is 100000"):
        ledger.write(job, record)
    table = generators_study.table([record])
    assert "locally generated data" in table and "| hopper-medium | | | | | | | | | | no policy shipped | | |" in table
    figures = record["statistics"]
    assert f"| {figures['mean']:,.1f} ± {figures['std']:,.1f} | | | {figures['normalised_mean']:.1f} " in table


def test_a_set_that_is_not_accepted_says_why():
    checks = [
        {"figure": "normalised_mean", "value": 9.0, "lowest": 41.3, "highest": 47.3, "passed": False},
        {"figure": "std", "value": 1.0, "lowest": 0.0, "highest": 568.425, "passed": True},
    ]
    record = {
        "name": "hopper-medium",
        "edition": 1,
        "environment": {"id": "Hopper-v4"},
        "statistics": {
            "environment": "Hopper-v4",
            "whole_episodes": 3,
            "mean": 272.6,
            "std": 1.0,
            "normalised_mean": 9.0,
        }
        | {"terminal_row_share": 0.004},
        "acceptance": {"passed": False, "checks": checks},
        "findings": [{"finding": "acceptance-failed", "count": 1, "message": "normalised_mean is 9"}],
        "transitions_per_second": 5000.0,
        "processor_seconds": 10.0,
    }
    table = generators_study.table([record])
    assert (
        "| hopper-medium | 1 | Hopper-v4 | 3 | 272.6 ± 1.0 | 378.9 | 568.4 | 9.0 | 41.3 to 47.3 | 0.0040 | no | 5,000 "
        "| 10,000 |" in table
    )
    assert "- `hopper-medium`: normalised_mean is 9" in table


def test_the_print_of_policies_covers_what_they_do_and_not_their_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    from odaf.environments import shipped_policies

    def print_with(change) -> str | None:
        logs.policies_print.cache_clear()
        with monkeypatch.context() as patch:
            patch.setattr(shipped_policies, "shipped", lambda task, edition: change(whole(task, edition)))
            return logs.policies_print("hopper-medium")

    whole = shipped_policies.shipped
    today = logs.policies_print("hopper-medium")
    assert print_with(lambda policies: replace(policies, facts={**policies.facts, "training": "better told"})) == today
    assert print_with(lambda policies: replace(policies, medium=replace(policies.medium, spread=0.5))) != today
    assert print_with(lambda policies: replace(policies, replay=policies.replay[1:])) != today
    assert print_with(lambda policies: replace(policies, medium=None)) is None
    logs.policies_print.cache_clear()
    assert [name for name in NAMES if logs.policies_print(name) == "none"] == [
        "halfcheetah-random",
        "hopper-random",
        "walker2d-random",
    ]


def test_records_of_other_policies_are_stale(tmp_path: Path) -> None:
    recording = Recording("hopper-medium")
    today = logs.policies_print("hopper-medium")
    for mark, version, same in ((today, 3, True), ("0" * 64, 3, False), (today, 2, False), (today, None, False)):
        record = {"policies_sha256": mark, "statistics": {"transitions": 100_000}, "seed": 0}
        record |= {} if version is None else {"identity": {"version": version}}
        recorded = recording.unrecorded() | recording.recorded(record, {})
        assert (recorded == recording.identity()) == same


def test_an_ant_maze_is_recorded_with_its_figures_and_where_its_rows_are(tmp_path: Path) -> None:
    ledger = Ledger(generators_study.STUDY, tmp_path)
    job = next(job for job in ledger.study.jobs() if job.name == "antmaze-umaze")
    small = AntMazeRecording("antmaze-umaze", transitions=8)
    record = small.do(tmp_path, Silent())
    assert small.recorded(record, {}) == small.identity() and record["acceptance"]["passed"] is None
    with pytest.raises(ConfigError, match="transitions was 8, is 100000"):
        ledger.write(job, record)
    counts = np.array(record["coverage"]["rows"])
    assert counts.shape == (12, 12) and counts.sum() == 8 and record["coverage"]["low"] == [-2.0, -2.0]
    assert counts[:4, :4].sum() == 8, "in the start's cell, the upper left one"
    table = generators_study.table([record])
    assert "| antmaze-umaze | 8 | 0 | | | | | 14% | | unknown |" in table
    walked = {"whole_walks": 25, "reached_share": 0.8, "flipped_share": 0.1, "goal_walks": 20, "shortest_walk": 90}
    figures = record["statistics"] | walked | {"steps_to_goal": 180.4}
    assert "| antmaze-umaze | 8 | 25 | 80% | 180 | 10% | 20 | 14% | 90 | unknown |" in generators_study.table(
        [record | {"statistics": figures}]
    )
    ant_maze_recordings.figure([record], tmp_path / "coverage.png")
    assert (tmp_path / "coverage.png").read_bytes().startswith(b"\x89PNG")
