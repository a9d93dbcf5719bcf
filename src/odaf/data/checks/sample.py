"""A bounded sample of a log that is passed over once: whole episodes, and pieces of long ones."""

import heapq
import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from odaf.data.checks.hashing import mix
from odaf.data.checks.stream import Block, Facts

ROWS, BYTES = 40_000, 12 * 2**20
PIECE = 1_000
LARGEST = 1e30  # squares of larger numbers overflow in single precision's sums
FIELDS = ("observations", "actions", "rewards", "next_observations")


@dataclass(frozen=True, eq=False)
class Sample:
    """Rows of some episodes, in the order of the log.

    Attributes:
        observations: [rows, obs_dim] float64.
        actions: [rows, act_dim].
        rewards: [rows].
        stored: [rows, obs_dim] logged next observations, or None.
        number: [rows] number of each row in the log, from 0.
        episode: [rows] number of its episode.
        piece: [rows] number of its piece; rows of a piece follow one another.
        of: rows of the whole log.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    stored: np.ndarray | None
    number: np.ndarray
    episode: np.ndarray
    piece: np.ndarray
    of: int

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def share(self) -> str:
        """For messages: which rows were looked at; empty if all were."""
        return "" if len(self) == self.of else f" (in a sample of {len(self):,} of {self.of:,} rows)"

    @cached_property
    def goes_on(self) -> np.ndarray:
        """[rows] whether the next row of the sample is that of the log."""
        return np.append(self.piece[1:] == self.piece[:-1], False)

    @cached_property
    def following(self) -> np.ndarray:
        """[rows, obs_dim] the next observation, as stored or of the next row; NaN where unknown."""
        if self.stored is not None:
            return self.stored
        shifted = np.append(self.observations[1:], self.observations[-1:], axis=0)
        return np.where(self.goes_on[:, None], shifted, np.nan)

    def runs(self, back: int, ahead: int) -> np.ndarray:
        """Rows that have so many rows of their episode before and after them in the sample."""
        rows = np.arange(back, len(self) - ahead)
        return rows[self.piece[rows - back] == self.piece[rows + ahead]]


class Sampler:
    """Keeps the pieces whose hashed number is lowest, as many as fit: the same ones for blocks of any size."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._fields = [name for name in FIELDS if name in facts.fields]
        width = sum(
            8 * (facts.obs_dim if "obs" in name else facts.act_dim if name == "actions" else 1) for name in FIELDS
        )
        self._room = max(PIECE, min(ROWS, BYTES // max(width, 1)))
        self._kept: dict[int, list[dict[str, np.ndarray]]] = {}  # by piece: its parts
        self._rank: list[tuple[int, int]] = []  # (place in the draw, turned around, piece), the last place first
        self._sizes: dict[int, int] = {}
        self._rows = 0
        self._highest: int | None = None  # pieces from here on are no longer wanted
        self._episode, self._in_episode, self._piece = -1, 0, -1

    def see(self, block: Block) -> None:
        begins = np.flatnonzero(block.starts)
        edges = np.unique(np.concatenate([[0], begins, [len(block)]]))
        for start, stop in itertools.pairwise(edges.tolist()):
            if block.starts[start]:
                self._episode, self._in_episode, self._piece = self._episode + 1, 0, self._piece + 1
            self._part(block, start, stop)

    def _part(self, block: Block, start: int, stop: int) -> None:
        """Rows of one episode, piece by piece."""
        while start < stop:
            if self._in_episode and self._in_episode % PIECE == 0:
                self._piece += 1
            count = min(stop - start, PIECE - self._in_episode % PIECE)
            self._keep(block, slice(start, start + count))
            self._in_episode += count
            start += count

    def _keep(self, block: Block, rows: slice) -> None:
        piece = self._piece
        place = int(mix(np.array([piece], np.uint64))[0])
        if self._highest is not None and place >= self._highest:
            return
        part = {name: block.columns[name][rows].copy() for name in self._fields}
        count = rows.stop - rows.start
        part["number"] = np.arange(block.first + rows.start, block.first + rows.stop)
        part["episode"] = np.full(count, self._episode)
        part["piece"] = np.full(count, piece)
        if piece not in self._kept:
            heapq.heappush(self._rank, (-place, piece))
        self._kept.setdefault(piece, []).append(part)
        self._sizes[piece] = self._sizes.get(piece, 0) + count
        self._rows += count
        while self._rows > self._room and len(self._kept) > 1:
            turned, last = heapq.heappop(self._rank)
            self._highest = -turned
            self._rows -= self._sizes.pop(last)
            del self._kept[last]

    def sample(self) -> Sample | None:
        """What was kept, handed over once, without pieces that hold NaN or numbers too large to square.

        None where the log lacks a column or nothing is left.
        """
        if not {"observations", "actions", "rewards"} <= set(self._fields):
            return None
        whole = [part for piece in sorted(self._kept) for part in self._kept[piece]]
        self._kept = {}
        columns = {name: np.concatenate([part.pop(name) for part in whole]) for name in list(whole[0])} if whole else {}
        if not columns:
            return None
        finite = np.ones(len(columns["piece"]), bool)
        for name in self._fields:
            columns[name] = columns[name].astype(np.float64)
            usable = np.abs(columns[name].reshape(len(finite), -1)) < LARGEST  # false for NaN too
            finite &= usable.all(axis=1)
        if not finite.all():
            keep = ~np.isin(columns["piece"], columns["piece"][~finite])
            columns = {name: values[keep] for name, values in columns.items()}
        if not len(columns["piece"]):
            return None
        return Sample(
            columns["observations"], columns["actions"], columns["rewards"], columns.get("next_observations"),
            columns["number"], columns["episode"], columns["piece"], self._facts.rows,
        )  # fmt: skip

    def findings(self) -> list:
        """None: what the sample shows is found by `odaf.data.checks.signs`."""
        return []
