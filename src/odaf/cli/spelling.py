"""Messages in the spelling of the command line: options with dashes, and the command that takes those of a reader.

Messages name options as Python writes them (`reward=0.0`, see `odaf.errors`). Here they become `--constant-reward 0.0`
where the running command has the option, and where only `odaf data import` has it, that command is named.
"""

import ast
import os
import re
import shlex
from collections.abc import Iterable

from odaf.errors import OPTION, OdafError

# What may follow the sign: a text, a list, a number, or a word of Python.
_VALUE = re.compile(r"\"[^\"]*\"|'[^']*'|\[[^\]]*\]|\{[^}]*\}|\([^)]*\)|-?\d+(?:\.\d+)?(?:e[+-]?\d+)?|None|True|False")

# What Python says with a value of another kind has an option of its own on the command line.
_NUMBER_OF = {"reward": "--constant-reward {}", "episode": "--single-episode"}
_FALSE_OF = {"terminated": "--never-terminated"}

_state: dict[str, frozenset[str]] = {"options": frozenset()}


def command_takes(options: Iterable[str]) -> None:
    """Says which options the running command has, by the names of Python's arguments."""
    _state["options"] = frozenset(options)


def spelled(text: str) -> str:
    """The text with each option of the running command, or of `odaf data import`, as the command line writes it."""
    known = _state["options"] | reader_options()
    parts, end = [], 0
    for match in OPTION.finditer(text):
        if match.start() < end or match[1] not in known:
            continue
        value = _VALUE.match(text, match.end())
        parts += [text[end : match.start()], _flag(match[1], "" if value is None else value[0])]
        end = match.end() if value is None else value.end()
    return "".join((*parts, text[end:]))


def explained(error: OdafError) -> str:
    """The message of an error, with the command to run first where the running one lacks an option that it names."""
    text = str(error)
    message = spelled(text)
    lacking = [name for name in OPTION.findall(text) if name in reader_options() - _state["options"]]
    if not lacking:
        return message
    place = text.partition(": ")[0]
    file = shlex.quote(place) if os.path.exists(place) else "FILE"
    first = next((remedy for remedy in error.takeable() if OPTION.search(remedy)), text)
    wanted = _flags(first)
    return f"{message}. This command takes no such option; first run `odaf data import {file} {wanted} --out NEW.h5`"


def reader_options() -> frozenset[str]:
    """Names, as Python has them, of the options that `odaf data import` takes."""
    from dataclasses import fields

    from odaf.cli.readers import ReaderOptions

    return frozenset(field.name for field in fields(ReaderOptions))


def _flags(remedy: str) -> str:
    """The options that a remedy names, as words of a command, an ellipsis in the place of each value that it lacks."""
    flags = []
    for match in OPTION.finditer(remedy):
        value = _VALUE.match(remedy, match.end())
        flags.append(_flag(match[1], value[0]) if value else f"{_flag(match[1], '')} ...")
    return " ".join(dict.fromkeys(flags))


def _flag(name: str, value: str) -> str:
    flag = f"--{name.replace('_', '-')}"
    if not value:
        return flag
    if value[0] in "-0123456789" and name in _NUMBER_OF:
        return _NUMBER_OF[name].format(value)
    if value == "False" and name in _FALSE_OF:
        return _FALSE_OF[name]
    if value in ("True", "None", "False"):
        return flag if value == "True" else f"no {flag}"
    return f"{flag} {' '.join(_words(value))}"


def _words(value: str) -> list[str]:
    """A value of Python as words of the shell."""
    try:
        content = ast.literal_eval(value)
    except (ValueError, SyntaxError):  # no value but a description of one, such as (x, y)
        content = [word.strip() for word in value.strip("[](){}").split(",")]
    if isinstance(content, dict):
        return [str(edge) for pair in content.values() for edge in pair]
    entries = content if isinstance(content, (list, tuple)) else [content]
    return [shlex.quote(str(entry)) for entry in entries]
