"""Checks of rewards and returns: a scale that hinders learning, returns that tell length, a few that are far better."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.moments import Moments
from odaf.data.checks.parting import FEWEST, compared, part
from odaf.data.checks.stream import Block, Facts
from odaf.data.summary import fragments

LARGE, SMALL = 1e3, 1e-3
"""Where a fixed reward scale fails: values are rewards times up to 1 / (1 - discount), and networks begin near 0 with
steps of a thousandth, so they never reach values of 1e5, and do not tell values of 1e-3 from their own noise."""
MOST_EPISODES = 250_000
"""Episodes whose returns are compared, so that memory is bounded; further ones only enter the figures."""
VERY_DIFFERENT = 3.0


class RewardScale:
    """Rewards so large, so small, or so far from 0 that a learner with a fixed scale sees nothing in them."""

    def __init__(self, facts: Facts):
        self._rows = facts.rows
        self._moments = Moments()
        self._squares, self._count = 0.0, 0

    def see(self, block: Block) -> None:
        rewards = block.columns["rewards"].astype(np.float64)
        rewards = rewards[np.isfinite(rewards)]
        self._moments.add(rewards[:, None])
        with np.errstate(over="ignore"):
            self._squares += float(np.square(rewards).sum())
        self._count += int(np.count_nonzero(rewards))

    def findings(self) -> list[Finding]:
        if self._moments.count == 0 or self._moments.low[0] == self._moments.high[0]:
            return []
        size = float(np.sqrt(self._squares / max(self._count, 1)))  # of the rewards that are not 0
        spread = float(self._moments.std[0])
        remedy = (
            'scale them: the learner\'s option reward_scale="auto" (--reward-scale auto of `odaf train`), which some '
            "presets have on from the start; or take another unit"
        )
        if size > LARGE or size < SMALL:
            large = size > LARGE
            return [
                Finding(
                    "reward-scale", "warning", "rewards", self._rows, (),
                    f"the scale of the reward is {size:.3g} (root mean square of those that are not 0): a learner that "
                    f"takes it as it is {'cannot reach such values' if large else 'sees only its own noise'}",
                    remedy,
                )
            ]  # fmt: skip
        if abs(float(self._moments.mean[0])) > 1e4 * spread:
            return [
                Finding(
                    "reward-scale", "warning", "rewards", self._rows, (),
                    f"rewards vary by {spread:.3g} around {self._moments.mean[0]:.3g}: what they tell apart is lost "
                    "beside what they share",
                    "subtract a constant from the reward at its source; where episodes end by themselves, one that "
                    "does not change which of them is best",
                )
            ]  # fmt: skip
        return []


class Returns:
    """Returns and lengths of the episodes: as figures, and whether the one only tells the other."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._sum, self._steps, self._began = 0.0, 0, 0
        self._last_terminated = False
        self._finished = False
        self._kept: list[np.ndarray] = []  # pieces of [episodes, (first row, return, length, terminated)]
        self._kept_count = 0
        self.returns, self.lengths = Moments(), Moments()

    def see(self, block: Block) -> None:
        rewards = block.columns["rewards"].astype(np.float64)
        terminated = block.columns.get("terminated", np.zeros(len(block), bool))
        begins = np.flatnonzero(block.starts)
        if block.first == 0:
            begins = begins[1:]
        if not len(begins):
            self._sum += float(rewards.sum())
            self._steps += len(block)
        else:
            edges = np.append(0, begins)
            inside = begins[0] > 0
            sums = np.add.reduceat(rewards, edges) if inside else np.append(0.0, np.add.reduceat(rewards, begins))
            lengths = np.diff(np.append(edges, len(block)))
            sums[0] += self._sum
            lengths[0] += self._steps
            firsts = np.append(self._began, begins + block.first)
            ends = np.append(self._last_terminated, terminated)[begins]  # of the row before each beginning
            self._take(firsts[:-1], sums[:-1], lengths[:-1], ends)
            self._sum, self._steps, self._began = float(sums[-1]), int(lengths[-1]), int(firsts[-1])
        self._last_terminated = bool(terminated[-1])

    def _take(self, firsts: np.ndarray, sums: np.ndarray, lengths: np.ndarray, terminated: np.ndarray) -> None:
        self.returns.add(sums[:, None])
        self.lengths.add(lengths[:, None])
        room = MOST_EPISODES - self._kept_count
        if room > 0:
            self._kept.append(np.stack([firsts, sums, lengths, terminated], axis=1)[:room])
            self._kept_count += len(self._kept[-1])

    def finish(self) -> None:
        """Takes in the last episode, once."""
        if not self._finished:
            self._finished = True
            self._take(*(np.array([value]) for value in (self._began, self._sum, self._steps, self._last_terminated)))

    def episodes(self) -> np.ndarray:
        """[4, episodes] first row, return, length and whether it terminated, of the first 250,000 episodes."""
        self.finish()
        return np.concatenate(self._kept).T

    def findings(self) -> list[Finding]:
        firsts, returns, lengths, terminated = self.episodes()
        if len(returns) < FEWEST or not np.isfinite(returns).all():
            return []
        return [
            *self._by_length(firsts, returns, lengths, terminated),
            *_few_good(firsts, returns, lengths, terminated > 0),
        ]

    def _by_length(
        self, firsts: np.ndarray, returns: np.ndarray, lengths: np.ndarray, terminated: np.ndarray
    ) -> list[Finding]:
        short = fragments(lengths, terminated > 0)
        best = int(np.argmax(returns))
        remedy = (
            "compare rewards per step beside them; `odaf data info` leaves such fragments out of best and worst. To "
            "learn from the best episodes (sampling='best' or 'return'), set return_per='step' or cut all to one length"
        )
        if short[best]:
            return [
                Finding(
                    "returns-by-length", "warning", "rewards", int(short.sum()),
                    tuple(int(row) for row in firsts[short][:5]),
                    f"the highest return, {returns[best]:.4g}, is that of a fragment: {lengths[best]:.0f} rows, cut by "
                    f"the recording, where episodes usually have {np.median(lengths[~short]):.0f}; per step it earned "
                    f"{returns[best] / lengths[best]:.4g}, the best whole episode "
                    f"{(returns / lengths)[~short].max():.4g}",
                    remedy,
                )
            ]  # fmt: skip
        cut = terminated == 0
        if np.count_nonzero(cut) < 4 * FEWEST:
            return []
        low, high = np.quantile(lengths[cut], [0.1, 0.9])
        if high < VERY_DIFFERENT * low or abs(_rank_correlation(returns[cut], lengths[cut])) < 0.9:
            return []
        return [
            Finding(
                "returns-by-length", "note", "rewards", int(cut.sum()), tuple(int(row) for row in firsts[cut][:5]),
                f"episodes cut by the recording have from {low:.0f} to {high:.0f} rows (tenth to nine tenths of them), "
                "and their returns follow their lengths",
                remedy,
            )
        ]  # fmt: skip


