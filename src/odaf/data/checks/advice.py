"""Which method to begin with for a log: a table of cases, the first of which that holds is the advice.

docs/choosing.md says what was measured. Where nothing was, the case says so.
"""

import shlex
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from odaf.data.checks.log_statistics import LogStatistics
from odaf.data.checks.parting import FEWEST_COMPARED

# Where a threshold has no other source it is a round number set beforehand; none was fitted to scores.
FEW_ROWS = 10_000
"""Forty batches of 256: "some thousands" in docs/choosing.md."""
ANSWERS = 1e-3
"""Share of the actions' variance: less is rounding of a linear controller, and no log of ours comes near it."""
FEW = 0.25
"""Share of the rows that is still a few: the measured fifth, and room for what is left out as fragments."""
FORETOLD = 0.5
"""Where the start says most of the variance, the best returns are the best starts."""
SPARSE = 0.05
"""One reward in twenty rows; in AntMaze and mazes like it there is one an episode."""
SMALL_PROBLEM = 8
"""Columns and actions: the maze has 6, as the two tanks do; Hopper, where `odaf` as it is failed, has 14."""
ENDED = 0.5
"""Where the task ends half of the episodes, a fall decides the return; Hopper's medium log has 1, HalfCheetah's 0."""
DIFFERENT = 0.25
"""Share of the rewards' variance between episodes: of one mediocre controller on Hopper 0.03, of the two tanks'
operators 0.08, of a mixture with 80 % random rows 0.90 (logs of seed 0)."""
STANDING_OUT = 0.75
"""`LogStatistics.lift`: halfway between a symmetric spread, 0.5 as in Hopper's medium log, and the mixture's, 1."""
USUAL_BATCH, FEWEST_BATCHES = 256, 10
"""A run on fewer drawn rows than ten batches is refused: `odaf.training.drawn_rows`."""
USUAL_SHARE = 0.1

STITCHING = (
    "Returns do not show whether good pieces lie in different episodes. If the best way may be in no single episode, "
    "train `odaf` too"
)

BEYOND_HELP = ("no-difference", "few-rows", "one-answer")
"""Cases in which no learner of values is worth trying."""


@dataclass(frozen=True)
class Advice:
    """Which method to begin with for a log, and why.

    Attributes:
        case: name of the row of `CASES`.
        preset: of `odaf train`, or of `odaf.preset`.
        settings: fields of the preset to change, by dotted name, such as {"sampling": "return"}.
        why: the reasons, with the log's own numbers; returns are in units of its reward.
        support: what was measured on logs of this kind, and where that stands; or that nothing was.
        beside: what to train too, as words of `odaf train`; the first is the bar that has to be passed.
        unseen: what the log cannot show; empty where that changes nothing.
        statistics: the figures that the advice stands on.

    Sources: docs/choosing.md and the records that it names.
    """

    case: str
    preset: str
    settings: Mapping[str, Any]
    why: str
    support: str
    beside: tuple[str, ...]
    unseen: str
    statistics: LogStatistics = field(repr=False)

    @property
    def words(self) -> str:
        """The preset and its settings as words of `odaf train`."""
        return " ".join([self.preset, *(_option(name, value) for name, value in self.settings.items())])

    def command(self, data: str = "FILE", out: str = "DIR") -> str:
        """The command that trains what is advised."""
        return f"odaf train {self.words} --data {shlex.quote(data)} --out {shlex.quote(out)}"

    def describe(self, data: str = "FILE", out: str = "DIR") -> str:
        """The command, why, what to train beside it, what was measured and what the log cannot show; 110 wide."""
        bar, *others = self.beside or ("",)
        beside = ", ".join([f"{bar} (the bar to pass)", *others]) if bar else "nothing"
        parts = {"because": self.why, "beside it": beside, "support": self.support, "unseen": self.unseen}
        lines = [f"what to begin with ({self.case}):", f"  {self.command(data, out)}"]
        for name, text in parts.items():
            if text:
                lines += textwrap.wrap(text, 110, initial_indent=f"  {name:<11}", subsequent_indent=" " * 13)
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.describe()

    def to_dict(self) -> dict[str, Any]:
        """JSON types; every attribute by its name, and `command`."""
        return {
            "case": self.case,
            "preset": self.preset,
            "settings": dict(self.settings),
            "command": self.command(),
            "why": self.why,
            "support": self.support,
            "beside": list(self.beside),
            "unseen": self.unseen,
            "statistics": self.statistics.to_dict(),
        }


