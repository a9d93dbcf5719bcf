"""How a simulator counts the contact margins of two geoms that touch: the larger one, or both added.

MuJoCo counted the larger of the two until version 3.4.0 and adds them from 3.5.0 on. So bodies whose model has margins
(Hopper, Ant, Humanoid, the mazes' point and ant, the hand) became other bodies under unchanged names; those without
(HalfCheetah, Walker2d, Swimmer) stayed the same. Halving all margins under the newer rule gives the older one back
wherever the two margins that meet are equal: Hopper to rounding, the point maze, an ant at rest; not quite an ant
that moves.
"""

import re
import warnings
from collections.abc import Mapping
from typing import Any, Literal, get_args

from odaf.errors import ConfigError, OdafWarning

ContactMargins = Literal["added", "larger"]
_FIRST_ADDED = (3, 5)


def rule_of(version: str) -> ContactMargins | None:
    """The rule of a version of MuJoCo, such as `3.3.7`; None where the text begins with no version."""
    match = re.match(r"(\d+)\.(\d+)", version)
    if match is None:
        return None
    return "added" if (int(match[1]), int(match[2])) >= _FIRST_ADDED else "larger"


def installed_version() -> str | None:
    """The installed MuJoCo's version; None where there is none."""
    try:
        import mujoco
    except ImportError:
        return None
    return str(mujoco.__version__)


def installed_rule() -> ContactMargins | None:
    """The rule of the installed MuJoCo."""
    version = installed_version()
    return None if version is None else rule_of(version)


def check(rule: Any) -> ContactMargins | None:
    """The rule as given; `ConfigError` where there is no such rule."""
    if rule is not None and rule not in get_args(ContactMargins):
        raise ConfigError(f"contact_margins={rule!r}: give 'added' (MuJoCo from 3.5.0 on) or 'larger' (before)")
    return rule


def apply(environment: Any, rule: ContactMargins | None, name: str) -> None:
    """Makes an environment count its margins by `rule`; None leaves it as it is.

    It is fresh, or says in `contact_margins` which rule it was made for, which is then changed too.

    Raises:
        ConfigError: there is no such rule, or no MuJoCo model in the environment.
    """
    if check(rule) is None:
        return
    models = models_in(environment)
    if not models:
        raise ConfigError(f"contact_margins={rule!r}: '{name}' has no MuJoCo model; leave the option out")
    for model in models:
        set_rule(model, rule, _own_rule(environment))
    if _own_rule(environment) is not None:
        getattr(environment, "unwrapped", environment).contact_margins = rule


def set_rule(model: Any, rule: ContactMargins | None, now: ContactMargins | None = None) -> None:
    """Scales the margins of one model so that the installed simulator counts them by `rule`.

    Args:
        model: of MuJoCo.
        rule: None changes nothing.
        now: the rule that the model's margins are already made for; None is a fresh model, whose are the installed one.
    """
    if rule is not None and rule != (now or installed_rule()):
        model.geom_margin *= 0.5 if rule == "larger" else 2.0


def _own_rule(environment: Any) -> ContactMargins | None:
    """The rule that an environment was made for by itself, as `odaf/AntMaze-UMaze-v0` is; None where it has none."""
    rule = getattr(getattr(environment, "unwrapped", environment), "contact_margins", None)
    return check(rule) if isinstance(rule, str) else None


def models_in(environment: Any) -> list[Any]:
    """The MuJoCo models that an environment simulates, each once."""
    try:
        import mujoco
    except ImportError:
        return []
    inner = getattr(environment, "unwrapped", environment)
    kind = getattr(mujoco, "MjModel")  # noqa: B009 (the compiled module comes without stubs)
    places = [
        inner,
        *(value.unwrapped for value in getattr(inner, "__dict__", {}).values() if hasattr(value, "unwrapped")),
    ]
    found = [getattr(place, name, None) for place in places for name in ("model", "_model")]
    return list({id(model): model for model in found if isinstance(model, kind)}.values())


def simulator_of(environment: Any, rule: ContactMargins | None = None) -> dict[str, Any] | None:
    """What simulates an environment, for records: `{"mujoco": "4.0.0", "contact_margins": "added"}`; None: no MuJoCo.

    Args:
        environment: built with `rule`.
        rule: None is the one that the environment was made for by itself, or else the installed one.
    """
    models = models_in(environment)
    if not models:
        return None
    margins = any(bool((model.geom_margin > 0.0).any()) for model in models)
    played = rule or _own_rule(environment) or installed_rule()
    return {"mujoco": installed_version(), "contact_margins": played if margins else "none"}


def in_words(simulator: Mapping[str, Any] | None) -> str:
    """`MuJoCo 4.0.0, contact margins added`; empty where nothing is known."""
    if not simulator:
        return ""
    rule, version = simulator.get("contact_margins"), simulator.get("mujoco")
    text = f"MuJoCo {version}" if version else "MuJoCo of unknown version"
    rules = {"added": ", contact margins added", "larger": ", the larger contact margin counted"}
    return text + rules.get(str(rule), "")


def recorded(provenance: Mapping[str, Any]) -> dict[str, Any] | None:
    """The simulator that data were recorded in, as their provenance tells; None where it does not.

    Data of ours hold versions; Minari's hold the packages that they need; files that carry a name of D4RL's are of 2020
    and 2021, which is said with `"likely": True`.
    """
    environment = provenance.get("environment")
    chosen = environment.get("contact_margins") if isinstance(environment, Mapping) else None
    versions = provenance.get("versions")
    version = versions.get("mujoco") if isinstance(versions, Mapping) else None
    if version is None:
        version = _required(provenance.get("minari"))
    if version is not None and (rule := chosen or rule_of(str(version))) is not None:
        return {"mujoco": str(version), "contact_margins": rule}
    name = str(provenance.get("file", "")).lower().replace("_", "-")
    if provenance.get("format") == "d4rl" and re.match(r"(hopper|ant|antmaze|maze2d)-.*-v[0-2]\.hdf5$", name):
        return {"mujoco": None, "contact_margins": "larger", "likely": True}
    return None


def warn_if_other(data: Mapping[str, Any] | None, played: Mapping[str, Any] | None) -> str:
    """Warns, and returns what it said, where a body with margins plays by another rule than the data's.

    Args:
        data: what `recorded` returned.
        played: what `simulator_of` returned.
    """
    if not data or not played or played.get("contact_margins") not in ("added", "larger"):
        return ""
    if data.get("contact_margins") in (None, played["contact_margins"]):
        return ""
    was = f"{'most likely ' if data.get('likely') else ''}recorded under {in_words(data)}"
    text = (
        f"the data were {was}, and policies are evaluated under {in_words(played)}: the body is another one. For the "
        f'recorded one pass contact_margins="{data["contact_margins"]}"'
    )
    warnings.warn(text, OdafWarning, stacklevel=3)
    return text


def _required(facts: Any) -> str | None:
    """The exact version of MuJoCo among a Minari data set's requirements."""
    needed = facts.get("requirements") if isinstance(facts, Mapping) else None
    for entry in needed if isinstance(needed, list) else ():
        if match := re.fullmatch(r"mujoco\s*==\s*([\d.]+)", str(entry).strip()):
            return match[1]
    return None
