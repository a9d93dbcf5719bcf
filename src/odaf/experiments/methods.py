"""Methods under the names people type: `odaf.ODAF(num_critics=4)`."""

from collections.abc import Mapping
from typing import Any

from odaf.algorithms.base import Algorithm
from odaf.experiments import presets


def preset(name: str, /, **settings: Any) -> Algorithm:
    """The learner that a preset describes, with some settings changed.

    Args:
        name: one of `odaf.experiments.presets.names()`.
        settings: fields by name; a term's fields as a dictionary under the term's name, as in
            `preset("odaf", num_critics=4, outcome={"weight": 1.0, "dynamics": {"kind": "ensemble"}})`.

    Raises:
        ConfigError: unknown preset, field or value; the message lists what is known.
    """
    return presets.load(name, _dotted(settings))


def ODAF(**settings: Any) -> Algorithm:
    """Outcome-Driven Action Flexibility with our default settings; see `preset` for what may be changed."""
    return preset("odaf", **settings)


def _dotted(settings: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _dotted(value, f"{before}{name}.")
        else:
            flat[f"{before}{name}"] = value
    return flat
