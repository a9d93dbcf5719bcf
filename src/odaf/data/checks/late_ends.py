"""End flags a row late, successors taken from the next episode, and end flags that stay on."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.stream import FLAGS, Block, Facts, Tally
from odaf.data.checks.surprise import Surprise

LEVEL, CALM = 1.6, 2.5
"""A step into a last row is far above the one level, the step from there into the next episode a usual one below the
other: taken by itself neither says much, but in half of all episodes they do not come together by chance."""
SHARE, FEWEST = 0.5, 4
TIMES = 5.0
"""Far steps must be as many times as common there as elsewhere."""


class LateEnds:
    """Last rows that belong to the next episode, or whose stored successors do."""

    def __init__(self):
        self._last_rows, self._successors = Tally(), Tally()
        self._rolled = self._ends = self._steps = self._far = 0

    def see(
        self,
        block: Block,
        scale: Surprise,
        rows: np.ndarray,
        velocity: np.ndarray,
        into: np.ndarray,
        starts: np.ndarray,
    ) -> None:
        """Takes in a block.

        Args:
            rows: [rows, columns] `scaled` observations, with the row before the block in front where there is one.
            velocity: [rows, columns] the step into each.
            into: [rows] surprise of that step; 0 for the first row of an episode.
            starts: [rows] whether the row begins an episode.
        """
        lead = bool(block.before)
        self._steps += int(np.count_nonzero(~starts[lead:]))
        self._far += int(np.count_nonzero(into[lead:] > LEVEL))
        last = np.flatnonzero(starts[1:])
        if not len(last):
            return
        self._ends += len(last)
        first = block.first - lead
        actions = block.with_before("actions") if "actions" in block.columns else np.zeros((len(rows), 0))
        still = np.zeros((len(last), rows.shape[1]))
        own = (into[last] > LEVEL) & (scale.of(rows[last], actions[last], still, rows[last + 1]) < CALM)
        self._last_rows.add(_marked(len(rows), last[own]), first)
        if "next_observations" not in block.columns:
            return
        stored = block.with_before("next_observations")[last]
        logged = block.with_before("observations")
        after = scale.scaled(stored)
        past = scale.of(rows[last], actions[last], velocity[last], after)
        placeholder = (stored == logged[last]).all(axis=1)
        rolled = (stored == logged[last + 1]).all(axis=1)
        # What was done in a successor that has no row is unknown; the action after it is the best guess.
        goes_on = rolled | (scale.of(after, actions[last + 1], still, rows[last + 1]) < CALM)
        wrong = (past > LEVEL) & ~placeholder & goes_on
        self._successors.add(_marked(len(rows), last[wrong]), first)
        self._rolled += int(np.count_nonzero(wrong & rolled))

    def findings(self) -> list[Finding]:
        usual = self._far / max(self._steps, 1)
        for tally, where in (
            (self._successors, "the successor of their last row"),
            (self._last_rows, "their last row"),
        ):
            share = tally.count / max(self._ends, 1)
            if tally.count < FEWEST or share < SHARE or share < TIMES * usual:
                continue
            remedy = "end flags stand one row late: move each to the row before"
            if tally is self._successors and 2 * self._rolled > tally.count:
                remedy = (
                    "next observations were made by a shift over the ends (numpy.roll), or end flags stand one row "
                    "late: leave next observations out, or move each flag to the row before"
                )
            return [
                Finding(
                    "ends-late", "warning", "observations", tally.count, tuple(tally.rows),
                    f"{tally.count:,} of {self._ends:,} episodes end with a jump: {where} goes on in the next episode",
                    remedy,
                )
            ]  # fmt: skip
        return []


class FlagsThatStay:
    """Rows that are an episode of their own after another one, and go on from the row before as far as one sees."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._tally = Tally()

    def see(self, block: Block, across: np.ndarray | None) -> None:
        """Takes in a block.

        Args:
            across: [pairs of rows] how far each row lies from the one before; None where nothing tells.
        """
        ended = np.zeros(len(block) + bool(block.before), bool)
        for name in FLAGS:
            if name in block.columns:
                ended |= block.with_before(name)
        alone = block.starts[1 - bool(block.before) :] & ended[1:] & ended[:-1]
        self._tally.add(alone if across is None else alone & (across < CALM), block.first + (not block.before))

    def findings(self, episodes: int) -> list[Finding]:
        """What was found in a log of that many episodes."""
        count, vanished = self._tally.count, _vanished(self._facts, episodes)
        if max(count, vanished) < 3 or count > 0.9 * self._facts.rows:
            return []
        what = f"{count:,} rows are an episode of their own, although they go on from the row before"
        if count < 3:
            what = f"{vanished:,} episodes of a single row vanished when the data were read"
        return [
            Finding(
                "flag-stays-on", "warning", "terminated" if "terminated" in self._facts.fields else "truncated",
                max(count, vanished), tuple(self._tally.rows) if count >= 3 else (),
                f"{what}: the end flag stays on after the end",
                "keep the first flag of each run and leave the rows after it out, or give episodes ids",
            )
        ]  # fmt: skip


def _marked(count: int, places: np.ndarray) -> np.ndarray:
    marks = np.zeros(count, bool)
    marks[places] = True
    return marks


def _vanished(facts: Facts, episodes: int) -> int:
    """Episodes of one cut row, which a data set in memory no longer has; 0 where they are few."""
    dropped = sum(
        int(entry.get("count", 0))
        for entry in facts.log.findings
        if entry.get("finding") == "dropped-without-successor"
    )
    return dropped - episodes if dropped > 1.2 * episodes + 2 else 0
