"""The form in which the first studies measured the presets, so that their records go on meaning what they say.

Since then our defaults bring rewards near one by a power of two, and add nothing to the standard deviations that
observations are divided by. The studies were measured with rewards as logged and 1e-3 added, as papers have it.
"""

from typing import Any

from odaf.runs import presets

COMMON: tuple[tuple[str, Any], ...] = (("normaliser_epsilon", 1e-3),)
"""What all learners had."""


def first_form(preset: str) -> tuple[tuple[str, Any], ...]:
    """What a preset had beside it; one whose own rewards were scaled then is as it was."""
    return (("reward_scale", 1.0),) if presets.settings(preset).get("reward_scale") == "unit" else ()