@dataclass(frozen=True)
class Case:
    """A kind of log and what to begin with there.

    Attributes:
        name: of the case.
        holds: whether a log is of this kind; cases above it did not hold.
        why: the reason, from the log's figures.
        preset: what is advised.
        settings: what to change, from the log's figures.
        beside: what to train too, the bar first.
        support: what was measured.
    """

    name: str
    holds: Callable[[LogStatistics], bool]
    why: Callable[[LogStatistics], str]
    preset: str
    settings: Callable[[LogStatistics], dict[str, Any]]
    beside: tuple[str, ...]
    support: str


def advice_for(statistics: LogStatistics) -> Advice:
    """The advice of the first case that holds."""
    case = next(case for case in CASES if case.holds(statistics))
    settings = case.settings(statistics)
    unseen = "" if case.preset == "odaf" or case.name in BEYOND_HELP else STITCHING
    return Advice(case.name, case.preset, settings, case.why(statistics), case.support, case.beside, unseen, statistics)


def _nothing(log: LogStatistics) -> dict[str, Any]:
    return {}


def _small(log: LogStatistics) -> dict[str, Any]:
    """Networks for few rows."""
    return {"hidden_sizes": [64, 64]} if log.rows < FEW_ROWS else {}


def _batch(rows: float) -> dict[str, Any]:
    """A batch of which ten times as many rows can be drawn."""
    fitting = [size for size in (USUAL_BATCH, 64, 16) if FEWEST_BATCHES * size <= rows]
    return {} if fitting[:1] == [USUAL_BATCH] else {"batch_size": fitting[0] if fitting else 16}


def _per(log: LogStatistics) -> dict[str, Any]:
    return {"return_per": "step"} if log.per_step else {}


def _best(log: LogStatistics) -> dict[str, Any]:
    """The best tenth, or less of the log where less is good; enough rows for the smallest batch."""
    share = USUAL_SHARE
    if log.good_episodes and log.good_rows < USUAL_SHARE:
        share = float(f"{log.good_rows:.2g}")
    share = min(1.0, max(share, float(f"{1.05 * FEWEST_BATCHES * 16 / log.rows:.2g}")))
    changed = {} if share == USUAL_SHARE else {"best_share": share}
    return {**changed, **_per(log), **_batch(share * log.rows), **_small(log)}


def _by_return(log: LogStatistics) -> dict[str, Any]:
    """Rows by return; more alike where the usual weights would leave a handful."""
    if log.return_rows < FEWEST_BATCHES * 64:
        return {"sampling": "return", "return_temperature": 1.0, **_per(log), **_batch(log.rows / 2), **_small(log)}
    return {"sampling": "return", **_per(log), **_batch(log.return_rows), **_small(log)}


def _few_far_better(log: LogStatistics) -> bool:
    return log.good_episodes > 0 and log.good_rows <= FEW and not log.goals and log.start_says < FORETOLD


def _whole_ways(log: LogStatistics) -> bool:
    """A small problem in which a large part of the log does alike well and nothing ends an episode early."""
    return _is_small(log) and log.terminated == 0.0 and log.good_rows > FEW


def _is_small(log: LogStatistics) -> bool:
    return log.columns + log.actions <= SMALL_PROBLEM


