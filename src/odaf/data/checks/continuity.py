"""Checks that a row follows from the one before it: no jumps inside an episode, successors that are the next row."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.stream import Block, Facts, Tally, any_column

JUMP = 10.0
"""Steps larger than this many times the 99th percentile of the column's steps are jumps: some 25 standard deviations
where steps are Gaussian, while columns that often move a long way at once stay below it."""
FEWEST_STEPS = 100
FEW_BETWEEN = 0.5
"""Where more than this share as many steps lie between half of `JUMP` and it, the column only has a long tail."""


class Jumps:
    """Observation steps inside an episode that are far larger than the column's usual ones."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._tally = Tally()
        self._usual: np.ndarray | None = None
        self._columns: set[int] = set()
        self._largest = 0.0
        self._between = 0
        self._together = False  # whether half of the columns ever jumped at once

    def see(self, block: Block) -> None:
        values = block.with_before("observations")
        goes_on, first = block.pairs()
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.abs(np.diff(values.astype(np.float32, copy=False), axis=0))
        if self._usual is None:
            self._usual = self._percentile(steps[goes_on])
            if self._usual is None:
                return
        largest = np.fmax.reduce(steps, axis=0) if len(steps) else np.zeros(self._facts.obs_dim)
        suspects = np.flatnonzero((largest > JUMP / 2 * self._usual) & (self._usual > 0))
        if not len(suspects):
            return
        ratios = steps[:, suspects] / self._usual[suspects]
        inside = goes_on[:, None] & np.isfinite(ratios)
        far = (ratios > JUMP) & inside
        self._between += int(np.count_nonzero(any_column((ratios > JUMP / 2) & inside) & ~any_column(far)))
        if far.any():
            self._together |= bool((2 * far.sum(axis=1) >= np.count_nonzero(self._usual > 0)).any())
            self._columns |= set(suspects[far.any(axis=0)].tolist())
            self._largest = max(self._largest, float(ratios[far].max()))
            self._tally.add(any_column(far), first)

    @staticmethod
    def _percentile(steps: np.ndarray) -> np.ndarray | None:
        """[columns] 99th percentile of the first block's steps; None where there are too few to tell."""
        steps = steps[np.isfinite(steps).all(axis=1)]
        if len(steps) < FEWEST_STEPS:
            return None
        place = min(int(np.ceil(0.99 * len(steps))), len(steps) - 1)
        return np.partition(steps, place, axis=0)[place]

    def findings(self) -> list[Finding]:
        if not self._tally.count or self._between > FEW_BETWEEN * self._tally.count:
            return []
        columns = sorted(self._columns)
        return [
            Finding(
                "jump", "warning" if self._together else "note", "observations", self._tally.count,
                tuple(self._tally.rows),
                f"{self._tally.count:,} steps inside episodes are up to {self._largest:.0f} times as large as 99 % of "
                f"the others (columns {columns[:8]})",
                "look at these rows: a missing end flag, a reset, or a sensor that dropped out; mark the end, "
                "or leave the episode out. A hit that turns a speed around does no harm",
            )
        ]  # fmt: skip


class Successors:
    """Stored next observations that are not what the next row of the episode starts from."""

    TOLERANCE = 1e-4

    def __init__(self, facts: Facts):
        self._facts = facts
        self._tally, self._before_last = Tally(), Tally()
        self._compared = self._episodes = 0
        self._largest = 0.0
        self._pending = False  # whether the step into the last row seen differs

    def see(self, block: Block) -> None:
        stored = block.with_before("next_observations")[:-1]
        goes_on, first = block.pairs()
        following = block.columns["observations"][1 - bool(block.before) :]
        self._compared += int(np.count_nonzero(goes_on))
        self._episodes += int(np.count_nonzero(block.starts))
        if self._pending and block.starts[0]:
            self._before_last.row(first - 2)
        with np.errstate(over="ignore", invalid="ignore"):
            apart = np.abs(stored - following)
            rows = any_column(apart > self.TOLERANCE + 1e-5 * np.abs(following)) & goes_on
        self._pending = bool(len(rows) and rows[-1])
        if not rows.any():
            return
        self._largest = max(self._largest, float(np.nanmax(apart[rows])))
        self._tally.add(rows, first - 1)
        starts = block.starts[1 - bool(block.before) :]
        self._before_last.add(rows & np.append(starts[1:], False), first - 1)

    def findings(self) -> list[Finding]:
        if not self._tally.count:
            return []
        late = self._before_last
        if late.count >= max(3, 0.5 * self._tally.count) and 2 * late.count >= self._episodes - 1:
            return [
                Finding(
                    "ends-late", "warning", "next_observations", late.count, tuple(late.rows),
                    f"{late.count:,} of {self._episodes:,} episodes end with the first row of another: the successor "
                    "stored in the row before is not it",
                    "end flags stand one row late: move each to the row before",
                )
            ]  # fmt: skip
        share = self._tally.count / max(self._compared, 1)
        return [
            Finding(
                "successor-differs", "warning", "next_observations", self._tally.count, tuple(self._tally.rows),
                f"{share:.2%} of the stored successors differ from the next observation, by up to {self._largest:.4g}",
                "they are used as stored; check that no end flag is missing there, or drop the column to use next rows",
            )
        ]  # fmt: skip
