"""Transitions and episodes that are in the log twice."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.hashing import BoundedHashes, hash_rows, mix
from odaf.data.checks.stream import Block, Facts

COLUMNS = ("observations", "actions", "rewards", "next_observations")
WARN_SHARE = 1e-3


class Duplicates:
    """Exact repeats of (observation, action, reward, next observation), and of whole episodes of two steps or more."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._columns = [name for name in COLUMNS if name in facts.fields]
        self._rows, self._episodes = BoundedHashes(), BoundedHashes()
        self._sum, self._start, self._place = np.uint64(0), 0, 0

    def see(self, block: Block) -> None:
        hashes = mix(hash_rows([block.columns[name] for name in self._columns]))
        self._rows.add(hashes, np.arange(block.first, block.first + len(block)))
        self._take_episodes(hashes, block)

    def _take_episodes(self, hashes: np.ndarray, block: Block) -> None:
        """An episode's hash is the sum over its rows of the row's hash mixed with its place, so order counts."""
        begins = np.flatnonzero(block.starts)
        places = np.arange(len(block), dtype=np.int64) + self._place
        for_each = np.searchsorted(begins, np.arange(len(block)), side="right")
        known = for_each > 0
        places[known] = np.flatnonzero(known) - begins[for_each[known] - 1]
        terms = mix(hashes + places.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15))
        edges = begins if len(begins) and begins[0] == 0 else np.append(0, begins)
        sums = np.add.reduceat(terms, edges)
        if len(begins) and begins[0] == 0:
            if block.first > 0:
                self._close(np.array([self._sum]), np.array([self._start]), np.array([block.first - self._start]))
            starts = begins + block.first
        else:
            sums[:1] += self._sum  # an array of one: scalars warn where the sum wraps around, as it should
            starts = np.append(self._start, begins + block.first)
        lengths = np.diff(np.append(starts, block.first + len(block)))
        self._close(sums[:-1], starts[:-1], lengths[:-1])
        self._sum, self._start = sums[-1], int(starts[-1])
        self._place = block.first + len(block) - self._start

    def _close(self, sums: np.ndarray, starts: np.ndarray, lengths: np.ndarray) -> None:
        longer = lengths > 1
        self._episodes.add(mix(sums[longer] + lengths[longer].astype(np.uint64)), starts[longer])

    def findings(self) -> list[Finding]:
        self._close(np.array([self._sum]), np.array([self._start]), np.array([self._facts.rows - self._start]))
        found = []
        rows, episodes = self._rows.repeated(), self._episodes.repeated()
        if rows.count:
            share = rows.count / self._facts.rows
            about = "about " if rows.estimated else ""
            found.append(
                Finding(
                    "duplicate-transitions", "warning" if share >= WARN_SHARE else "note", "", rows.count,
                    tuple(rows.rows),
                    f"{about}{share:.2%} of the transitions are exact copies of an earlier one",
                    "if the same recording was appended twice, leave one out: copies count double in learning, "
                    "and leak from the training part into the hold-out",
                )
            )  # fmt: skip
        if episodes.count:
            about = "about " if episodes.estimated else ""
            found.append(
                Finding(
                    "duplicate-episodes", "warning", "", episodes.count, tuple(episodes.rows),
                    f"{about}{episodes.count:,} whole episodes are exact copies of an earlier one (their first rows)",
                    "leave the copies out before splitting, or the hold-out part is no test",
                )
            )  # fmt: skip
        return found
