"""What an estimate says: values with intervals, how much of the log speaks for them, and a verdict in words."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import stdtr, stdtrit

from odaf.report.plain_tables import table
from odaf.training.files import plain

Verdict = Literal["better", "worse", "not decided", "refused"]


@dataclass(frozen=True)
class Interval:
    """A number with the ends of its interval; NaN where there is none."""

    value: float
    low: float
    high: float

    @classmethod
    def of_resamples(cls, value: float, resamples: np.ndarray, confidence: float) -> "Interval":
        """Percentiles of what resampled episodes gave."""
        known = resamples[np.isfinite(resamples)]
        if len(known) < 2:
            return cls(value, math.nan, math.nan)
        tail = 50.0 * (1.0 - confidence)
        low, high = np.percentile(known, [tail, 100.0 - tail])
        return cls(value, float(low), float(high))

    @classmethod
    def of_members(cls, value: float, members: np.ndarray, confidence: float, besides: float = 0.0) -> "Interval":
        """Student's, with the spread of members that each saw resampled episodes as the standard error.

        `besides` is a standard error of another cause.
        """
        if len(members) < 2:
            return cls(value, math.nan, math.nan)
        error = math.hypot(float(np.std(members, ddof=1)), besides)
        half = float(stdtrit(len(members) - 1, 0.5 + confidence / 2)) * error
        return cls(value, value - half, value + half)

    @staticmethod
    def above_zero(value: float, members: np.ndarray, besides: float = 0.0) -> float:
        """How probable it is that the value of `of_members` is above zero."""
        error = math.hypot(float(np.std(members, ddof=1)), besides)
        return float(stdtr(len(members) - 1, value / error)) if error > 0.0 else float(value > 0.0)

    def __str__(self) -> str:
        if math.isnan(self.value):
            return "-"
        if math.isnan(self.low):
            return f"{self.value:,.4g}"
        return f"{self.value:,.4g} ({self.low:,.4g} to {self.high:,.4g})"


@dataclass(frozen=True)
class ValueEstimate:
    """What one estimator says of the policy.

    Attributes:
        method: its name.
        value: of an episode up to the horizon, in the log's unit of reward; None where the estimator was refused.
        per_step: the same divided by the steps that an episode lasts.
        difference: from the behaviour's value, of an episode; the same estimator's, where it has one.
        verdict: whether the policy is better than what was logged; "refused" where the log cannot tell.
        reason: why it was refused, else an empty text.
        effective_episodes: of importance weights; None for estimators without.
        calibrated: the behaviour's own value and the difference from the same estimator's value of the behaviour; None
            for estimators that are not calibrated.
        figures: further numbers, by name.
        probability_better: that the policy is worth more than the behaviour, by the same spread as the interval of the
            difference; None where there is none.
    """

    method: str
    value: Interval | None
    per_step: Interval | None
    difference: Interval | None
    verdict: Verdict
    reason: str = ""
    effective_episodes: float | None = None
    calibrated: Interval | None = None
    figures: Mapping[str, float] = dataclasses.field(default_factory=dict)
    probability_better: float | None = None

    @property
    def best_value(self) -> Interval | None:
        """The calibrated value, or else the value."""
        return self.value if self.calibrated is None else self.calibrated

    @property
    def least(self) -> float:
        """Lower end of the difference from the behaviour's value: what the policy is better by at the least.

        A choice goes by this. An estimate is highest where it knows least, and there its interval is widest. Minus
        infinity without an estimate.
        """
        found = self.difference
        return found.low if found is not None and math.isfinite(found.low) else -math.inf


@dataclass(frozen=True)
class Valuation:
    """What a policy is worth, told from a log.

    Attributes:
        policy: where the policy comes from.
        behaviour: what an episode of the log itself earned, up to the horizon.
        behaviour_per_step: the same divided by the steps that an episode lasts.
        estimates: by each estimator, in the order they were asked for.
        horizon: steps of an episode that are counted.
        discount: weight of a reward one step later; 1 sums them plainly.
        acting: which actions of the policy are judged: "mode", as deployed, or "draws".
        episodes: in the log.
        confidence: of all intervals, over episodes.
        unlike: share of the policy's actions that are less probable than all but a hundredth of the logged ones.
        unlike_states: share of its steps that are predicted to lead to states unlike the logged ones, or to take
            actions beyond all of these; None where no model was fitted, or it does not hold for the log.
        notes: what a reader has to know besides, as sentences.
    """

    policy: Mapping[str, Any]
    behaviour: Interval
    behaviour_per_step: Interval
    estimates: tuple[ValueEstimate, ...]
    horizon: int
    discount: float
    acting: str
    episodes: int
    confidence: float
    unlike: float
    unlike_states: float | None
    notes: tuple[str, ...]

    def __getitem__(self, method: str) -> ValueEstimate:
        """What the estimator of that name says."""
        return {each.method: each for each in self.estimates}[method]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; NaN as None."""
        return plain(dataclasses.asdict(self))

    def __str__(self) -> str:
        rows = [["behaviour", str(self.behaviour), "-", str(self.behaviour_per_step), "-", "-", "the log itself"]]
        for each in self.estimates:
            columns = each.value, each.calibrated, each.per_step, each.difference
            cells = ["-" if column is None else str(column) for column in columns]
            effective = "-" if each.effective_episodes is None else f"{each.effective_episodes:,.1f}"
            rows.append([each.method, *cells, effective, each.verdict])
        header = [
            "estimator",
            "value of an episode",
            "calibrated",
            "by step",
            "beside the behaviour",
            "effective episodes",
            "verdict",
        ]
        sums = "plain sums of rewards" if self.discount == 1.0 else f"discount {self.discount:g}"
        lines = [
            table(header, rows),
            "",
            f"{self.confidence:.0%} intervals over {self.episodes:,} episodes, to step {self.horizon:,}, {sums}; "
            f"{self.unlike:.0%} of the policy's actions are unlike the log's"
            + ("" if self.unlike_states is None else f", {self.unlike_states:.0%} of the states it would come to"),
        ]
        lines += [f"\n{each.method}: {each.reason}" for each in self.estimates if each.reason]
        return "\n".join([*lines, *(f"\nnote: {note}" for note in self.notes)])
