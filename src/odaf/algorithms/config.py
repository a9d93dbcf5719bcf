"""Learners to and from plain dictionaries: what config.json and preset files hold."""

import dataclasses
import math
import types
from collections.abc import Mapping
from typing import Any, Literal, NoReturn, Union, get_args, get_origin, get_type_hints

from odaf.algorithms.base import Algorithm
from odaf.algorithms.registry import ALGORITHMS, TERMS
from odaf.algorithms.terms import Term
from odaf.errors import ConfigError


def to_dict(algorithm: Algorithm) -> dict[str, Any]:
    """Every field of a learner as JSON types; `from_dict` restores an equal learner."""
    plain: dict[str, Any] = {"kind": algorithm.kind}
    for field in dataclasses.fields(algorithm):  # type: ignore[arg-type]  # every learner is a dataclass
        value = getattr(algorithm, field.name)
        if field.name == "terms":
            plain["terms"] = [{"name": term.name, **_plain(term)} for term in value]
        else:
            plain[field.name] = _plain(value)
    return plain


def from_dict(fields: Mapping[str, Any], source: str = "configuration") -> Algorithm:
    """Build a learner.

    Args:
        fields: "kind" names the learner, the rest its fields; missing fields keep their defaults.
        source: file or place named in error messages.

    Raises:
        ConfigError: an unknown kind, term or field, or a value of the wrong type; the message lists what is known.
    """
    fields = dict(fields)
    kind = fields.pop("kind", None)
    if kind not in ALGORITHMS:
        raise ConfigError(
            f"{source}: kind={kind!r} is not a learner; known: {', '.join(ALGORITHMS)}. One of your own becomes known "
            "by odaf.register(...) in Python, or by an entry point 'odaf.algorithms' of the package that offers it"
        )
    if "terms" in fields:
        if not isinstance(fields["terms"], list | tuple):
            raise ConfigError(f"{source}: terms={fields['terms']!r} must be a list of tables with a name each")
        fields["terms"] = tuple(_term(term, source) for term in fields["terms"])
    return _build(ALGORITHMS[kind], fields, source, kind)


def checked(algorithm: Algorithm) -> Algorithm:
    """The learner as its record restores it, every setting in its field's type: lists become tuples.

    Raises:
        ConfigError: a value of the wrong type, or a number that no learner can have there.
    """
    return from_dict(to_dict(algorithm), "settings")


def replace(algorithm: Algorithm, changes: Mapping[str, Any], source: str = "override") -> Algorithm:
    """A learner with some fields changed.

    Args:
        algorithm: the learner to start from.
        changes: values by dotted name: `num_critics`, a field of one of its tables, as in `behaviour.steps`, or a
            term's field behind the term's name, as in `outcome.weight` and `outcome.dynamics.kind`.
        source: named in error messages.

    Raises:
        ConfigError: the learner has no such field or term, or the value has the wrong type.
    """
    plain = to_dict(algorithm)
    for name, value in changes.items():
        path = name.split(".")
        terms = {term["name"]: term for term in plain.get("terms", [])}
        place: dict[str, Any] = plain
        if len(path) > 1 and not isinstance(plain.get(path[0]), dict):
            if path[0] not in terms:
                known = ", ".join(terms) or "none"
                raise ConfigError(f"{source}: {name!r} names no term of this learner; its terms: {known}")
            place, path = terms[path[0]], path[1:]
        for part in path[:-1]:
            inner = place.get(part)
            place = inner if isinstance(inner, dict) else _unknown(source, name, place)
        fixed = ("kind", "terms") if place is plain else ("name",)  # these say what the thing is
        if path[-1] not in place or path[-1] in fixed:
            _unknown(source, name, place)
        place[path[-1]] = value
    return from_dict(plain, source)


def _unknown(source: str, name: str, place: Mapping[str, Any]) -> NoReturn:
    raise ConfigError(f"{source}: unknown field {name!r}; known here: {', '.join(sorted(place))}")


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    return list(value) if isinstance(value, tuple) else value


def _term(fields: Any, source: str) -> Term:
    if not isinstance(fields, Mapping):
        raise ConfigError(f"{source}: a term must be a table with a name, got {fields!r}")
    fields = dict(fields)
    name = fields.pop("name", None)
    if name not in TERMS:
        raise ConfigError(
            f"{source}: name={name!r} is not a term; known: {', '.join(TERMS)}. One of your own becomes known by "
            "odaf.register(...) in Python, or by an entry point 'odaf.terms' of the package that offers it"
        )
    return _build(TERMS[name], fields, source, name, f"{name}.")


def _build(cls: Any, fields: Mapping[str, Any], source: str, where: str, path: str = "") -> Any:
    hints = get_type_hints(cls)
    known = [field.name for field in dataclasses.fields(cls)]
    values = {}
    for name, value in fields.items():
        if name not in known:
            raise ConfigError(f"{source}: {where} has no field {name!r}; known: {', '.join(known)}")
        hint = hints[name]
        if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
            value = _build(hint, value, source, f"{where}.{name}", f"{path}{name}.")
        values[name] = value if name == "terms" else _checked(value, hint, source, f"{where}.{name}")
        _possible(f"{path}{name}", values[name])
    return cls(**values)


def _possible(name: str, value: Any) -> None:
    """Refuses what no learner can do: what holds for every setting of a kind, and so stands in none of them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name}={value!r} must be a finite number; where no limit is meant, a large one")
    if isinstance(value, float) and name.endswith("learning_rate") and value < 0.0:
        raise ConfigError(f"{name}={value!r} must not be negative: losses would be climbed, not descended")
    if isinstance(value, tuple) and name.endswith("hidden_sizes") and any(width < 1 for width in value):
        raise ConfigError(f"{name}={value!r} must hold widths of at least 1")


def _checked(value: Any, hint: Any, source: str, where: str) -> Any:
    """The value in the field's type; lists become tuples and whole numbers become floats where asked for."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value in (None, "none") and type(None) in arguments:  # TOML has no word for it
            return None
        return _first_that_fits(value, [a for a in arguments if a is not type(None)], hint, source, where)
    if origin is Literal and value in arguments and not isinstance(value, bool):
        return value
    if origin is tuple and isinstance(value, list | tuple):
        return tuple(_checked(item, arguments[0], source, where) for item in value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, type) and isinstance(value, hint) and (hint is bool or not isinstance(value, bool)):
        return value
    raise ConfigError(f"{source}: {where}={value!r} is not of the expected kind: {_expected(hint)}")


def _first_that_fits(value: Any, hints: list[Any], union: Any, source: str, where: str) -> Any:
    for hint in hints:
        try:
            return _checked(value, hint, source, where)
        except ConfigError:
            continue
    raise ConfigError(f"{source}: {where}={value!r} is not of the expected kind: {_expected(union)}")


def _expected(hint: Any) -> str:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " | ".join(map(repr, arguments))
    if origin in (Union, types.UnionType):
        return " | ".join(_expected(argument) for argument in arguments if argument is not type(None))
    return getattr(hint, "__name__", str(hint))
