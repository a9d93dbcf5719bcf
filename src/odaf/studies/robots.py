"""The robots' logs and methods that several studies share, recorded here or read from public files."""

from functools import cache
from pathlib import Path
from typing import Any

from odaf.runs import presets
from odaf.studies.logs import MixedLog, RecordedLog
from odaf.studies.public_logs import PublicLog, PublicMixture
from odaf.studies.task import Evaluation, Task

ROBOTS = ("hopper", "halfcheetah", "walker2d")
KINDS = ("random", "medium", "medium-replay", "medium-expert", "expert")
ROWS, LOG_SEED = 100_000, 2
"""Of logs made here. No setting was tried on a log of that seed."""

Changes = tuple[tuple[str, Any], ...]
Method = tuple[str, Changes]


def robot_task(
    robot: str, kind: str, evaluation: Evaluation, rows: int = ROWS, data: Path | None = None, percent: int = 80
) -> Task:
    """A robot to be steered, learned from a log.

    Args:
        robot: one of `ROBOTS`.
        kind: one of `KINDS`, or "mixture" of an expert's rows and random ones.
        evaluation: how policies are tried.
        rows: of a log made here; a public file is taken whole, a mixture of public files has a million.
        data: directory of public files; None records the log here.
        percent: random rows of a mixture.
    """
    if kind == "mixture":
        log = MixedLog(robot, percent, rows, LOG_SEED) if data is None else PublicMixture(data, robot, percent)
    else:
        log = RecordedLog(f"{robot}-{kind}", rows, LOG_SEED) if data is None else PublicLog(data, f"{robot}-{kind}")
    return Task(log, evaluation, score="normalised_score")


def robot_form(preset: str, task: Task) -> Changes:
    """A preset's values for the robot, where the task itself has none, as a mixture: those that all its sets share."""
    known = _known(preset)
    if task.log.known_as in known:
        return ()
    robot = task.log.known_as.split("-")[0]
    sets = [values for name, values in known.items() if name.startswith(f"{robot}-") and not name.endswith("-attack")]
    return tuple((field, value) for field, value in (sets[0] if sets else {}).items() if all(
        other.get(field) == value for other in sets
    ))  # fmt: skip


@cache
def _known(preset: str) -> dict[str, dict[str, Any]]:
    return presets.tasks(preset)
