"""The environments that a Minari folder names: where it was recorded, and where it wants policies to be evaluated.

A description may name code to run (`entry_point`) and wrappers around the environment. No code is taken from a file:
an environment is told by its id, and of the wrappers only some of gymnasium's own are rebuilt, by name. Where more
would be needed, the data set names no environment, and a finding says why.
"""

import json
import math
import re
from collections.abc import Mapping
from typing import Any

# An id with a module in front ("module:Name-v0") would have that module imported when the environment is made.
_ID = re.compile(r"[\w./-]+")
_GYMNASIUM = re.compile(r"gymnasium\.wrappers\.[\w.]+:(\w+)")

# Wrappers that do the same whenever they are given the same settings; each with all the settings that it takes.
REBUILT: Mapping[str, frozenset[str]] = {
    "ClipAction": frozenset(),
    "ClipReward": frozenset({"min_reward", "max_reward"}),
    "DelayObservation": frozenset({"delay"}),
    "FilterObservation": frozenset({"filter_keys"}),
    "FlattenObservation": frozenset(),
    "FrameStackObservation": frozenset({"stack_size", "padding_type"}),
    "MaxAndSkipObservation": frozenset({"skip"}),
    "RescaleAction": frozenset({"min_action", "max_action"}),
    "RescaleObservation": frozenset({"min_obs", "max_obs"}),
    "ReshapeObservation": frozenset({"shape"}),
    "StickyAction": frozenset({"repeat_action_probability", "repeat_action_duration"}),
    "TimeAwareObservation": frozenset({"flatten", "normalize_time", "dict_time_key"}),
    "TimeLimit": frozenset({"max_episode_steps"}),
}
# Wrappers that change nothing of what a policy meets in an episode.
_WITHOUT_EFFECT = frozenset(
    {"Autoreset", "HumanRendering", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo"}
    | {"RenderCollection"}
)
# Arguments of an environment that concern pictures alone.
_PICTURES = frozenset({"render_mode", "width", "height", "camera_id", "camera_name"})


def environments_of(metadata: Mapping[str, Any]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """(entries for the provenance, findings) from the contents of `metadata.json`.

    `environment` is where policies should be evaluated, for `odaf.environments.make`: what `eval_env_spec` describes,
    or else `env_spec`. Where it is another than the recorded one, that is under `recorded_environment`.
    """
    recorded, why = described(metadata.get("env_spec"))
    asked, why_asked = described(metadata.get("eval_env_spec"))
    entries: dict[str, Any] = {}
    findings = []
    if asked is not None and asked != recorded:
        entries["environment"] = asked
        if recorded is not None:
            entries["recorded_environment"] = recorded
        message = f"metadata.json asks for evaluation in another environment than the recorded one: {shown(asked)}"
        findings.append({"finding": "evaluation-environment", "count": 1, "message": message})
    elif recorded is not None and not why_asked:
        entries["environment"] = recorded
    elif recorded is not None:
        entries["recorded_environment"] = recorded
    reason = why_asked or (why if asked is None else "")
    if reason:
        message = (
            f"the environment in metadata.json cannot be rebuilt: {reason}; policies are evaluated only where you name "
            "an environment yourself, and in another one their scores mean something else"
        )
        findings.append({"finding": "environment-not-rebuilt", "count": 1, "message": message})
    return entries, findings


def described(text: Any) -> tuple[dict[str, Any] | None, str]:
    """(a description for `odaf.environments.make`, or None; why not, empty where the text names no environment)."""
    spec = json_object(text)
    identity, kwargs = spec.get("id"), spec.get("kwargs")
    if not isinstance(identity, str):
        return None, ""
    if not _ID.fullmatch(identity):
        return None, f"its id {identity!r} has a module imported, and files of others do not run code here"
    kwargs = kwargs if isinstance(kwargs, dict) else {}
    if not _plain(kwargs):
        return None, f"its settings {kwargs!r} hold more than texts, flags and finite numbers"
    kwargs = {name: value for name, value in kwargs.items() if name not in _PICTURES}
    environment: dict[str, Any] = {"name": "gymnasium", "id": identity, "kwargs": kwargs}
    if "max_episode_steps" in spec:
        limit = spec["max_episode_steps"]
        if not (limit is None or (isinstance(limit, int) and not isinstance(limit, bool) and limit > 0)):
            return None, f"max_episode_steps is {limit!r}, neither a number of steps nor null"
        environment["max_episode_steps"] = limit
    wrappers, why = _wrappers(spec.get("additional_wrappers"))
    if why:
        return None, why
    if wrappers:
        environment["wrappers"] = wrappers
    return environment, ""


def shown(environment: Mapping[str, Any]) -> str:
    """An environment in a few words: its id, and what differs from the plain one."""
    extras = [f"{name} = {json.dumps(value)}" for name, value in (environment.get("kwargs") or {}).items()]
    if environment.get("max_episode_steps") is not None:
        extras.append(f"at most {environment['max_episode_steps']:,} steps")
    extras += [wrapper["name"] for wrapper in environment.get("wrappers", ())]
    text = str(environment.get("id", environment.get("name")))
    return f"{text} with {', '.join(extras)}" if extras else text


def json_object(text: Any) -> dict[str, Any]:
    """What a JSON text describes, empty where it is no object; nothing but descriptions depends on it."""
    try:
        value = json.loads(text) if isinstance(text, str) else text
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


def _wrappers(specs: Any) -> tuple[list[dict[str, Any]], str]:
    """(wrappers to rebuild, the innermost first; why they cannot be)."""
    found: list[dict[str, Any]] = []
    for spec in specs if isinstance(specs, list) else ():
        entry = spec.get("entry_point") if isinstance(spec, dict) else None
        match = _GYMNASIUM.fullmatch(entry) if isinstance(entry, str) else None
        name = match[1] if match else ""
        if name in _WITHOUT_EFFECT:
            continue
        if name not in REBUILT:
            return [], f"its wrapper {entry!r} is none of {', '.join(REBUILT)} in gymnasium.wrappers"
        kwargs = spec.get("kwargs")
        if kwargs is None and REBUILT[name]:
            return [], f"its wrapper {name} was recorded without its settings"
        kwargs = kwargs or {}
        if not isinstance(kwargs, dict) or not REBUILT[name].issuperset(kwargs) or not _plain(kwargs):
            return [], f"its wrapper {name} has the settings {kwargs!r}, expected {', '.join(sorted(REBUILT[name]))}"
        found.append({"name": name, "kwargs": kwargs})
    return found, ""


def _plain(value: Any) -> bool:
    """Whether a value is a finite number, text, flag, None, or consists of such."""
    if isinstance(value, dict):
        return all(_plain(entry) for entry in value.values())
    if isinstance(value, list):
        return all(_plain(entry) for entry in value)
    return isinstance(value, (bool, int, str, type(None))) or (isinstance(value, float) and math.isfinite(value))
