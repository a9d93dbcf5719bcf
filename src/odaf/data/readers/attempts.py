"""Positions in a maze told as attempts at one goal.

Recordings that go on where a goal was reached, with a new one, hold attempts at many goals. Told for one goal, an
attempt ends where it comes near it. What follows is left out until the robot has gone away again, so that standing at
the goal makes no episodes of single rows; from there on it is a further attempt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from odaf.data.log import Column, Log
from odaf.data.readers.columns import Kept
from odaf.errors import DatasetError

AWAY = 4.0  # radii of the goal beyond which a robot that was there begins anew


@dataclass(frozen=True)
class Attempts:
    """M of the N recorded rows, in their order.

    Attributes:
        rows: [M] their numbers.
        reached: [M] whether the goal is near after the row; it ends its attempt.
        number: [M] of the attempt, from 0.
    """

    rows: np.ndarray
    reached: np.ndarray
    number: np.ndarray


def attempts_at(
    goal: np.ndarray, radius: float, before: np.ndarray, after: np.ndarray, episode: np.ndarray
) -> Attempts:
    """Recorded rows as attempts at one goal.

    Args:
        goal: [2] metres.
        radius: how near counts as there.
        before: [N, 2] positions before each row's action.
        after: [N, 2] those after it.
        episode: [N] ids, equal for rows of one recorded episode.
    """
    near = np.linalg.norm(after - goal, axis=1) <= radius
    distance = np.linalg.norm(before - goal, axis=1)
    starts = np.flatnonzero(np.r_[True, episode[1:] != episode[:-1]])
    arrivals, away = np.flatnonzero(near), np.flatnonzero(distance > AWAY * radius)
    pieces: list[tuple[int, int]] = []
    for first, end in zip(starts.tolist(), np.r_[starts[1:], len(episode)].tolist(), strict=True):
        row = first if distance[first] > radius else _next(away, first)
        while row < end:
            arrival = _next(arrivals, row)
            pieces.append((row, min(arrival + 1, end)))
            row = _next(away, arrival + 1)
    lengths = [end - row for row, end in pieces]
    rows = np.concatenate([np.arange(row, end) for row, end in pieces] or [np.arange(0)])
    return Attempts(rows, near[rows], np.repeat(np.arange(len(pieces)), lengths))


def told_for_goal(log: Log, goal: Sequence[float], radius: float, before: Column, after: Column) -> Log:
    """The log as attempts at one goal: the row after which it is near earns 1 and ends the task, all others earn 0.

    Args:
        log: with an `episode` column; rewards and ends that it has are left out.
        goal: (x, y), metres.
        radius: how near counts as there.
        before: [N, 2] positions before each row's action.
        after: [N, 2] those after it.

    Raises:
        DatasetError: `goal` or `radius` makes no sense, or all of the log is at the goal.
    """
    centre = goal_of(log.source, goal, radius)
    here, there = (np.asarray(column[:], np.float64).reshape(len(log), -1)[:, :2] for column in (before, after))
    told = attempts_at(centre, radius, here, there, np.asarray(log.columns["episode"][:]))
    if not len(told.rows):
        raise DatasetError(f"{log.source}: goal={goal!r}: no row begins away from it; give the place of another goal")
    last = np.r_[told.number[1:] != told.number[:-1], True]
    left_out = len(log) - len(told.rows)
    message = (
        f"rewards are 1 where the next position is within {radius:g} of {centre.tolist()}, which ends the task, and 0 "
        f"elsewhere; {left_out:,} rows that began there are left out"
    )
    return replace(
        log,
        columns={
            **{name: Kept(column, told.rows) for name, column in log.columns.items()},
            "rewards": told.reached.astype(np.float32),
            "terminated": told.reached,
            "truncated": last & ~told.reached,
            "episode": told.number,
        },
        infos={name: Kept(column, told.rows) for name, column in log.infos.items()},
        provenance={**log.provenance, "goal": centre.tolist(), "goal_radius": radius},
        findings=(
            *log.findings,
            {"finding": "rewards-from-goal", "count": int(told.reached.sum()), "message": message},
        ),
        row_numbers=told.rows if log.row_numbers is None else np.asarray(log.row_numbers)[told.rows],
    )


def goal_of(source: str, goal: Sequence[float], radius: float) -> np.ndarray:
    """[2] float64; `DatasetError` where `goal` is no place, or `radius` no distance."""
    try:
        centre = np.array(goal, np.float64)
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{source}: goal={goal!r}: give two numbers, (x, y)") from error
    if centre.shape != (2,) or not np.isfinite(centre).all() or not radius > 0:
        raise DatasetError(
            f"{source}: goal={goal!r} and goal_radius={radius}: give two numbers, (x, y), and a radius above 0"
        )
    return centre


def _next(numbers: np.ndarray, row: int) -> int:
    """The first of ascending `numbers` that is at least `row`; one that no row has, where there is none."""
    place = int(np.searchsorted(numbers, row))
    return int(numbers[place]) if place < len(numbers) else np.iinfo(np.int64).max - 1
