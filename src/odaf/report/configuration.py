"""Where the settings of several runs differ, setting by setting."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

ABSENT = "–"


def flatten(settings: Any, prefix: str = "") -> dict[str, str]:
    """Dotted name to printed value; lists of plain values stay one entry, lists of groups are numbered."""
    if isinstance(settings, Mapping) and settings:
        entries: dict[str, str] = {}
        for name, value in settings.items():
            entries |= flatten(value, f"{prefix}.{name}" if prefix else str(name))
        return entries
    if isinstance(settings, list) and any(isinstance(item, Mapping) for item in settings):
        entries = {}
        for position, item in enumerate(settings):
            entries |= flatten(item, f"{prefix}[{_name_of(item, position)}]")
        return entries
    return {prefix: settings if isinstance(settings, str) else json.dumps(settings)}


def differences(configurations: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Settings that do not have the same value everywhere, with the value of each configuration.

    A setting that a configuration does not have shows as a dash: methods of different families have different settings.
    """
    flat = [flatten(configuration) for configuration in configurations]
    names = list(dict.fromkeys(name for entries in flat for name in entries))
    rows = [(name, [entries.get(name, ABSENT) for entries in flat]) for name in names]
    return [(name, values) for name, values in rows if len(set(values)) > 1]


def _name_of(item: Any, position: int) -> str:
    """What a member of a list calls itself, so that the same term in two runs lands in one row."""
    if isinstance(item, Mapping):
        for field in ("name", "kind", "type", "term"):
            if isinstance(item.get(field), str):
                return str(item[field])
    return str(position)
