"""Plans: choosing a part of one, the order of trainings, and plans that cannot be."""

import pytest

from odaf.errors import ConfigError
from odaf.studies.job import chosen, labels_of
from odaf.studies.logs import MazeLog
from odaf.studies.registry import STUDIES
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of
from studies.toy import job, study

TOY = study([job("a", kind="red"), job("b", kind="blue")], [job("c", "a", kind="red")])


def names(jobs) -> list[str]:
    return [one.name for one in jobs]


def test_a_part_of_a_plan() -> None:
    assert names(chosen(TOY)) == ["a", "b", "c"]
    assert names(chosen(TOY, phase=[2])) == ["c"]
    assert names(chosen(TOY, only=["red"])) == ["a", "c"]
    assert names(chosen(TOY, only=["red", "blue"])) == ["a", "b", "c"]  # words of one kind widen
    assert names(chosen(TOY, only=["red", "c", "b"])) == ["c"]  # words of two kinds narrow
    assert labels_of(TOY.jobs()) == {"kind": ["red", "blue"], "name": ["a", "b", "c"]}


def test_what_is_not_in_the_plan_is_refused() -> None:
    with pytest.raises(ConfigError, match="--phase 3: toy has phases 1 to 2"):
        chosen(TOY, phase=[3])
    with pytest.raises(ConfigError, match="--phase 0"):
        chosen(TOY, phase=[0])
    with pytest.raises(ConfigError, match="--only green: .* known are a, b, blue, c, red"):
        chosen(TOY, only=["green"])


def test_a_plan_that_cannot_be_is_a_defect() -> None:
    with pytest.raises(ValueError, match="two jobs are called a"):
        study([job("a"), job("a")]).jobs()
    with pytest.raises(ValueError, match="b comes after"):
        study([job("b", "a"), job("a")]).jobs()


def test_a_comparison_is_complete_before_the_next_seed_begins() -> None:
    one, other = (Task(MazeLog(maze), Evaluation()) for maze in ("stitch", "shaft"))
    runs = [Training(preset, task, seed, 5) for task in (one, other) for preset in ("odaf", "sac-n") for seed in (0, 1)]
    first, second = phases_of(("short", runs), ("long", [Training("odaf", one, 0, 9), Training("odaf", one, 0, 7)]))
    assert names(first.jobs) == [
        "stitch-odaf-seed0-5", "stitch-sac-n-seed0-5", "shaft-odaf-seed0-5", "shaft-sac-n-seed0-5",
        "stitch-odaf-seed1-5", "stitch-sac-n-seed1-5", "shaft-odaf-seed1-5", "shaft-sac-n-seed1-5",
    ]  # fmt: skip
    assert [(one.name, one.after) for one in second.jobs] == [  # a longer one goes on where the shorter ones stopped
        ("stitch-odaf-seed0-7", ("stitch-odaf-seed0-5",)),
        ("stitch-odaf-seed0-9", ("stitch-odaf-seed0-5", "stitch-odaf-seed0-7")),
    ]
    assert first.jobs[0].after == ()


@pytest.mark.parametrize("name", STUDIES)
def test_every_plan_holds_together(name: str) -> None:
    jobs = STUDIES[name].jobs()
    assert len(jobs) > 2
    lines: dict[str, dict[str, float]] = {}
    for one in jobs:  # what shares a directory is never under way twice, and grows
        line = one.do.line
        if line is not None:
            before = lines.setdefault(line, {})
            assert set(before) <= set(one.after)
            assert one.do.amount > max(before.values(), default=0.0)
            before[one.name] = one.do.amount
