"""Where episodes begin and end, and what each end means."""

from typing import Any

import numpy as np

from odaf.data.validation import RowNumbers, name_rows, number_of
from odaf.errors import DatasetError


def complete(
    source: str,
    columns: dict[str, np.ndarray],
    episode: np.ndarray | None,
    findings: list[dict[str, Any]],
    row_numbers: RowNumbers | None = None,
) -> np.ndarray:
    """Fills in the missing columns so that every episode ends in exactly one way; returns the first rows [E] int64.

    Changes `columns` (which the caller owns): adds `terminated`, `truncated` and `next_observations` where absent, and
    drops last rows whose successor nobody logged. Each change is appended to `findings` with its count and its
    rows, as `row_numbers` calls them.
    """
    rows = len(columns["observations"])
    flags_given = "terminated" in columns or "truncated" in columns
    terminated = columns.setdefault("terminated", np.zeros(rows, bool))
    truncated = columns.setdefault("truncated", np.zeros(rows, bool))

    both = terminated & truncated
    if both.any():
        columns["truncated"] = truncated = truncated & ~terminated
        findings.append(
            _finding("terminated-and-truncated", both, row_numbers, "rows marked as both ends count as terminated")
        )

    if episode is None:
        starts = _starts_from_flags(source, terminated, truncated, flags_given)
    else:
        starts = _starts_from_ids(source, episode, row_numbers)
        _refuse_ends_inside(source, starts, terminated, truncated, row_numbers)

    last = _last_rows(starts, rows)
    unfinished = last & ~terminated & ~truncated
    if unfinished.any():
        columns["truncated"] = truncated = truncated | unfinished
        findings.append(
            _finding(
                "unfinished-episodes",
                unfinished,
                row_numbers,
                "episodes that stop without an end flag count as truncated",
            )
        )

    if "next_observations" not in columns:
        return _shift(source, columns, starts, findings, row_numbers)
    mismatch = ~last
    mismatch[:-1] &= (columns["next_observations"][:-1] != columns["observations"][1:]).any(axis=1)
    if mismatch.any():
        findings.append(
            _finding(
                "successor-differs-from-next-row",
                mismatch,
                row_numbers,
                "the logged next observation is not the one the next row of the episode starts from; used as logged",
            )
        )
    return starts


def check_starts(source: str, episode_starts: Any, rows: int) -> np.ndarray:
    """`episode_starts` as [E] int64; raises unless it ascends from 0 and stays below `rows`."""
    starts = np.asarray(episode_starts)
    if starts.ndim != 1 or starts.dtype.kind not in "iu" or len(starts) == 0:
        raise DatasetError(
            f"{source}: field 'episode_starts' must be [episodes] whole numbers, at least one; "
            f"got shape {starts.shape} of {starts.dtype}"
        )
    starts = starts.astype(np.int64)
    if starts[0] != 0:
        raise DatasetError(
            f"{source}: field 'episode_starts' begins with {starts[0]}; the first episode starts in row 0"
        )
    falling = np.append(False, np.diff(starts) <= 0)
    if falling.any():
        raise DatasetError(
            f"{source}: field 'episode_starts' must ascend, it does not at {name_rows(falling)}; "
            "build the dataset with Dataset.from_arrays(..., episode=ids)"
        )
    if starts[-1] >= rows:
        raise DatasetError(
            f"{source}: field 'episode_starts' names row {starts[-1]}, there are only {rows:,} rows; "
            "the file is cut or its fields come from different datasets"
        )
    return starts


def check_ends(source: str, starts: np.ndarray, terminated: np.ndarray, truncated: np.ndarray) -> None:
    """Raises unless the last row of every episode, and no other, carries exactly one end flag."""
    last = _last_rows(starts, len(terminated))
    remedy = "build the dataset with Dataset.from_arrays, which derives consistent ends"
    for wrong, text in (
        ((terminated | truncated) & ~last, "an episode end is marked inside an episode"),
        (last & ~terminated & ~truncated, "an episode stops without 'terminated' or 'truncated'"),
        (terminated & truncated, "a row is both terminated and truncated"),
    ):
        if wrong.any():
            raise DatasetError(
                f"{source}: fields 'episode_starts', 'terminated' and 'truncated' disagree: "
                f"{text}, {name_rows(wrong)}; {remedy}"
            )


