"""What an artefact takes, gives and does not promise, as JSON: `contract.json` beside its forms."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import odaf
from odaf.data.expressions import Expression
from odaf.deployment.policies import REWARD, action_names, input_columns
from odaf.training.policy import Policy

FORMAT, VERSION = "odaf-contract", 1

STATUS_MEANS = {
    "0": "the action may be taken",
    "1": "refused: a reading is not a finite number",
    "2": "no action: earlier steps of which an observation is made are not known yet",
    "3": "refused: the numbers ran over, so readings are far outside of anything sensible",
}
GUARD_MEANS = {
    "4": "the guard raises an alarm; the action is what its reaction gives",
    "5": "no action: an alarm has stopped the policy until a new episode begins",
}
NOT_PROMISED = (
    "This is not a safety case. Bounds and limits hold for what is put out, and nothing follows for the plant.",
    "The actions were learned from a log. Where readings leave what the log has shown, nobody knows their worth.",
    "Readings that are wrong but finite and within their ranges are believed.",
    "The time between two steps has to be that of the log; nothing here checks a clock.",
    "The first action of an episode is not limited in its change, unless it was told what was played before it.",
)


def contract(
    policy: Policy,
    formulas: Mapping[str, Expression],
    max_change: Mapping[str, float],
    ranges: Mapping[str, Any] | None,
    checkpoint: str | None,
    checked: Mapping[str, Any],
    files: Mapping[str, Path],
    guard: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The content of the file, in JSON types; None where something is not known.

    Args:
        policy: in the user's units.
        formulas: by the name of a reading, how it is to be computed before the call.
        max_change: the largest change of an action from one step to the next.
        ranges: what the log has shown, as `odaf.data.ranges` gives it.
        checkpoint: SHA-256 of what the policy was made of.
        checked: how each form compares with the policy.
        files: of the artefact.
        guard: what it promises, and what an alarm leads to; None without one.
    """
    return {
        "format": FORMAT,
        "version": VERSION,
        "odaf": odaf.__version__,
        "observation": [_reading(policy, name, formulas, ranges) for name in input_columns(policy)],
        "action": [
            {
                "name": name,
                "unit": _entry(policy.action_units, index) or "",
                "low": policy.action_low[index],
                "high": policy.action_high[index],
                "logged_low": _of(ranges, "action_low", index),
                "logged_high": _of(ranges, "action_high", index),
                "largest_logged_change": _of(ranges, "largest_action_change", index),
                "max_change": max_change.get(name),
            }
            for index, name in enumerate(action_names(policy))
        ],
        "steps_before_the_first_action": policy.history,
        "time_step": None if ranges is None else ranges.get("time_step"),
        "status": STATUS_MEANS if guard is None else STATUS_MEANS | GUARD_MEANS,
        "guard": guard,
        "provenance": dict(policy.provenance),
        "checkpoint_sha256": checkpoint,
        "checked": dict(checked),
        "files": {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()},
        "not_promised": list(NOT_PROMISED),
    }


def _reading(
    policy: Policy, name: str, formulas: Mapping[str, Expression], ranges: Mapping[str, Any] | None
) -> dict[str, Any]:
    if name == REWARD and policy.actor.takes_rewards:
        meaning = "the reward, in the log's units, of what was done in the step before; 0 in the first step"
        return {"name": name, "unit": "", "logged_low": None, "logged_high": None, "ignored": False, "meaning": meaning}
    index = policy.observation_names.index(name)
    found = {
        "name": name,
        "unit": _entry(policy.observation_units, index) or "",
        "logged_low": _of(ranges, "observation_low", index),
        "logged_high": _of(ranges, "observation_high", index),
        "ignored": index in policy.normaliser.constant,  # it never varied in the log
    }
    return found | ({"formula": formulas[name].text} if name in formulas else {})


def _of(ranges: Mapping[str, Any] | None, field: str, index: int) -> Any:
    return None if ranges is None else _entry(ranges[field], index)


def _entry(values: Any, index: int) -> Any:
    return values[index] if index < len(values) else None
