"""How an estimate becomes a verdict, and when there is none.

*Better* or *worse*: the interval of the difference from the behaviour's own value leaves zero out, and still does if
what states unlike the log's may earn (`odaf.estimation.outcomes`) turns out against it. *Refused*: that could change
the verdict; or there is none yet and more than half of the states are unlike the log's; or the estimator is not to be
believed of this log. *Not decided*: the interval holds zero.
"""

from collections.abc import Mapping

from odaf.estimation.outcomes import Unknown
from odaf.estimation.valuation import Interval, ValueEstimate, Verdict

LARGEST_SHARE_UNLIKE = 0.5


def judged(
    name: str,
    value: Interval,
    per_step: Interval,
    difference: Interval,
    reasons: list[str],
    effective: float | None = None,
    *,
    unknown: Unknown | None = None,
    calibrated: Interval | None = None,
    figures: Mapping[str, float],
    better: float,
) -> ValueEstimate:
    """An estimate with its verdict.

    Args:
        name: of the estimator.
        value: of an episode.
        per_step: the same by step.
        difference: from the behaviour's own value.
        reasons: why the estimator is not to be believed, as sentences.
        effective: episodes that weights leave.
        unknown: what the log leaves open about the policy; None where nobody knows, or nothing depends on it.
        calibrated: the value, with what the estimator gets wrong about the behaviour taken out.
        figures: further numbers.
        better: how probable it is that the policy is better.
    """
    verdict: Verdict = "not decided"
    if difference.low > 0.0:
        verdict = "better"
    elif difference.high < 0.0:
        verdict = "worse"
    if unknown is not None:
        figures = {**figures, "unknown_below": unknown.below, "unknown_above": unknown.above}
        surely = difference.low - unknown.below > 0.0 or difference.high + unknown.above < 0.0
        if not surely and (verdict != "not decided" or unknown.share > LARGEST_SHARE_UNLIKE):
            reasons = [*reasons, why_open(unknown)]
    if reasons:
        verdict = "refused"
    return ValueEstimate(
        name, value, per_step, difference, verdict, "; ".join(reasons), effective, calibrated, figures, better
    )


def why_open(unknown: Unknown) -> str:
    """Why unlike states leave a verdict open."""
    return (
        f"{unknown.share:.0%} of the states that the policy is predicted to come to are unlike any that the log shows, "
        f"or follow actions beyond all logged ones, and what these may earn ({unknown.low:.4g} to {unknown.high:.4g} "
        "a step, as episodes of the log do) decides: "
        f"up to {unknown.below:.4g} less an episode than estimated, or {unknown.above:.4g} more"
    )


def why_thin(unlike: float) -> str:
    """Why many unlike actions leave a verdict open where no model tells what they lead to."""
    return (
        f"{unlike:.0%} of the policy's actions are unlike any that the log shows at such states, so what they earn is "
        "a guess: the overlap is too thin"
    )
