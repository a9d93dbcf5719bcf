"""Tuned settings as data files; this package only finds and reads them.

A preset is a TOML file here, or one of the user's own, named by its path. `by_task/PRESET.toml` holds what differs by
task: a table for each task with fields of the learner, and a term's fields under the term's name. A preset has the
tasks of the preset that it extends as well.
"""

import os
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from odaf.errors import ConfigError


def names() -> dict[str, str]:
    """Every preset and its one-line description, in alphabetical order. Loads no array library."""
    return {name: _read(name)["description"] for name in _files()}


def settings(name: str) -> dict[str, Any]:
    """A preset's fields as the file gives them, after following `extends`.

    Raises:
        ConfigError: there is no such preset, or it drops a term that its base has not; the message lists those known.
    """
    fields = _read(name)
    base = settings(fields.pop("extends")) if "extends" in fields else {}
    terms = {term["name"]: term for term in base.get("terms", [])}
    for term in fields.pop("terms", []):
        terms[term["name"]] = _merged(terms.get(term["name"], {}), term)
    for term in fields.pop("without", []):
        if terms.pop(term, None) is None:
            raise ConfigError(f"preset {name}: without names {term!r}, which is no term; known: {', '.join(terms)}")
    merged = _merged(base, fields)
    return merged | ({"terms": list(terms.values())} if terms or "terms" in base else {})


def tasks(name: str) -> dict[str, dict[str, Any]]:
    """What a preset changes for each task that it knows, by dotted name; loads no array library.

    Raises:
        ConfigError: there is no such preset; the message lists those that exist.
    """
    return {task: dotted(changes) for task, changes in _tasks(name).items()}


def load(name: str, overrides: Mapping[str, Any] | None = None, *, task: str | None = None) -> Any:
    """The learner a preset describes.

    Args:
        name: one of `names()`, or the path of a TOML file of your own.
        overrides: fields to change, by dotted name, as in {"num_critics": 4, "outcome.weight": 1.0}.
        task: one of `tasks(name)`, whose values replace the preset's; None takes the preset as it is.

    Returns:
        A frozen learner, ready for `odaf.fit`.

    Raises:
        ConfigError: unknown preset, task, field or value.
    """
    from odaf.algorithms import config  # loads JAX; listing presets must not

    fields = settings(name)
    for key in ("description", "source"):
        fields.pop(key, None)
    algorithm = config.from_dict(fields, f"preset {name}")
    if task is not None:
        known = tasks(name)
        if task not in known:
            raise ConfigError(
                f"preset {name} has no values for the task {task!r}; known: {', '.join(known) or 'none'}. "
                "Leave the task out to take the preset as it is"
            )
        algorithm = config.replace(algorithm, known[task], f"preset {name}, task {task}")
    return config.replace(algorithm, overrides, f"preset {name}") if overrides else algorithm


def dotted(fields: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Tables inside tables as one level of dotted names."""
    flat: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            flat |= dotted(value, f"{before}{name}.")
        else:
            flat[f"{before}{name}"] = value
    return flat


def _files() -> list[str]:
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in resources.files(__name__).iterdir()
        if entry.name.endswith(".toml")
    )


def is_file(name: str) -> bool:
    """Whether a preset is named by the path of a file: it ends in .toml or has a folder in it."""
    return name.endswith(".toml") or "/" in name or os.sep in name


def description(name: str) -> str:
    """One line about a preset; empty where a file of the user's own has none."""
    return str(_read(name).get("description", ""))


def _read(name: str) -> dict[str, Any]:
    if is_file(name):
        return _read_own(name)
    if name not in _files():
        raise ConfigError(
            f"preset {name!r} does not exist; known: {', '.join(_files())}; a file of your own is named by its path, "
            f"as in ./{name}.toml"
        )
    return tomllib.loads(resources.files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def _read_own(name: str) -> dict[str, Any]:
    """A preset of the user's own; `extends` names one of ours, or a file beside it."""
    path = Path(name)
    try:
        fields = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"preset {name}: there is no such file; known presets: {', '.join(_files())}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(
            f"preset {name}: cannot be read as TOML ({error}); compare it with the example in docs/reference/presets.md"
        ) from None
    base = fields.get("extends")
    if base is None and "kind" not in fields:
        raise ConfigError(f'preset {name}: needs a line such as extends = "odaf", or kind = "ensemble-sac"')
    if base is not None and is_file(str(base)):
        fields["extends"] = str(path.parent / base)
    return fields


def _tasks(name: str) -> dict[str, dict[str, Any]]:
    """The tables of the preset that this one extends, without the terms that it drops, and its own over them."""
    preset = _read(name)
    inherited = _tasks(preset["extends"]) if "extends" in preset else {}
    dropped = preset.get("without", [])
    tables = {
        task: {key: value for key, value in changes.items() if key not in dropped}
        for task, changes in inherited.items()
    }
    return tables | {task: _merged(tables.get(task, {}), changes) for task, changes in _task_file(name).items()}


def _task_file(name: str) -> dict[str, dict[str, Any]]:
    if is_file(name):
        return {}
    file = resources.files(__name__).joinpath("by_task", f"{name}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes over base, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return merged
