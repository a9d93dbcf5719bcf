"""What records say of a claim: held, not held, or not decided at this number of seeds.

A claim has parts, such as one for each rival, and each part is a difference that the claim says is above zero. It is
held if the interval of every part lies above zero: no part is left to doubt, so no correction for their number is
needed (an intersection-union test). It is not held if some part's interval lies below zero at a confidence corrected
for their number (Bonferroni's). Anything else is not decided: a part without two seeds, one whose records are missing,
and one that says nothing, as a policy under attack that has not learned to walk.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from odaf.evaluation.statistics import Difference

Answer = Literal["held", "not held", "not decided"]
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Part:
    """One difference that a claim says is above zero.

    Attributes:
        name: what is compared, as in "hopper-medium: odaf-paper over sac-n".
        first: a value for each seed; empty where records are missing.
        second: of what it is compared with; None compares with `threshold`.
        threshold: what `first` is said to exceed.
        paired: whether equal places of both share a seed and a log.
        void: why it says nothing whatever the values are; empty where it counts.
    """

    name: str
    first: tuple[float, ...]
    second: tuple[float, ...] | None = None
    threshold: float = 0.0
    paired: bool = True
    void: str = ""

    def difference(self, confidence: float = CONFIDENCE) -> "Difference | None":
        """With its interval; None where there is nothing to compare."""
        from odaf.evaluation.statistics import difference

        others = (self.threshold,) * len(self.first) if self.second is None else self.second
        if not self.first or not others:
            return None
        paired = self.second is None or (self.paired and len(others) == len(self.first))
        found = difference(list(self.first), list(others), paired=paired, confidence=confidence)
        return replace(found, statistic="one-sample t") if self.second is None else found


@dataclass(frozen=True)
class Claim:
    """A claim of the paper's that a study decides.

    Attributes:
        statement: what is claimed.
        protocol: how it is measured, a sentence each.
        deviations: in what that differs from the paper.
        verdict: from the records that count, on the form of the method that the paper prints.
        ours: the same question of this package's form; None where that is not asked.
    """

    statement: str
    protocol: tuple[str, ...]
    deviations: tuple[str, ...]
    verdict: "Callable[[Sequence[dict[str, Any]]], Verdict]"
    ours: "Callable[[Sequence[dict[str, Any]]], Verdict] | None" = None


@dataclass(frozen=True)
class Verdict:
    """The answer to a claim, and what it rests on.

    Attributes:
        verdict: the answer.
        test: in words.
        seeds: the fewest that a part has; 0 where a part has none.
        interval: of the part that decided, or of the weakest; None where it has none.
        enough: seeds a side that would decide, either way, if means and spreads stayed; None where that cannot be said.
        part: the part that decided, or the weakest.
        reasons: what keeps parts from being decided, or speaks against the claim.
        figures: of each part that has values: difference, interval and seeds.
    """

    verdict: Answer
    test: str
    seeds: int
    interval: tuple[float, float] | None
    enough: int | None
    part: str
    reasons: tuple[str, ...]
    figures: Mapping[str, Mapping[str, Any]]

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        found = {**vars(self), "interval": None if self.interval is None else list(self.interval)}
        return {**found, "reasons": list(self.reasons), "figures": {name: dict(e) for name, e in self.figures.items()}}

    def __str__(self) -> str:
        seeds = f"{self.seeds} seed{'s' if self.seeds != 1 else ''}"
        interval = "" if self.interval is None else f", interval {self.interval[0]:+.2f} to {self.interval[1]:+.2f}"
        enough = ""
        if self.verdict == "not decided":
            enough = f"; about {self.enough:,} seeds would decide" if self.enough else "; how many would decide is open"
        return f"{self.verdict} ({self.test}; {self.part}: {seeds}{interval}{enough})"


def decide(parts: Sequence[Part], confidence: float = CONFIDENCE, needed: int | None = None) -> Verdict:
    """The verdict on a claim.

    Args:
        parts: at least one; those without records included, so that a claim is not held on the part that was measured.
        confidence: of the interval that must lie above zero.
        needed: parts that must be above zero; None asks for all. With fewer, intervals are widened so that the answer
            keeps its confidence: a claim that fails has `len(parts) - needed + 1` chances to look held.
    """
    if not parts:
        raise ValueError("a claim without parts cannot be decided")
    needed = len(parts) if needed is None else needed
    most_below = len(parts) - needed
    plain = {part.name: part.difference(confidence) for part in parts}
    figures = {name: _figures(found) for name, found in plain.items() if found is not None}
    for_it = {part.name: part.difference(1.0 - (1.0 - confidence) / (most_below + 1)) for part in parts}
    against_it = {part.name: part.difference(1.0 - (1.0 - confidence) / needed) for part in parts}
    holding = [part for part in parts if not part.void and _low(for_it[part.name]) > 0]
    against = [part for part in parts if not part.void and _high(against_it[part.name]) < 0]
    kinds = sorted({found.statistic for found in plain.values() if found is not None})
    test = " and ".join(kinds) or "no test"
    test += f", {len(parts)} parts" if len(parts) > 1 else ""
    test += f", {needed} of them needed" if most_below else ""
    if len(against) > most_below:
        worst = min(against, key=lambda part: _high(against_it[part.name]))
        reasons = tuple(f"{part.name}: {_said(plain[part.name])}" for part in against)
        test += ", Bonferroni's correction" if needed > 1 else ""
        return _verdict("not held", test, worst, against_it[worst.name], reasons, figures)
    others = [part for part in parts if part not in holding]
    reasons = tuple(f"{part.name}: {part.void or _said(plain[part.name])}" for part in others)
    if len(holding) >= needed:
        weakest = min(holding, key=lambda part: _low(for_it[part.name]))
        return _verdict("held", test, weakest, for_it[weakest.name], reasons, figures)
    weakest = min(others, key=lambda part: (plain[part.name] is not None, _low(plain[part.name])))
    found = _verdict("not decided", test, weakest, plain[weakest.name], reasons, figures)
    ways = [_enough(parts, for_it, needed, 1), _enough(parts, against_it, most_below + 1, -1)]
    return replace(found, enough=min((way for way in ways if way is not None), default=None))


def _enough(
    parts: Sequence[Part], found: "Mapping[str, Difference | None]", needed: int, side: Literal[1, -1]
) -> int | None:
    """Seeds with which so many parts lie on one side of zero, at the confidence that this takes; None if never."""
    numbers = []
    for part in parts:
        known = found[part.name]
        if known is None or part.void or known.mean * side <= 0.0:
            continue
        if known.decided:
            numbers.append(min(known.counts))
        elif known.enough is not None:
            numbers.append(known.enough)
    return sorted(numbers)[needed - 1] if len(numbers) >= needed else None


def _verdict(
    answer: Answer,
    test: str,
    part: Part,
    found: "Difference | None",
    reasons: tuple[str, ...],
    figures: Mapping[str, Mapping[str, Any]],
) -> Verdict:
    known = found is not None and found.low == found.low
    interval = (found.low, found.high) if found is not None and known else None
    seeds = 0 if found is None else min(found.counts) if part.second is not None else found.counts[0]
    return Verdict(answer, test, seeds, interval, None if found is None else found.enough, part.name, reasons, figures)


def _figures(found: "Difference") -> dict[str, Any]:
    interval = None if found.low != found.low else [found.low, found.high]
    return {"difference": found.mean, "interval": interval, "seeds": list(found.counts), "test": found.statistic}


def _said(found: "Difference | None") -> str:
    if found is None:
        return "no records"
    if found.low != found.low:
        return f"{found.mean:+.2f}, one seed"
    return f"{found.mean:+.2f}, {found.low:+.2f} to {found.high:+.2f}, {min(found.counts)} seeds"


def _low(found: "Difference | None") -> float:
    return -float("inf") if found is None or found.low != found.low else found.low


def _high(found: "Difference | None") -> float:
    return float("inf") if found is None or found.high != found.high else found.high
