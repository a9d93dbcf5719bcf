"""The behaviour policies that come with the package: small arrays, one file a task, and a page of facts beside it.

The ant's page says under "walker" which one walks the mazes.

`policies/TASK.npz` holds the layers of P policies stacked along a first axis, in half precision; `policies/TASK.json`
says which is which, how they were trained, and what they earn. Both are written by `odaf behaviour export`.
"""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np

from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.locomotion import Task
from odaf.errors import ConfigError

WALKER = "ant"  # the task of the walker of the ant mazes


@dataclass(frozen=True)
class Phase:
    """A stretch of a training run: `steps` of its environment steps, played by one snapshot; None plays uniformly."""

    steps: int
    policy: GaussianPolicy | None


@dataclass(frozen=True)
class ShippedPolicies:
    """What was learnt for one task.

    Attributes:
        medium: a policy stopped early; None where none is good enough.
        expert: a fully trained policy; None where none is good enough.
        replay: the run up to the medium policy, in order, the uniform start first.
        facts: the page of facts.
    """

    medium: GaussianPolicy | None
    expert: GaussianPolicy | None
    replay: tuple[Phase, ...]
    facts: dict[str, Any]


@dataclass(frozen=True)
class Walker:
    """A policy that goes where it is told, and the page of facts; see `ant_maze_controller` for what it is shown."""

    policy: GaussianPolicy
    facts: dict[str, Any]


def shipped_walker() -> Walker:
    """The walker of the ant mazes.

    Raises:
        ConfigError: none is shipped.
    """
    layers, facts = _stored(WALKER)
    return Walker(stacked_policies(layers)[facts["walker"]["index"]], facts)


def shipped(task: Task, edition: int | None = None) -> ShippedPolicies:
    """The policies of a task.

    Args:
        task: the task.
        edition: of its sets, from 1; None takes the newest. Where a better policy was found for a level, the earlier
            one stays, so that what was measured on its sets can be measured again.

    Raises:
        ConfigError: none are shipped for it, or there is no such edition.
    """
    layers, facts = _stored(task.name)
    return unpack_policies(layers, facts_of_edition(facts, edition))


def _stored(name: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Stacked layers and page of facts of a task."""
    folder = files("odaf.environments") / "policies"
    arrays, page = folder / f"{name}.npz", folder / f"{name}.json"
    if not (arrays.is_file() and page.is_file()):
        raise ConfigError(
            f"no behaviour policies of {name} are shipped with this version; train some with "
            f"`odaf behaviour train {name} --out DIR` and add them with `odaf behaviour export DIR`"
        )
    with np.load(io.BytesIO(arrays.read_bytes()), allow_pickle=False) as content:
        layers = {key: content[key] for key in content.files}
    return layers, json.loads(page.read_text(encoding="utf-8"))


def facts_of_edition(facts: Mapping[str, Any], edition: int | None) -> dict[str, Any]:
    """A page of facts as it was in an edition, with its number under "edition"; "earlier" holds, from the first on, the
    levels that were others then."""
    earlier = facts.get("earlier", [])
    newest = len(earlier) + 1
    if edition is not None and not 1 <= edition <= newest:
        editions = "edition 1 only" if newest == 1 else f"editions 1 to {newest}"
        raise ConfigError(f"edition {edition}: {facts.get('task')} has {editions}")
    kept = {name: value for name, value in facts.items() if name != "earlier"}
    for levels in reversed(earlier[edition - 1 :] if edition is not None else []):
        kept |= levels
    return kept | {"edition": newest if edition is None else edition}


def pack_policies(policies: Sequence[GaussianPolicy]) -> dict[str, np.ndarray]:
    """Stacked half-precision layers of policies of one shape."""
    layers = range(len(policies[0].weights))
    weights = {f"weight_{layer}": np.stack([policy.weights[layer] for policy in policies]) for layer in layers}
    biases = {f"bias_{layer}": np.stack([policy.biases[layer] for policy in policies]) for layer in layers}
    return {name: array.astype(np.float16) for name, array in (weights | biases).items()}


def stacked_policies(layers: Mapping[str, np.ndarray]) -> list[GaussianPolicy]:
    """The policies in their order, in single precision."""
    count = sum(name.startswith("weight_") for name in layers)
    weights, biases = (
        [layers[f"{kind}_{layer}"].astype(np.float32) for layer in range(count)] for kind in ("weight", "bias")
    )
    return [
        GaussianPolicy([weight[index] for weight in weights], [bias[index] for bias in biases])
        for index in range(len(weights[0]))
    ]


def unpack_policies(layers: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> ShippedPolicies:
    """Inverse of `pack_policies`, told by the page of facts which policy is which.

    Args:
        layers: the stacked arrays.
        facts: "medium" and "expert" hold an index and a spread, or are None; "replay" holds a length in steps and an
            index (None: uniform actions) for each phase.
    """
    stack = stacked_policies(layers)

    def policy(index: int, spread: float = 1.0) -> GaussianPolicy:
        return replace(stack[index], spread=spread)

    def level(name: str) -> GaussianPolicy | None:
        entry = facts.get(name)
        return None if entry is None else policy(entry["index"], entry["spread"])

    replay = tuple(
        Phase(phase["steps"], None if phase["index"] is None else policy(phase["index"])) for phase in facts["replay"]
    )
    return ShippedPolicies(level("medium"), level("expert"), replay, dict(facts))
