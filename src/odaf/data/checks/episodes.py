"""Checks of where episodes begin and end, of their ids and their clock."""

import numpy as np

from odaf.data.checks.findings import Finding, Severity
from odaf.data.checks.hashing import BoundedHashes, hash_ids
from odaf.data.checks.stream import FLAGS, Block, Facts, Tally
from odaf.data.checks.structure import flags_present


class Ends:
    """End flags: none at all, both at once, inside an episode, missing, or a clock that is logged as an end."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._with_ids = "episode" in facts.fields
        self._flags = flags_present(facts)
        self._both, self._inside, self._unfinished = Tally(), Tally(), Tally()
        self._marked: dict[str, int] = dict.fromkeys(FLAGS, 0)
        self._same = len(self._flags) == 2
        self._start = self._seen = 0  # first row of the episode that is going on; rows so far
        self._shortest, self._longest, self._terminal_ends = np.inf, 0, 0
        self._episodes = 0
        self._last_ended = self._last_terminated = False

    def see(self, block: Block) -> None:
        flags = {name: block.columns[name] for name in self._flags}
        for name, flag in flags.items():
            self._marked[name] += int(np.count_nonzero(flag))
        if len(flags) == 2:
            both = flags["terminated"] & flags["truncated"]
            self._both.add(both, block.first)
            self._same = self._same and bool((flags["terminated"] == flags["truncated"]).all())
        ended = np.zeros(len(block) + bool(block.before), bool)
        for name in self._flags:
            ended |= block.with_before(name)
        if self._with_ids and self._flags:
            goes_on, first = block.pairs()
            self._inside.add(ended[: len(goes_on)] & goes_on, first - 1)
            self._unfinished.add(~ended[: len(goes_on)] & ~goes_on, first - 1)
        self._lengths(block)
        self._last_ended = bool(ended[-1])
        self._last_terminated = bool("terminated" in flags and flags["terminated"][-1])

    def _lengths(self, block: Block) -> None:
        begins = np.flatnonzero(block.starts) + block.first
        if block.first == 0:
            begins = begins[1:]
        if len(begins):
            lengths = np.diff(np.append(self._start, begins))
            self._shortest = min(self._shortest, int(lengths.min()))
            self._longest = max(self._longest, int(lengths.max()))
            self._start = int(begins[-1])
            if "terminated" in self._flags:
                terminated = block.with_before("terminated")
                lead = block.first - bool(block.before)
                self._terminal_ends += int(terminated[begins - 1 - lead].sum())
        self._episodes += len(begins)
        self._seen = block.first + len(block)

    @property
    def episodes(self) -> int:
        """How many episodes there are, the unfinished last one included."""
        return self._episodes + 1

    def findings(self) -> list[Finding]:
        found = []
        total = sum(self._marked.values())
        if total == 0 and not self._with_ids:
            what = f"no row is marked in {' or '.join(self._flags)}" if self._flags else "no end of an episode is given"
            found.append(
                Finding(
                    "no-episode-end", "error", "", self._facts.rows, (), f"{what}, so episodes cannot be told apart",
                    "name the column with the episode's id, or the environment's time limit (max_episode_steps)",
                )
            )  # fmt: skip
        if self._both.count:
            found.append(
                Finding(
                    "both-ends", "warning", "terminated", self._both.count, tuple(self._both.rows),
                    f"{self._both.count:,} rows are marked as terminated and as cut", "they count as terminated: check "
                    "that these are true ends, because no future reward is expected after them",
                )
            )  # fmt: skip
        if self._inside.count:
            found.append(
                Finding(
                    "flag-inside-episode", "error", "episode", self._inside.count, tuple(self._inside.rows),
                    f"{self._inside.count:,} end flags stand inside an episode id",
                    "correct the ids, or leave the id column out to split at the flags",
                )
            )  # fmt: skip
        if total or self._with_ids:
            found += self._without_successor()
        return found + self._unfinished_ends(total) + self._doubtful_terminals()

    def _unfinished_ends(self, total: int) -> list[Finding]:
        trailing = self._seen - self._start
        if not self._with_ids:
            if self._last_ended or total == 0:
                return []
            row = self._start
            return [
                Finding(
                    "unfinished-episode", self._unfinished_severity(), "truncated", trailing, (row,),
                    f"the last episode has no end flag: its {trailing:,} rows are the trailing ones",
                    "it counts as cut by the recording; if the task ended there, set the flag",
                )
            ]  # fmt: skip
        if not self._flags or total == 0:
            return [
                Finding(
                    "no-terminals", "note", "terminated", self.episodes, (),
                    f"all {self.episodes:,} episodes count as cut by the recording, none as ended by the task",
                    "if a failure or a success ends the task, name the column that says so",
                )
            ]  # fmt: skip
        if not self._last_ended:
            self._unfinished.row(self._seen - 1)
        if not self._unfinished.count:
            return []
        count = self._unfinished.count
        what = f"{count:,} episodes stop without an end flag"
        if count == 1:
            what = "one episode stops without an end flag"
            if not self._last_ended:
                what = f"the last episode has no end flag: its {trailing:,} rows are the trailing ones"
        return [
            Finding(
                "unfinished-episode", self._unfinished_severity("truncated" in self._flags), "truncated", count,
                tuple(self._unfinished.rows), what,
                "they count as cut by the recording; if the task ended there, set the flag",
            )
        ]  # fmt: skip

    def _unfinished_severity(self, flag_expected: bool = True) -> Severity:
        # Our own files say how each episode ends; one that does not was edited and will not load. A log without a
        # column for cuts cannot say it otherwise than by saying nothing.
        if self._facts.log.format == "odaf":
            return "error"
        return "warning" if flag_expected else "note"

    def _without_successor(self) -> list[Finding]:
        cut = self.episodes - self._terminal_ends - self._last_terminated
        if "next_observations" in self._facts.fields or cut == 0:
            return []
        return [
            Finding(
                "no-successor", "note", "next_observations", cut, (),
                f"no next observations are logged, so what followed the last rows of {cut:,} cut episodes is unknown",
                "these rows are left out when the data are used; log one observation more",
            )
        ]  # fmt: skip

    def _doubtful_terminals(self) -> list[Finding]:
        terminals, timeouts = self._marked["terminated"], self._marked["truncated"]
        remedy = "a learner will expect no reward after them: store time limits as truncated, true ends as terminated"
        if terminals == self._facts.rows and self._facts.rows > 1:
            return [_doubtful(terminals, "every row is terminated", remedy)]
        if self._same and terminals:
            return [_doubtful(terminals, "terminated and truncated mark exactly the same rows", remedy)]
        equal = self._shortest == self._longest and self._longest > 1 and self._episodes > 2
        if equal and timeouts == 0 and self._terminal_ends == self._episodes:
            text = f"every episode is {self._longest:,} steps long and terminated, as if a clock were the task's end"
            return [_doubtful(terminals, text, remedy)]
        return []


def _doubtful(count: int, message: str, remedy: str) -> Finding:
    return Finding("terminals-are-timeouts", "warning", "terminated", count, (), message, remedy)


class Ids:
    """Episode ids that come back after another episode."""

    def __init__(self, facts: Facts):
        self._seen = BoundedHashes()

    def see(self, block: Block) -> None:
        rows = np.flatnonzero(block.starts)
        if len(rows):
            self._seen.add(hash_ids(block.columns["episode"][rows]), rows + block.first)

    def findings(self) -> list[Finding]:
        again = self._seen.repeated()
        if not again.count:
            return []
        rows = tuple(int(row) for row in again.rows)
        about = "about " if again.estimated else ""
        return [
            Finding(
                "episode-ids-apart", "error", "episode", again.count, rows,
                f"{about}{again.count:,} blocks of rows carry the id of an earlier, separate block",
                "sort the rows by episode and time, or give each episode an id of its own",
            )
        ]  # fmt: skip


class Clock:
    """Gaps, repeats and steps back of the time column inside an episode."""

    GAP = 1.5  # of the usual step

    def __init__(self, facts: Facts):
        self._gaps, self._repeats, self._back = Tally(), Tally(), Tally()
        self._usual: float | None = None
        self._largest = 0.0
        self._example = ""

    def see(self, block: Block) -> None:
        time = block.with_before("time").astype(np.float64)
        steps = np.diff(time)
        goes_on, first = block.pairs()
        inside = steps[goes_on]
        forward = inside[inside > 0]
        if self._usual is None and len(forward):
            self._usual = float(np.median(forward))
        self._repeats.add((steps == 0) & goes_on, first)
        self._back.add((steps < 0) & goes_on, first)
        if self._usual is not None:
            gaps = (steps > self.GAP * self._usual) & goes_on
            if gaps.any():
                if not self._example:
                    place = int(np.flatnonzero(gaps)[0])
                    self._example = f"the first from {time[place]:.10g} to {time[place + 1]:.10g}"
                self._largest = max(self._largest, float(steps[gaps].max()))
            self._gaps.add(gaps, first)

    def findings(self) -> list[Finding]:
        found = []
        if self._back.count:
            found.append(
                Finding(
                    "time-backwards", "error", "time", self._back.count, tuple(self._back.rows),
                    f"time runs backwards inside an episode in {self._back.count:,} rows",
                    "sort the rows by episode and time, or give a new episode its own id",
                )
            )  # fmt: skip
        if self._repeats.count:
            found.append(
                Finding(
                    "time-repeats", "error", "time", self._repeats.count, tuple(self._repeats.rows),
                    f"{self._repeats.count:,} rows have the time of the row before them",
                    "remove the doubled rows at the source; a step from a row to its double teaches standing still",
                )
            )  # fmt: skip
        if self._gaps.count:
            found.append(
                Finding(
                    "time-gaps", "warning", "time", self._gaps.count, tuple(self._gaps.rows),
                    f"{self._gaps.count:,} gaps inside episodes, up to {self._largest:.6g} where the usual step is "
                    f"{self._usual:.6g}; {self._example}",
                    "begin a new episode after each gap, or the learner takes one long step for a short one",
                )
            )  # fmt: skip
        return found
