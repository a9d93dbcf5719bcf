"""What the tables of studies share."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from odaf.studies.job import Record

if TYPE_CHECKING:
    from odaf.evaluation.statistics import Estimate


def grouped(records: Sequence[Record], key: Callable[[Record], Any]) -> dict[Any, list[Record]]:
    """Records with equal keys, in the order of the keys."""
    groups: dict[Any, list[Record]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return dict(sorted(groups.items()))


def interval(estimate: "Estimate", sign: str = "") -> str:
    """An interval over seeds, to one decimal; `sign="+"` shows the sign of gains."""
    return f"[{estimate.low:{sign}.1f}, {estimate.high:{sign}.1f}]" if estimate.count > 1 else "one seed"
