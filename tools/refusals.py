"""Writes docs/reference/refusals.md: every message that refuses something, and the remedy that it names.

The messages are read from the source, not run: wherever the code makes an `OdafError`, its text is taken with the parts
that are filled in at run time as words in angle brackets. `make refusals` writes the page; a test compares it.
"""

import ast
import functools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "odaf"
PAGE = ROOT / "docs" / "reference" / "refusals.md"

ERRORS = ("OdafError", "DatasetError", "ConfigError", "CheckpointError", "DivergenceError")
COMMAND = "make refusals"
_HEAD = """# Refusals and their remedies

Every message with which odaf refuses something, by the part that says it. Words in `<angle brackets>` are filled in
when it happens; messages begin with the file or the place, which is left out here. Options are written as in Python,
`reward=0.0`; the command line shows the same message with `--constant-reward 0.0`. Of several remedies a message shows
those whose options exist where you are.

This page is made from the code: `{command}` writes it again.
"""


# The function around a message, and its module.
Scopes = tuple[ast.AST, ...]


@dataclass(frozen=True, order=True)
class Refusal:
    """One message.

    Attributes:
        module: dotted, without the package's name.
        message: what is wrong.
        remedy: what to do; empty where the message has it nowhere of its own.
    """

    module: str
    message: str
    remedy: str


def refusals_in(text: str, module: str) -> list[Refusal]:
    """Every message of one file, in the order of the text."""
    tree = ast.parse(text)
    found = []
    for scopes, call in _errors_made(tree):
        arguments = [argument for argument in call.args if not isinstance(argument, ast.Starred)]
        options = [
            _text(remedy, scopes)
            for keyword in call.keywords
            if keyword.arg == "remedies"
            for remedy in _entries(keyword.value, scopes)
        ]
        for message in _texts(arguments[0], scopes) if arguments else ["<message>"]:
            what, remedy = _parted(message, bool(options))
            found.append(Refusal(module, what, ", or ".join(options) or remedy))
    return found


@functools.cache
def all_refusals() -> list[Refusal]:
    """Every message of the package, each once, by module."""
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        module = ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        found += refusals_in(path.read_text(encoding="utf-8"), module)
    return sorted(set(found))


def page() -> str:
    """The page as it should be."""
    lines = [_HEAD.format(command=COMMAND)]
    module = ""
    for refusal in all_refusals():
        if refusal.module != module:
            module = refusal.module
            lines += [f"\n## {module}\n", "| refused | what to do |", "|---|---|"]
        lines.append(f"| {_cell(refusal.message)} | {_cell(refusal.remedy) or 'as the message says'} |")
    return "\n".join(lines) + "\n"


def _errors_made(tree: ast.Module) -> Iterator[tuple[Scopes, ast.Call]]:
    """(where its names may be explained, the call) wherever an error of ours is made."""

    def walk(node: ast.AST, scopes: Scopes) -> Iterator[tuple[Scopes, ast.Call]]:
        for child in ast.iter_child_nodes(node):
            inside = (child, tree) if isinstance(child, ast.FunctionDef) else scopes
            if isinstance(child, ast.Call) and isinstance(child.func, ast.Name) and child.func.id in ERRORS:
                yield scopes, child
            yield from walk(child, inside)

    return walk(tree, (tree,))


def _texts(node: ast.expr, scopes: Scopes) -> list[str]:
    """The texts that an expression may have: one for each branch of a choice, or for each value of a variable."""
    if isinstance(node, ast.IfExp):
        return _texts(node.body, scopes) + _texts(node.orelse, scopes)
    if isinstance(node, ast.Name):
        values = _assigned(node.id, scopes)
        return [text for value in values for text in _texts(value, scopes)] or [f"<{node.id}>"]
    return [_text(node, scopes)]


def _text(node: ast.expr, scopes: Scopes) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(value, scopes) for value in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left, scopes) + _text(node.right, scopes)
    if isinstance(node, ast.FormattedValue):
        values = _assigned(node.value.id, scopes) if isinstance(node.value, ast.Name) else []
        if len(values) == 1 and isinstance(values[0], (ast.Constant, ast.JoinedStr)):
            return _text(values[0], scopes)  # a part of the message that stands in a variable
        return f"<{_word(node.value)}>"
    if isinstance(node, ast.IfExp):
        return _text(node.body, scopes) or _text(node.orelse, scopes)
    return f"<{_word(node)}>"


def _entries(node: ast.expr, scopes: Scopes) -> list[ast.expr]:
    """The elements of a list of remedies, also of one that stands in a variable."""
    if isinstance(node, (ast.List, ast.Tuple)):
        entries: list[ast.expr] = []
        for entry in node.elts:
            entries += _entries(entry.value, scopes) if isinstance(entry, ast.Starred) else [entry]
        return entries
    if isinstance(node, ast.IfExp):
        return _entries(node.body, scopes) + _entries(node.orelse, scopes)
    if isinstance(node, ast.Name):
        return [entry for value in _assigned(node.id, scopes) for entry in _entries(value, scopes)] or [node]
    return [node]


def _assigned(name: str, scopes: Scopes) -> list[ast.expr]:
    """What a function, or else its module, gives to a variable, in the order of the text."""
    for scope in scopes:
        nodes = scope.body if isinstance(scope, ast.Module) else ast.walk(scope)
        found = [
            node.value
            for node in nodes
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name) and target.id == name
        ]
        if found:
            return found
    return []


def _word(node: ast.expr) -> str:
    """A word or two for what is filled in."""
    if isinstance(node, ast.Name):
        return node.id.replace("_", " ").strip()
    if isinstance(node, ast.Attribute):
        return node.attr.replace("_", " ").strip()
    if isinstance(node, ast.Subscript):
        return _word(node.value)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "len" and node.args:
        return f"number of {_word(node.args[0])}"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "join" and node.args:
        return _word(node.args[0])
    if isinstance(node, ast.Call):
        return _word(node.args[0]) if node.args else _word(node.func)
    if isinstance(node, (ast.GeneratorExp, ast.ListComp)):
        return _word(node.generators[0].iter)
    return "value"


def _parted(message: str, remedies_apart: bool) -> tuple[str, str]:
    """(what is wrong, what to do), parted where the house style parts them; the place in front is left out."""
    for place in ("<source>: ", "<path>: ", "<fspath>: ", "<file>: "):
        message = message.removeprefix(place)
    what, mark, remedy = ("", "", message) if remedies_apart else message.rpartition("; ")
    return (what, remedy) if mark else (message, "")


def _cell(text: str) -> str:
    """Text for a cell of a Markdown table."""
    for raw, shown in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "&#124;"), ("\n", " "), ("*", "\\*")):
        text = text.replace(raw, shown)
    return text.replace("_", "\\_").strip()


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE.relative_to(ROOT)}: {len(all_refusals())} refusals", file=sys.stderr)
