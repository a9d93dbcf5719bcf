"""Command-line options made from dataclasses, so that a setting is described once: where it is defined."""

import ast
import dataclasses
import inspect
import itertools
import textwrap
from typing import Annotated, Any, TypeVar, get_type_hints

import tyro

from odaf.cli import spelling

Options = TypeVar("Options")

TERMS = "terms"


def parse(kind: type[Options], arguments: list[str], command: str) -> Options:
    """Read a command's options; prints help or what is wrong with them, and exits.

    Args:
        kind: dataclass whose fields are the options and whose docstring is the help page's first lines.
        arguments: words after the command.
        command: what the user typed before them, for the help page.
    """
    spelling.command_takes(_names(kind))
    return tyro.cli(kind, args=arguments, prog=f"odaf {command}")


def _names(kind: type) -> set[str]:
    """Names of the options of a dataclass, those of its groups included."""
    types = get_type_hints(kind)
    groups = [found for found in types.values() if dataclasses.is_dataclass(found) and isinstance(found, type)]
    return {field.name for field in dataclasses.fields(kind)}.union(*(_names(group) for group in groups))


def field_help(kind: type) -> dict[str, str]:
    """The string under each field of a dataclass, its bases included, as one line each."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        try:
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        except (OSError, TypeError):  # a class made at run time has no source
            continue
        statements = body.body if isinstance(body, ast.ClassDef) else []
        for field, text in itertools.pairwise(statements):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            ):
                found[field.target.id] = " ".join(text.value.value.split())
    return found


def settings_of(algorithm: Any) -> list[tuple[str, Any, Any]]:
    """Options for every field of an algorithm, as `dataclasses.make_dataclass` takes them.

    A field keeps its name, type and help line; its default is the algorithm's own value. Each term of the algorithm
    becomes a group named after the term.
    """
    entries = [entry for entry in _fields_of(algorithm) if entry[0] != TERMS]
    for term in getattr(algorithm, TERMS, ()):
        group = dataclasses.make_dataclass(
            f"{type(term).__name__}Options", _fields_of(term), frozen=True, namespace={"__doc__": _first_line(term)}
        )
        entries.append((term.name, group, dataclasses.field(default_factory=group)))
    return entries


def run_settings() -> type:
    """A dataclass of options for every field of `RunSettings` but `evaluate`, which has options of its own."""
    from odaf.training.settings import RunSettings

    entries = [entry for entry in _fields_of(RunSettings()) if entry[0] != "evaluate"]
    for place, (name, annotation, value) in enumerate(entries):
        if name in ("workers", "cores"):
            entries[place] = (name, Annotated[annotation, tyro.conf.arg(metavar="INT")], value)
    return dataclasses.make_dataclass(
        "RunSettingsOptions", entries, frozen=True, namespace={"__doc__": "How the run is to go."}
    )


def with_settings(algorithm: Any, options: Any) -> Any:
    """The algorithm with the values that `settings_of` made options for."""
    changes = {name: getattr(options, name) for name, _, _ in _fields_of(algorithm) if name != TERMS}
    terms = getattr(algorithm, TERMS, ())
    if terms:
        changes[TERMS] = tuple(
            dataclasses.replace(
                term, **{name: getattr(getattr(options, term.name), name) for name, _, _ in _fields_of(term)}
            )
            for term in terms
        )
    return dataclasses.replace(algorithm, **changes)


def _fields_of(instance: Any) -> list[tuple[str, Any, Any]]:
    kind = type(instance)
    types, helps = get_type_hints(kind, include_extras=True), field_help(kind)
    entries = []
    for field in dataclasses.fields(kind):
        if not field.init:
            continue
        value = getattr(instance, field.name)
        annotation = types[field.name]
        if field.name in helps:
            annotation = Annotated[annotation, tyro.conf.arg(help=helps[field.name])]
        entries.append((field.name, annotation, dataclasses.field(default=value)))
    return entries


def _first_line(instance: Any) -> str:
    return (type(instance).__doc__ or "").strip().partition("\n")[0]
