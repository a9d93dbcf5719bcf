"""Whether the rows of each episode stand in time order, and where time leaps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import polars as pl

from odaf.data.validation import RowNumbers, name_rows
from odaf.errors import DatasetError

OnGap = Literal["error", "break"]

# A step longer than this many usual steps is a gap: rows are missing there.
GAP = 1.5
# Episodes whose usual steps differ by more than this share were not sampled at one rate.
RATE_TOLERANCE = 0.1


@dataclass(frozen=True)
class Clock:
    """What the time column says.

    Attributes:
        gaps: [rows] bool, true where rows are missing between this row and the next of the same episode.
        time_step: the usual step, in the units of the time column; None where no episode has two rows.
        findings: in the form of `Dataset.provenance["findings"]`.
    """

    gaps: np.ndarray
    time_step: float | None
    findings: tuple[dict[str, Any], ...]


def sorted_rows(keys: Sequence[np.ndarray]) -> np.ndarray:
    """[rows] the order in which `keys`, the most important first, ascend; equal rows stay as they are."""
    return np.lexsort(tuple(reversed(keys)))


def first_rows(episode: np.ndarray | None, ends: np.ndarray | None, rows: int) -> np.ndarray:
    """[rows] bool: where an episode begins, told from ids where there are any, else from the rows that end one."""
    first = np.zeros(rows, bool)
    first[:1] = True
    if episode is not None:
        first[1:] = episode[1:] != episode[:-1]
    elif ends is not None:
        first[1:] = ends[:-1]
    return first


def refuse_scattered(
    source: str, column: str, episode: np.ndarray, numbers: RowNumbers, remedies: Sequence[str]
) -> None:
    """Raises where an episode id comes back after another one."""
    starts = np.flatnonzero(first_rows(episode, None, len(episode)))
    ids, counts = np.unique(episode[starts], return_counts=True)
    if (counts > 1).any():
        again = ids[counts > 1][0]
        blocks = [str(int(numbers[int(row)])) for row in starts[episode[starts] == again]]
        raise DatasetError(
            f"{source}: column '{column}': id {again!s} comes back after other ids: it begins in rows "
            f"{', '.join(blocks[:5])}{', ...' if len(blocks) > 5 else ''} ({int((counts > 1).sum())} of {len(ids)} ids "
            "do so)",
            remedies=remedies,
        )


def read_clock(
    source: str,
    column: str,
    time: np.ndarray,
    first: np.ndarray,
    numbers: RowNumbers,
    *,
    time_step: float | None,
    on_gap: OnGap,
    remedies: Sequence[str],
    cut: np.ndarray | None = None,
) -> Clock:
    """The usual step and the gaps of each episode.

    Args:
        source: how messages name the table.
        column: the name of the time column.
        time: [rows] float64.
        first: [rows] bool, where episodes begin.
        numbers: [rows] the rows' numbers in the source.
        time_step: the usual step; None takes the median of each episode.
        on_gap: what a gap is: a mistake, or the end of an episode.
        remedies: what to do where time does not ascend.
        cut: [rows] bool, after which rows the episode was cut already; there is no gap to tell of.

    Raises:
        DatasetError: time stands still or goes back inside an episode, or there is a gap and that is a mistake.
    """
    step = np.diff(time, append=np.inf)
    inside = np.append(~first[1:], False)  # the next row belongs to the same episode
    wrong = np.append(False, (inside & (step <= 0.0))[:-1])
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        fact = "time stands still" if time[row] == time[row - 1] else "time goes back"
        raise DatasetError(
            f"{source}: column '{column}': {fact} inside an episode in {name_rows(wrong, numbers)} "
            f"({time[row - 1]:.15g}, then {time[row]:.15g})",
            remedies=remedies,
        )
    if not inside.any():
        return Clock(np.zeros(len(time), bool), time_step, ())
    medians = _medians(np.cumsum(first)[inside], step[inside])
    usual = np.full(len(time), np.inf)
    usual[inside] = medians if time_step is None else time_step
    gaps = inside & (step > GAP * usual)
    if cut is not None:
        gaps &= ~cut
    findings: list[dict[str, Any]] = []
    if gaps.any():
        row = int(np.flatnonzero(gaps)[0])
        largest = float(step[gaps].max())
        text = (
            f"after {name_rows(gaps, numbers)}; there the next row is {step[row]:.6g} later, "
            f"usual is {usual[row]:.6g}, the longest gap is {largest:.6g}"
        )
        if on_gap == "error":
            raise DatasetError(
                f"{source}: column '{column}': rows are missing {text}",
                remedies=[
                    'pass on_gap="break" to end the episode at each gap',
                    "time_step= if the rows were not meant to be evenly spaced",
                ],
            )
        findings.append(_finding("time-gaps", gaps, f"episodes were ended where rows are missing: {text}"))
    common = float(np.median(medians)) if time_step is None else time_step
    uneven = np.zeros(len(time), bool)
    uneven[inside] = np.abs(medians - common) > RATE_TOLERANCE * common
    if uneven.any():
        low, high = float(medians.min()), float(medians.max())
        findings.append(
            _finding(
                "uneven-sampling",
                uneven,
                f"the usual step differs between episodes, from {low:.6g} to {high:.6g}, so equal actions do not have "
                f"equal effects; off the commonest, {common:.6g}, are the episodes of {name_rows(uneven, numbers)}",
            )
        )
    return Clock(gaps, common, tuple(findings))


def _medians(episode: np.ndarray, step: np.ndarray) -> np.ndarray:
    """[steps] the median step of the episode that each step belongs to."""
    frame = pl.DataFrame({"episode": episode, "step": step})
    return frame.select(pl.col("step").median().over("episode")).to_series().to_numpy()


def _finding(name: str, mask: np.ndarray, message: str) -> dict[str, Any]:
    return {"finding": name, "count": int(mask.sum()), "message": message}
