"""Tuned settings as data files, one TOML file a preset; this package only finds and reads them."""

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any

from odaf.errors import ConfigError


def names() -> dict[str, str]:
    """Every preset and its one-line description, in alphabetical order. Loads no array library."""
    return {name: _read(name)["description"] for name in _files()}


def settings(name: str) -> dict[str, Any]:
    """A preset's fields as the file gives them, after following `extends`.

    Raises:
        ConfigError: there is no such preset; the message lists those that exist.
    """
    fields = _read(name)
    base = settings(fields.pop("extends")) if "extends" in fields else {}
    terms = {term["name"]: term for term in base.get("terms", [])}
    for term in fields.pop("terms", []):
        terms[term["name"]] = _merged(terms.get(term["name"], {}), term)
    for term in fields.pop("without", []):
        del terms[term]
    merged = _merged(base, fields)
    return merged | ({"terms": list(terms.values())} if terms or "terms" in base else {})


def load(name: str, overrides: Mapping[str, Any] | None = None) -> Any:
    """The learner a preset describes.

    Args:
        name: one of `names()`.
        overrides: fields to change, by dotted name, as in {"num_critics": 4, "outcome.weight": 1.0}.

    Returns:
        A frozen learner, ready for `odaf.fit`.

    Raises:
        ConfigError: unknown preset, field or value.
    """
    from odaf.algorithms import config  # loads JAX; listing presets must not

    fields = settings(name)
    for key in ("description", "source"):
        fields.pop(key, None)
    algorithm = config.from_dict(fields, f"preset {name}")
    return config.replace(algorithm, overrides, f"preset {name}") if overrides else algorithm


def _files() -> list[str]:
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in resources.files(__name__).iterdir()
        if entry.name.endswith(".toml")
    )


def _read(name: str) -> dict[str, Any]:
    if name not in _files():
        raise ConfigError(f"preset {name!r} does not exist; known: {', '.join(_files())}")
    return tomllib.loads(resources.files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes over base, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return merged
