"""Modules as plain data and named arrays, and back: what a file of a policy holds in place of code.

A module becomes {"kind": its name in `KINDS`, field: value, ...}. Arrays become {"array": shape}, and the array itself
goes under the path of its field, such as actor/network/weights/0; tuples become lists; static fields stand as they are.
"""

import dataclasses
import math
from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from odaf.components.critics import CriticEnsemble
from odaf.components.cvae import CVAE
from odaf.components.dynamics.cvae import CVAEDynamics
from odaf.components.dynamics.deterministic import DeterministicDynamics
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics
from odaf.components.networks import MLP
from odaf.components.policies import (
    DeterministicActor,
    ExactGaussianActor,
    GaussianActor,
    NarrowGaussianActor,
    UnsquashedGaussianActor,
)
from odaf.components.priors import Priors
from odaf.components.ranked_actors import PerturbedActor, RankedGaussianActor
from odaf.components.return_conditioned import ReturnConditionedActor
from odaf.errors import ConfigError

KINDS: dict[str, type[eqx.Module]] = {
    "critics": CriticEnsemble,
    "cvae": CVAE,
    "cvae-dynamics": CVAEDynamics,
    "deterministic": DeterministicActor,
    "deterministic-dynamics": DeterministicDynamics,
    "ensemble-dynamics": GaussianEnsembleDynamics,
    "exact-gaussian": ExactGaussianActor,
    "gaussian": GaussianActor,
    "mlp": MLP,
    "narrow-gaussian": NarrowGaussianActor,
    "perturbed": PerturbedActor,
    "priors": Priors,
    "ranked-gaussian": RankedGaussianActor,
    "return-conditioned": ReturnConditionedActor,
    "unsquashed-gaussian": UnsquashedGaussianActor,
}
"""Modules that files may name. Add a class of your own under a name of its own to store actors made of it; it must be
made by its fields alone, and hold arrays, modules of `KINDS`, tuples of these, None, and plain static values."""


def pack(module: eqx.Module, path: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The plain data of a module and its arrays by path.

    Raises:
        ConfigError: the module holds something that `unpack` could not make again.
    """
    arrays: dict[str, np.ndarray] = {}
    structure = _packed(module, path, arrays)
    return structure, arrays


def unpack(structure: Any, arrays: Mapping[str, np.ndarray], path: str) -> eqx.Module:
    """Inverse of `pack`, with the same bits.

    Raises:
        ValueError: the structure names an unknown kind, is not what a module of its kind is made of, or does not fit
            the arrays. A module that checks its fields may raise more.
    """
    used: set[str] = set()
    module = _unpacked(structure, arrays, path, used)
    if not isinstance(module, eqx.Module):
        raise ValueError(f"{path}: expected a module, found {structure!r}")
    if left := sorted(set(arrays) - used):
        raise ValueError(f"arrays that belong to nothing: {', '.join(map(repr, left[:3]))}")
    return module


def _packed(value: Any, path: str, arrays: dict[str, np.ndarray]) -> Any:
    if value is None:
        return None
    if isinstance(value, tuple):
        return [_packed(item, f"{path}/{index}", arrays) for index, item in enumerate(value)]
    if isinstance(value, jax.Array | np.ndarray):
        arrays[path] = np.asarray(value)
        return {"array": list(value.shape)}
    kind = next((kind for kind, known in KINDS.items() if type(value) is known), None)
    if kind is None:
        raise ConfigError(
            f"{path}: a {type(value).__name__} cannot be stored; "
            'register its class as odaf.components.stored.KINDS["name of its own"] before saving and before loading'
        )
    fields: dict[str, Any] = {"kind": kind}
    for field in dataclasses.fields(value):
        inner, place = getattr(value, field.name), f"{path}/{field.name}"
        if field.metadata.get("static", False):
            try:
                fields[field.name] = _plain(inner)
                _static(field.type, fields[field.name])
            except ValueError as error:
                raise ConfigError(f"{place}: cannot be stored: {error}") from None
        else:
            fields[field.name] = _packed(inner, place, arrays)
    return fields


def _unpacked(structure: Any, arrays: Mapping[str, np.ndarray], path: str, used: set[str]) -> Any:
    if structure is None:
        return None
    if isinstance(structure, list):
        return tuple(_unpacked(item, arrays, f"{path}/{index}", used) for index, item in enumerate(structure))
    if not isinstance(structure, dict):
        raise ValueError(f"{path}: expected a module, an array or a list of them, found {structure!r}")
    if set(structure) == {"array"}:
        return _array(structure["array"], arrays, path, used)
    kind = structure.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(
            f"{path}: kind {kind!r} is not known; known are {', '.join(sorted(KINDS))}; "
            "if it is of a package of your own, import that first, so that its classes are registered"
        )
    known = {field.name: field for field in dataclasses.fields(KINDS[kind])}
    if set(structure) != {"kind", *known}:
        raise ValueError(f"{path}: a module of kind {kind} has the fields {', '.join(known)}, not {sorted(structure)}")
    values = {}
    for name, field in known.items():
        place = f"{path}/{name}"
        if not field.metadata.get("static", False):
            values[name] = _unpacked(structure[name], arrays, place, used)
            continue
        try:
            values[name] = _static(field.type, structure[name])
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from None
    return KINDS[kind](**values)


def _array(shape: Any, arrays: Mapping[str, np.ndarray], path: str, used: set[str]) -> jax.Array:
    if path not in arrays:
        raise ValueError(f"{path}: its array is missing")
    array = arrays[path]
    if shape != list(array.shape):
        raise ValueError(f"{path}: expected an array of shape {shape!r}, found {list(array.shape)}")
    if jax.dtypes.canonicalize_dtype(array.dtype) != array.dtype:
        raise ValueError(f"{path}: JAX would not keep the type {array.dtype} as it is")
    used.add(path)
    return jnp.asarray(array)


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _static(annotation: Any, value: Any) -> Any:
    """A static field's value, checked against its annotation; lists become tuples."""
    origin, options = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        fits = any(type(value) is type(option) and value == option for option in options)
    elif origin in (Union, UnionType):
        for option in options:
            try:
                return _static(option, value)
            except ValueError:
                continue
        fits = False
    elif origin is tuple and len(options) == 2 and options[1] is Ellipsis and isinstance(value, list):
        return tuple(_static(options[0], item) for item in value)
    elif annotation is float:
        fits = type(value) in (int, float) and math.isfinite(value)
        return float(value) if fits else _misfit(annotation, value)
    else:
        fits = annotation in (int, str, bool, NoneType) and type(value) is annotation
        fits = fits or (annotation is None and value is None)
    return value if fits else _misfit(annotation, value)


def _misfit(annotation: Any, value: Any) -> Any:
    name = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    raise ValueError(f"expected {name}, found {value!r}")
