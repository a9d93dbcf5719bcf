"""Resets that no flag announces: steps inside episodes that are no steps."""

import numpy as np

from odaf.data.checks import surprise
from odaf.data.checks.findings import Finding
from odaf.data.checks.late_ends import FlagsThatStay, LateEnds
from odaf.data.checks.stream import Block, Facts, Tally

PIECE = 4_096
WARM_UP = 10_000
"""Rows from which it is learned what steps usually are, before any row is judged."""
LEVELS = (2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0, 20.0, 30.0)
GAP, FEW_BETWEEN = 1.5, 0.35
"""Steps above a level are leaps if there are at most this share as many between the level divided by GAP and the level:
where steps merely have a long tail, more lie below any level than above it. A leap that follows one counts as lying
below: a plant that rests most of the time and moves fast in between leaps many times in a row, a reset once."""
SURE, SURE_GAP = 3.0, 1.6
"""The same for fewer than `FEWEST` leaps: nothing at all may lie between."""
FEWEST = 5
SINGLE = 2.0
"""Levels are this much higher where only one column tells anything."""


class MisplacedEnds:
    """Ends of episodes that are missing or in the wrong place, by what steps usually are in this log."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._waiting: list[Block] = []
        self._warm = False
        self._scale: surprise.Surprise | None = None
        self._velocity: np.ndarray | None = None
        self._into = 0.0  # surprise of the step into the last row seen
        self._episodes = 0
        self._leaps, self._late, self._stays = Leaps(), LateEnds(), FlagsThatStay(facts)

    def see(self, block: Block) -> None:
        self._episodes += int(np.count_nonzero(block.starts))
        if self._warm:
            for piece in block.pieces(PIECE):
                self._judge(piece)
            return
        self._waiting.append(block)
        if sum(map(len, self._waiting)) >= WARM_UP:
            self._begin()

    def _begin(self) -> None:
        """Learns what is usual from the rows that wait, and judges them."""
        self._warm = True
        rows = np.concatenate([block.columns["observations"] for block in self._waiting])[:WARM_UP]
        actions = np.concatenate([self._actions(block, False) for block in self._waiting])[:WARM_UP]
        starts = np.concatenate([block.starts for block in self._waiting])[:WARM_UP]
        self._scale = surprise.fit(rows, actions, ~starts[1:])
        for block in self._waiting:
            for piece in block.pieces(PIECE):
                self._judge(piece)
        self._waiting = []

    def _actions(self, block: Block, with_before: bool) -> np.ndarray:
        if "actions" not in block.columns:
            return np.zeros((len(block) + (with_before and bool(block.before)), 0))
        return block.with_before("actions") if with_before else block.columns["actions"]

    def _judge(self, block: Block) -> None:
        scale, lead = self._scale, bool(block.before)
        if scale is None:
            self._stays.see(block, None)
            return
        with np.errstate(invalid="ignore", over="ignore"):
            rows = scale.scaled(block.with_before("observations"))
            starts = np.append(True, block.starts) if lead else block.starts  # of each row in `rows`
            velocity = np.zeros_like(rows)
            velocity[1:] = np.where(starts[1:, None], 0.0, np.diff(rows, axis=0))
            if lead and self._velocity is not None:
                velocity[0] = self._velocity
            steps = scale.of(rows[:-1], self._actions(block, True)[:-1], velocity[:-1], rows[1:])
            into = np.append(self._into, np.where(starts[1:], 0.0, steps))
            self._leaps.add(into, block.first - lead)
            self._late.see(block, scale, rows, velocity, into, starts)
            self._stays.see(block, scale.distance(rows[:-1], rows[1:]))
        self._velocity, self._into = velocity[-1], float(into[-1])

    def findings(self) -> list[Finding]:
        if not self._warm:
            self._begin()
        found = self._stays.findings(self._episodes)
        if self._scale is not None:
            found = (self._late.findings() or self._leaps.findings(len(self._scale.columns))) + found
        return found


class Leaps:
    """Counts surprises above each of some levels, and how many lie just below it."""

    def __init__(self):
        self._above = {level: Tally() for level in LEVELS}
        self._below = dict.fromkeys(LEVELS, 0)  # between the level divided by GAP and the level
        self._well_below = dict.fromkeys(LEVELS, 0)  # the same with SURE_GAP

    def add(self, into: np.ndarray, first: int) -> None:
        """Takes in the surprises of the steps into rows, the first of which was counted before."""
        before, into = into[:-1], into[1:]
        for level in LEVELS:
            above, after_leap = into > level, before > level / GAP
            self._above[level].add(above & ~after_leap, first + 1)
            repeated = int(np.count_nonzero(above & after_leap))
            self._below[level] += int(np.count_nonzero((into > level / GAP) & ~above)) + repeated
            self._well_below[level] += int(np.count_nonzero((into > level / SURE_GAP) & ~above)) + repeated

    def level(self, columns: int) -> float | None:
        """The lowest level that parts leaps from steps; None where none does."""
        least = SINGLE if columns == 1 else 1.0
        for level in LEVELS:
            leaps = self._above[level].count
            if leaps >= FEWEST and level >= LEVELS[0] * least and self._below[level] <= FEW_BETWEEN * leaps:
                return level
            if 0 < leaps < FEWEST and level >= SURE * least and self._well_below[level] == 0:
                return level
        return None

    def findings(self, columns: int) -> list[Finding]:
        """What was found, by so many columns."""
        level = self.level(columns)
        if level is None:
            return []
        tally = self._above[level]
        return [
            Finding(
                "reset-unmarked", "warning", "observations", tally.count, tuple(tally.rows),
                f"{tally.count:,} jumps inside episodes go where no step leads, as a reset does that no end flag "
                "announces",
                "mark the row before each as the last of its episode (or give episodes ids), or rows of two episodes "
                "are learned as one step",
            )
        ]  # fmt: skip
