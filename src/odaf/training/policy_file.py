"""What a file of a policy holds: arrays by plain names, and everything else as JSON in the metadata of its header.

The metadata are "format", "version", "odaf" (the version that wrote it), "sha256" (of the JSON and then the arrays in
the order of their names) and "policy":

    actor           the modules that act, as `odaf.components.stored` writes them; arrays are named by their place
    observations    names and units
    actions         names, units, low and high
    normaliser      `Normaliser.to_dict`
    provenance      where the policy comes from, as its holder gave it
    derivation      recipes by which observations are computed from readings, as `odaf.data.derived` writes them;
                    only where there are any. Formulas are texts that polars reads: they run no code
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

import odaf
from odaf.components.policies import Actor
from odaf.components.stored import pack, unpack
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.errors import CheckpointError, DatasetError
from odaf.training.files import plain
from odaf.training.tensors import REMEDY, parsed, read_tensors, write_tensors

FORMAT = "odaf-policy"
VERSION = "1"
_LARGEST = float(np.finfo(np.float32).max)
_SECTIONS = ("actor", "observations", "actions", "normaliser", "provenance")


def write_policy(path: Path, fields: Mapping[str, Any]) -> None:
    """Writes the fields of a `Policy`, whole or not at all.

    Raises:
        ConfigError: the actor is made of modules that cannot be stored.
        CheckpointError: the file cannot be written.
    """
    write_document(path, FORMAT, VERSION, "policy", *packed_policy(fields))


def read_policy(path: Path) -> dict[str, Any]:
    """The fields of a `Policy`; its actor acts with the bits that it had when it was written.

    Raises:
        CheckpointError: the file is missing, damaged, of another kind or version, or contradicts itself.
    """
    content, arrays = read_document(path, FORMAT, VERSION, "policy", _SECTIONS, ("derivation",))
    return unpacked_policy(path, content, arrays)


def write_document(
    path: Path, form: str, version: str, name: str, content: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> None:
    """Writes plain data under `name` in the metadata, and arrays, with what tells a file of this form from others.

    Raises:
        CheckpointError: the file cannot be written.
    """
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    metadata = {
        "format": form,
        "version": version,
        "odaf": odaf.__version__,
        "sha256": _digest(text, arrays),
        name: text,
    }
    write_tensors(path, dict(sorted(arrays.items())), metadata)


def read_document(
    path: Path, form: str, version: str, name: str, sections: Sequence[str], optional: Sequence[str] = ()
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Inverse of `write_document`; the data must have these sections, and may have the optional ones.

    Raises:
        CheckpointError: the file is missing, damaged, or of another kind or version.
    """
    arrays, metadata = read_tensors(path)
    if metadata.get("format") != form:
        _refuse(path, f"format: expected {form!r}, found {metadata.get('format')!r}; it holds arrays, but no {name}")
    if metadata.get("version") != version:
        _refuse(path, f"version: expected {version!r}, found {metadata.get('version')!r}; another odaf wrote it")
    text = metadata.get(name, "")
    content = parsed(path, name, text)
    if set(content) - set(optional) != set(sections):
        _refuse(path, f"{name}: expected {', '.join(sections)}, found {sorted(content)}")
    if metadata.get("sha256") != _digest(text, arrays):
        _refuse(path, "sha256: the content was changed after it was written")
    return content, arrays


