"""Valuations as records hold them: each estimator's value and interval, and what is worked out from these."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from odaf.estimation.valuation import Interval

RECORDED = ("fqe", "model", "blend", "wis", "pdis", "dr")  # estimators that fit or weigh; `shrunk` needs fqe alone
LIKENESS = "likeness of actions"  # no estimate: the share of actions that the log knows, which ranks policies too


def intervals(valuation: Mapping[str, Any], members: int) -> dict[str, tuple[float, float, float]]:
    """Value and interval by estimator, of a valuation as records hold it; calibrated values count as another one."""
    found: dict[str, tuple[float, float, float]] = {}
    for each in valuation["estimates"]:
        if each["method"] not in RECORDED:
            continue
        found[each["method"]] = _numbers(each["value"])
        if each["calibrated"] is not None:
            found[f"{each['method']}, calibrated"] = _numbers(each["calibrated"])
        if each["method"] == "fqe":
            found["shrunk"] = _numbers(vars(shrunk_of(valuation, members)))
    found[LIKENESS] = 1.0 - valuation["unlike"], math.nan, math.nan
    return found


def _numbers(interval: Mapping[str, float | None] | None) -> tuple[float, float, float]:
    parts = [None] * 3 if interval is None else [interval[end] for end in ("value", "low", "high")]
    value, low, high = (math.nan if part is None else part for part in parts)
    return value, low, high


def shrunk_of(valuation: Mapping[str, Any], members: int) -> "Interval":
    """The value of a policy by `odaf.estimation.shrinkage`."""
    from odaf.estimation.shrinkage import shrink

    difference, own = of_fqe(valuation)
    found = shrink(
        difference,
        own,
        valuation["unlike"],
        members=members,
        episodes=valuation["episodes"],
        confidence=valuation["confidence"],
    )
    return found.around(own.value, valuation["confidence"])


def of_fqe(valuation: Mapping[str, Any]) -> "tuple[Interval, Interval]":
    """Fitted Q's difference from the behaviour, and what the log's episodes earned."""
    from odaf.estimation.valuation import Interval

    fqe = next(each for each in valuation["estimates"] if each["method"] == "fqe")
    return Interval(**fqe["difference"]), Interval(**valuation["behaviour"])