def _starts_from_flags(source: str, terminated: np.ndarray, truncated: np.ndarray, flags_given: bool) -> np.ndarray:
    ends = terminated | truncated
    if not ends.any():
        fact = "no row is marked in 'terminated' or 'truncated'" if flags_given else "no end of an episode was given"
        raise DatasetError(
            f"{source}: {fact}, so episodes cannot be told apart",
            remedies=[
                "pass episode=, the ids (a constant one if all rows are one episode)",
                "pass terminated= or truncated=, which mark the ends",
            ],
        )
    starts = np.append(0, np.flatnonzero(ends) + 1)
    return starts[starts < len(ends)].astype(np.int64)


def _starts_from_ids(source: str, episode: np.ndarray, row_numbers: RowNumbers | None) -> np.ndarray:
    starts = np.append(0, np.flatnonzero(episode[1:] != episode[:-1]) + 1).astype(np.int64)
    ids, counts = np.unique(episode[starts], return_counts=True)
    if (counts > 1).any():
        again = ids[counts > 1][0]
        blocks = [number_of(int(row), len(episode), row_numbers) for row in starts[episode[starts] == again]]
        raise DatasetError(
            f"{source}: field 'episode': id {again!s} appears in {len(blocks)} separate blocks, which start in rows "
            f"{', '.join(map(str, blocks[:5]))}; sort the rows by episode and time, or use unique ids"
        )
    return starts


def _refuse_ends_inside(
    source: str, starts: np.ndarray, terminated: np.ndarray, truncated: np.ndarray, row_numbers: RowNumbers | None
) -> None:
    inside = ~_last_rows(starts, len(terminated))
    for field, flag in (("terminated", terminated), ("truncated", truncated)):
        wrong = flag & inside
        if wrong.any():
            raise DatasetError(
                f"{source}: field '{field}' marks an end inside an episode id, {name_rows(wrong, row_numbers)}; "
                "correct the ids, or leave out episode= to split at the flags"
            )


def _shift(
    source: str,
    columns: dict[str, np.ndarray],
    starts: np.ndarray,
    findings: list[dict[str, Any]],
    row_numbers: RowNumbers | None,
) -> np.ndarray:
    rows = len(columns["observations"])
    last = _last_rows(starts, rows)
    following = np.arange(1, rows + 1)
    following[last] -= 1

    placeholders = last & columns["terminated"]
    if placeholders.any():
        findings.append(
            _finding(
                "terminal-successor-unknown",
                placeholders,
                row_numbers,
                "terminated rows without a logged successor repeat their own observation; nothing learns from it",
            )
        )
    dropped = last & ~columns["terminated"]
    if not dropped.any():
        columns["next_observations"] = columns["observations"][following]
        return starts
    kept = ~dropped
    if not kept.any():
        raise DatasetError(f"{source}: every episode is one row long and none has a successor; pass next_observations=")
    findings.append(
        _finding(
            "dropped-without-successor",
            dropped,
            row_numbers,
            "last rows of truncated episodes dropped: no next observation was logged, their reward is lost too",
        )
    )
    episode = np.cumsum(_first_rows(starts, rows))[kept]
    successors = columns["observations"][following[kept]]
    for field, column in columns.items():
        columns[field] = column[kept]
    columns["next_observations"] = successors
    starts = np.append(0, np.flatnonzero(np.diff(episode)) + 1).astype(np.int64)
    columns["truncated"] = _last_rows(starts, int(kept.sum())) & ~columns["terminated"]
    return starts


def _first_rows(starts: np.ndarray, rows: int) -> np.ndarray:
    mask = np.zeros(rows, bool)
    mask[starts] = True
    return mask


def _last_rows(starts: np.ndarray, rows: int) -> np.ndarray:
    mask = np.zeros(rows, bool)
    mask[np.append(starts[1:], rows) - 1] = True
    return mask


def _finding(name: str, mask: np.ndarray, row_numbers: RowNumbers | None, message: str) -> dict[str, Any]:
    return {"finding": name, "count": int(mask.sum()), "message": f"{message}: {name_rows(mask, row_numbers)}"}