def packed_policy(fields: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The fields of a `Policy` as plain data, and its arrays, whose names begin with "actor".

    Raises:
        ConfigError: the actor is made of modules that cannot be stored.
    """
    structure, arrays = pack(fields["actor"], "actor")
    content = {
        "actor": structure,
        "observations": {"names": fields["observation_names"], "units": fields["observation_units"]},
        "actions": {
            "names": fields["action_names"],
            "units": fields["action_units"],
            "low": fields["action_low"],
            "high": fields["action_high"],
        },
        "normaliser": fields["normaliser"].to_dict(),
        "provenance": plain(fields["provenance"]),
    }
    if fields["derivation"] is not None:
        content["derivation"] = {"recipes": fields["derivation"].recipes()}
    return content, arrays


def unpacked_policy(path: Path, content: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Inverse of `packed_policy`; `path` names the file in messages.

    Raises:
        CheckpointError: the content contradicts itself.
    """
    if set(content) - {"derivation"} != set(_SECTIONS):
        _refuse(path, f"policy: expected {', '.join(_SECTIONS)}, found {sorted(content)}")
    try:
        normaliser = Normaliser.from_dict(content["normaliser"])
    except Exception as error:  # whatever it makes of strange content
        _refuse(path, f"normaliser: {error!r}")
    columns = _columns(path, content, len(normaliser.mean))
    try:
        actor = unpack(content["actor"], arrays, "actor")
        acts = _shape_of_an_action(actor, len(normaliser.mean))
    except Exception as error:  # whatever the modules make of numbers that do not fit together
        _refuse(path, f"actor: {error}")
    if acts != ((1, len(columns["action_low"])), jnp.float32):
        _refuse(path, f"actor: acts with {acts[1]}{list(acts[0])}, which does not fit the actions' bounds")
    if not isinstance(content["provenance"], dict):
        _refuse(path, "provenance: must be a JSON object")
    fields = {"actor": actor, "normaliser": normaliser, **columns, "provenance": content["provenance"]}
    return fields | {"derivation": _derivation(path, content, columns)}


def _derivation(path: Path, content: dict[str, Any], columns: Mapping[str, tuple[Any, ...]]) -> Derivation | None:
    """How observations are computed, if they are; it must make those of the file, of the actions of the file."""
    if "derivation" not in content:
        return None
    entry = content["derivation"]
    if not isinstance(entry, dict) or set(entry) != {"recipes"} or not isinstance(entry["recipes"], list):
        _refuse(path, "derivation: expected a list of recipes")
    try:
        found = Derivation.from_recipes(entry["recipes"])
    except DatasetError as error:
        _refuse(path, f"derivation: {error}")
    if found.names != columns["observation_names"]:
        _refuse(path, f"derivation: makes {', '.join(found.names)}, which are not the observations")
    if found.lags and found.actions != columns["action_names"]:
        _refuse(path, f"derivation: remembers {', '.join(found.actions)}, which are not the actions")
    return found


def _columns(path: Path, content: dict[str, Any], obs_dim: int) -> dict[str, tuple[Any, ...]]:
    """Names, units and bounds, as many as there are columns; names of actions and units may be left out."""
    found: dict[str, tuple[Any, ...]] = {}
    for section, prefix, bounds in (("observations", "observation", ()), ("actions", "action", ("low", "high"))):
        entry = content[section]
        if not isinstance(entry, dict) or set(entry) != {"names", "units", *bounds}:
            _refuse(path, f"{section}: expected {', '.join(('names', 'units', *bounds))}")
        if not all(isinstance(value, list) for value in entry.values()):
            _refuse(path, f"{section}: every entry must be a list")
        count = len(entry["low"]) if bounds else obs_dim
        for field, values in entry.items():
            kinds = (int, float) if field in bounds else (str,)
            optional = field == "units" or (section, field) == ("actions", "names")
            if not all(type(value) in kinds for value in values):
                _refuse(path, f"{section}: {field}: holds something of another type")
            if len(values) != count and not (optional and not values):
                _refuse(path, f"{section}: {field}: has {len(values)} entries for {count} columns")
            if field == "names" and len(set(values)) < len(values):
                _refuse(path, f"{section}: {field}: a name stands twice")
            found[f"{prefix}_{field}"] = tuple(values)
    low, high = found["action_low"], found["action_high"]
    if not low or not all(-_LARGEST <= below < above <= _LARGEST for below, above in zip(low, high, strict=True)):
        _refuse(path, f"actions: low {list(low)} and high {list(high)} are no finite bounds in ascending order")
    return found | {"action_low": tuple(map(float, low)), "action_high": tuple(map(float, high))}


def _shape_of_an_action(actor: Any, obs_dim: int) -> tuple[tuple[int, ...], Any]:
    if not isinstance(actor, Actor):
        raise ValueError(f"a {type(actor).__name__} does not act")
    row = jax.ShapeDtypeStruct((1, obs_dim), jnp.float32)
    action, _ = jax.eval_shape(lambda actor, row: actor.act(actor.begin(1), row), actor, row)
    return action.shape, action.dtype


def _digest(text: str, arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(text.encode(errors="surrogatepass"))
    for _, array in sorted(arrays.items()):
        digest.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def _refuse(path: Path, what: str) -> NoReturn:
    raise CheckpointError(f"{path}: {what}. {REMEDY}")