def _few_good(firsts: np.ndarray, returns: np.ndarray, lengths: np.ndarray, terminated: np.ndarray) -> list[Finding]:
    """A few episodes far better than the rest: advice on what to draw, as such a log is sound."""
    merits = compared(returns, lengths, terminated)
    values, sizes = merits.values[merits.whole], lengths[merits.whole]
    count = len(values)
    parting = part(values, sizes)
    if parting is None:
        return []
    good, step = parting.episodes, " per step" if merits.per_step else ""
    order = np.argsort(-values, kind="stable")
    rest = values[order[good:]]
    why = "as the recording cut episodes of different length" if merits.per_step else "fragments aside"
    how = ", return_per='step'" if merits.per_step else ""
    return [
        Finding(
            "few-good-episodes", "note", "rewards", good,
            tuple(int(row) for row in np.sort(firsts[merits.whole][order[:good]])[:5]),
            f"{good} of {count:,} episodes, {parting.rows:.1%} of the rows, have a return{step} of at least "
            f"{parting.least:.4g}; the others have {rest.mean():.4g} on average, with a spread of {rest.std():.2g} "
            f"(compared by return{step}, {why}): a learner that draws all rows alike sees little of the good ones",
            "nothing is wrong; try `odaf train behaviour-cloning-best`, or any learner with sampling='return' or 'best'"
            f"{how} (--set sampling=return), beside one that draws all alike",
        )
    ]  # fmt: skip


def _rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's, by places in the order."""
    places = [np.argsort(np.argsort(values, kind="stable"), kind="stable").astype(float) for values in (first, second)]
    return float(np.corrcoef(places[0], places[1])[0, 1])
