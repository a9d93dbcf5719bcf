"""What the file of a guarded policy holds: that of a policy, and beside it the guard.

"guard" in the metadata of the header is a JSON object:

    policy          as in the file of a policy; arrays named actor/...
    outcome         the dynamics, as `odaf.components.stored` writes modules; arrays named outcome/...
    critics         the same of the critics
    clone           the same of what imitates the log, or null
    calibration     threshold and what it rests on
    reaction        what an alarm leads to
    facts           how the guard was made

The other arrays of `odaf.deployment.score.GuardScore` are named score/...
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from odaf.components.policies import Actor
from odaf.components.stored import pack, unpack
from odaf.deployment.conformal import Calibration
from odaf.deployment.score import GuardScore
from odaf.errors import CheckpointError
from odaf.training.files import plain
from odaf.training.policy_file import packed_policy, read_document, unpacked_policy, write_document
from odaf.training.tensors import REMEDY

FORMAT = "odaf-guard"
VERSION = "1"
_MODULES = ("outcome", "critics", "clone")
_SECTIONS = ("policy", *_MODULES, "calibration", "reaction", "facts")
_ARRAYS = tuple(field.name for field in dataclasses.fields(GuardScore) if field.name not in _MODULES)


def write_guard(path: Path, fields: Mapping[str, Any]) -> None:
    """Writes the fields of a `GuardedPolicy`, in which the policy's stand as a mapping.

    Raises:
        ConfigError: a module cannot be stored.
        CheckpointError: the file cannot be written.
    """
    policy, arrays = packed_policy(fields["policy"])
    score: GuardScore = fields["score"]
    content: dict[str, Any] = {"policy": policy, "clone": None}
    for name, module in zip(_MODULES, (score.outcome, score.critics, fields["clone"]), strict=True):
        if module is not None:
            content[name], more = pack(module, name)
            arrays |= more
    arrays |= {f"score/{name}": np.asarray(getattr(score, name)) for name in _ARRAYS}
    content["calibration"] = dataclasses.asdict(fields["calibration"])
    content["reaction"], content["facts"] = fields["reaction"], plain(fields["facts"])
    write_document(path, FORMAT, VERSION, "guard", content, arrays)


def read_guard(path: Path) -> dict[str, Any]:
    """Inverse of `write_guard`.

    Raises:
        CheckpointError: the file is missing, damaged, of another kind or version, or contradicts itself.
    """
    content, arrays = read_document(path, FORMAT, VERSION, "guard", _SECTIONS)
    if not isinstance(content["policy"], dict):
        _refuse(path, "policy: must be a JSON object")
    groups = ("actor", "score", *_MODULES)
    own = {name: {key: array for key, array in arrays.items() if key.startswith(f"{name}/")} for name in groups}
    if strange := sorted(set(arrays) - {key for group in own.values() for key in group}):
        _refuse(path, f"arrays that belong to nothing: {', '.join(strange[:3])}")
    policy = unpacked_policy(path, content["policy"], own["actor"])
    outcome, critics, clone = (_module(path, name, content[name], own[name]) for name in _MODULES)
    if set(own["score"]) != {f"score/{name}" for name in _ARRAYS}:
        _refuse(path, f"score: expected arrays {', '.join(_ARRAYS)}")
    sizes = len(policy["normaliser"].mean), len(policy["action_low"])
    try:
        parts: dict[str, Any] = {name: jnp.asarray(own["score"][f"score/{name}"]) for name in _ARRAYS}
        score = GuardScore(outcome=outcome, critics=critics, **parts)  # type: ignore[arg-type]
        fits = _shape(score, policy["actor"], *sizes) == ((1,), jnp.float32)
    except Exception as error:  # whatever the modules make of numbers that do not fit together
        _refuse(path, f"score: {error}")
    if not fits:
        _refuse(path, "score: does not fit the policy")
    if clone is not None and not isinstance(clone, Actor):
        _refuse(path, f"clone: a {type(clone).__name__} does not act")
    if not isinstance(content["facts"], dict) or not isinstance(content["reaction"], str):
        _refuse(path, "facts, reaction: must be a JSON object and a text")
    return {
        "policy": policy,
        "score": score,
        "clone": clone,
        "calibration": _calibration(path, content["calibration"]),
        "reaction": content["reaction"],
        "facts": content["facts"],
    }


def _module(path: Path, name: str, structure: Any, arrays: Mapping[str, np.ndarray]) -> eqx.Module | None:
    if structure is None:
        return None
    try:
        return unpack(structure, arrays, name)
    except Exception as error:  # whatever the modules make of strange content
        _refuse(path, f"{name}: {error}")


def _shape(score: GuardScore, actor: Actor, obs_dim: int, act_dim: int) -> tuple[tuple[int, ...], Any]:
    state, action = (jax.ShapeDtypeStruct((1, width), jnp.float32) for width in (obs_dim, act_dim))
    found = jax.eval_shape(
        lambda score, actor, state, action: score.judge(actor, state, action, (state, action)).score,
        score,
        actor,
        state,
        action,
    )
    return found.shape, found.dtype


def _calibration(path: Path, entry: Any) -> Calibration:
    names = [field.name for field in dataclasses.fields(Calibration)]
    if not isinstance(entry, dict) or set(entry) != set(names):
        _refuse(path, f"calibration: expected {', '.join(names)}")
    numbers = [value for name, value in entry.items() if not (name == "episode_steps" and value is None)]
    if not all(type(value) in (int, float) and math.isfinite(value) for value in numbers):
        _refuse(path, "calibration: holds something else than finite numbers")
    return Calibration(**entry)


def _refuse(path: Path, what: str) -> NoReturn:
    raise CheckpointError(f"{path}: {what}. {REMEDY.replace('Policy', 'GuardedPolicy')}")