def _size(log: LogStatistics) -> str:
    """How large the problem is, in words."""
    return f"{log.columns} column{'s' * (log.columns != 1)} and {log.actions} action{'s' * (log.actions != 1)}"


def _measure(log: LogStatistics) -> str:
    return "return per step" if log.per_step else "return"


def _spread(log: LogStatistics) -> str:
    """The three levels in words."""
    return (
        f"the best tenth of the rows has a {_measure(log)} of {log.best:.4g}, the middle row {log.middle:.4g}, the "
        f"worst tenth {log.worst:.4g}"
    )


def _parted(log: LogStatistics) -> str:
    return (
        f"{log.good_episodes:,} of {log.episodes:,} episodes, {log.good_rows:.1%} of the rows, have a {_measure(log)} "
        f"of at least {log.good_from:.4g} and lie far above the others"
    )


CASES = (
    Case(
        "mixed-per-batch",
        lambda log: log.mixed,
        lambda log: "the log is mixed per batch, which says already how rows are drawn",
        "td3-bc",
        _small,
        ("behaviour-cloning",),
        "not measured on such a log",
    ),
    Case(
        "no-difference",
        lambda log: log.best == log.worst and (log.episodes > 1 or log.rewarded == 0.0),
        lambda log: f"every episode has the same {_measure(log)}, {log.middle:.4g}: none is better than another",
        "behaviour-cloning",
        _small,
        (),
        "nothing to measure: no learner can tell what is better there",
    ),
    Case(
        "few-rows",
        lambda log: log.rows < FEW_ROWS and not _few_far_better(log),
        lambda log: f"{log.rows:,} rows are few: a learner of values would learn them by heart",
        "behaviour-cloning",
        lambda log: {**_small(log), **_batch(log.rows)},
        (),
        "not measured",
    ),
    Case(
        "goals",
        lambda log: bool(log.goals),
        lambda log: (
            f"{', '.join(log.goals[:3])} stand still within an episode and differ between episodes, as goals and "
            "recipes do: returns of different goals cannot be compared, so rows are not drawn by them"
        ),
        "td3-bc",
        _nothing,
        ("behaviour-cloning",),
        "not measured on such a log",
    ),
    Case(
        "starts",
        lambda log: log.start_says >= FORETOLD,
        lambda log: (
            f"the first observation foretells {log.start_says:.0%} of the variance of {_measure(log)}s: the best "
            "episodes are those with the best starts, so rows are not drawn by return"
        ),
        "td3-bc",
        _nothing,
        ("behaviour-cloning", "td3-bc --sampling advantage"),
        "not measured on such a log",
    ),
    Case(
        "few-far-better",
        _few_far_better,
        lambda log: f"{_parted(log)}: what they did is worth repeating, and a learner of all rows sees little of it",
        "behaviour-cloning-best",
        _best,
        ("behaviour-cloning", "rebrac-return --averaged-updates 5000"),
        "measured on Hopper, 80 % random rows (100 is the expert): 98 to 107 by seed; `rebrac-return` with an "
        "average of its actor 105 to 110, cloning all rows 2: docs/results/rivals.md",
    ),
    Case(
        "one-answer",
        lambda log: log.free < ANSWERS,
        lambda log: (
            f"a linear function of the observation says {1 - log.free:.2%} of the actions: in no state was anything "
            "else tried, so the log cannot tell what would be better"
        ),
        "behaviour-cloning",
        _nothing,
        ("td3-bc",),
        "not measured on such a log",
    ),
    Case(
        "few-episodes",
        lambda log: log.episodes < FEWEST_COMPARED,
        lambda log: (
            f"{log.episodes} whole {'episode is' if log.episodes == 1 else 'episodes are'} too few to compare returns, "
            "so rows are drawn alike"
        ),
        "td3-bc",
        _nothing,
        ("behaviour-cloning",),
        "not measured on such a log",
    ),
    Case(
        "sparse",
        lambda log: 0.0 < log.rewarded < SPARSE,
        lambda log: (
            f"{1 - log.rewarded:.1%} of the rows earn one and the same reward: what led to the others has to be "
            "carried back over many steps"
        ),
        "iql",
        _nothing,
        ("behaviour-cloning-best",),
        "not measured here; IQL's published scores in mazes with such rewards are why",
    ),
    Case(
        "whole-ways",
        _whole_ways,
        lambda log: (
            f"{_parted(log)}, and nothing ends an episode early: cloning already does as well as these, and going "
            f"beyond takes pieces of several. With {_size(log)} that can be learned"
        ),
        "odaf",
        _nothing,
        ("behaviour-cloning-best", "odaf --return-steps 3"),
        "measured in the stitching maze: 118 over four seeds where the best logged episode has 70 and cloning 66, but "
        "not in every maze: docs/results/pointmaze.md",
    ),
    Case(
        "better-half",
        lambda log: log.good_episodes > 0,
        lambda log: f"{_parted(log)}: their best tenth is worth cloning before anything else",
        "behaviour-cloning-best",
        _best,
        ("behaviour-cloning", "td3-bc --sampling return"),
        "measured where the better part is a fifth: docs/results/rivals.md",
    ),
    Case(
        "small-plant",
        lambda log: _is_small(log) and log.between < DIFFERENT,
        lambda log: (
            f"{_spread(log)}, and {1 - log.between:.0%} of the variance of rewards lies within episodes: no controller "
            f"is far better than another. With {_size(log)} small networks do"
        ),
        "rebrac",
        lambda log: {"hidden_sizes": [32, 32], "batch_size": 128, "discount": 0.95},
        ("behaviour-cloning --hidden-sizes 32 32 --batch-size 128", "odaf"),
        "measured on a plant of two tanks, with these settings and 8,000 updates: better than the operators on three "
        "of four logs, cloning on one: docs/results/plant.md",
    ),
    Case(
        "broad",
        lambda log: log.between >= DIFFERENT or log.lift >= STANDING_OUT,
        lambda log: (
            f"{_spread(log)}, with no gap between, and {log.between:.0%} of the variance of rewards lies between "
            "episodes: better episodes show more often, and none is left out"
        ),
        "td3-bc",
        _by_return,
        ("behaviour-cloning-best", "rebrac-return --averaged-updates 5000"),
        "not measured on such a log; drawn so it earned 77 to 99 by seed on 80 % random rows, 8 to 31 on rows drawn "
        "alike: docs/results/rivals.md",
    ),
    Case(
        "alike-and-falling",
        lambda log: log.terminated >= ENDED,
        lambda log: (
            f"{_spread(log)}: episodes are much alike, so the log is cloned first, as the bar; {log.terminated:.0%} of "
            "them end by themselves, which a learner of values can try to put off"
        ),
        "odaf-locomotion",
        _nothing,
        ("behaviour-cloning", "behaviour-cloning-best", "atac"),
        "measured on Hopper's medium log: 72 as a mean over evaluations that go up and down, cloning 47: "
        "docs/results/locomotion.md. ATAC stood at 84 in an hour and a half of one core: docs/results/rivals.md",
    ),
    Case(
        "alike",
        lambda log: True,
        lambda log: f"{_spread(log)}: episodes are much alike, and no better part of the log stands out",
        "behaviour-cloning",
        _nothing,
        ("behaviour-cloning-best", "odaf-locomotion", "td3-bc"),
        "measured on HalfCheetah's medium log, first edition: 46.6, `odaf-locomotion` 41.6: docs/results/locomotion.md",
    ),
)
"""Tried from the first to the last."""


def _option(name: str, value: Any) -> str:
    """A setting as an option of `odaf train`."""
    values = value if isinstance(value, list | tuple) else [value]
    return " ".join([f"--{name.replace('_', '-')}", *map(str, values)])
