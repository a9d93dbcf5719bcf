"""Methods under the names people type: `odaf.ODAF(num_critics=4)`."""

from typing import Any

from odaf.algorithms.base import Algorithm
from odaf.runs import presets


def preset(name: str, /, *, task: str | None = None, **settings: Any) -> Algorithm:
    """The learner that a preset describes, with some settings changed.

    Args:
        name: one of `odaf.runs.presets.names()`.
        task: one of `odaf.runs.presets.tasks(name)`, whose values replace the preset's.
        settings: fields by name; a term's fields as a dictionary under the term's name, as in
            `preset("odaf", num_critics=4, outcome={"weight": 1.0, "dynamics": {"kind": "ensemble"}})`.

    Raises:
        ConfigError: unknown preset, task, field or value; the message lists what is known.
    """
    return presets.load(name, presets.dotted(settings), task=task)


def ODAF(**settings: Any) -> Algorithm:
    """Outcome-Driven Action Flexibility with our default settings; see `preset` for what may be changed."""
    return preset("odaf", **settings)
