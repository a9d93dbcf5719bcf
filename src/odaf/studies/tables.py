"""What the tables of studies share."""

from collections.abc import Callable, Sequence
from typing import Any

from odaf.studies.job import Record


def grouped(records: Sequence[Record], key: Callable[[Record], Any]) -> dict[Any, list[Record]]:
    """Records with equal keys, in the order of the keys."""
    groups: dict[Any, list[Record]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return dict(sorted(groups.items()))
