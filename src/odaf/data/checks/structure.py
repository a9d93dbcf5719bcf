"""Checks that need no pass over the rows: which columns there are, of what type, rank, width and length."""

from collections.abc import Mapping

import numpy as np

from odaf.data import validation
from odaf.data.checks.findings import SHOWN_ROWS, Finding
from odaf.data.checks.stream import FLAGS, Facts
from odaf.data.log import OPTIONAL, REQUIRED, Log
from odaf.errors import DatasetError

_MATRICES = ("observations", "actions", "next_observations")
_EXPORT = "export the column again as numbers, or map texts to numbers first"

# (observation, action) sizes of environments whose name begins so; for files that name theirs.
KNOWN_WIDTHS = {
    "HalfCheetah": (17, 6),
    "Hopper": (11, 3),
    "Walker2d": (17, 6),
    "AntMaze": (29, 8),
    "antmaze": (29, 8),
    "odaf/AntMaze": (29, 8),
    "pointmaze": (4, 2),
}


def examine(log: Log, widths: tuple[int, int] | None) -> tuple[Facts | None, list[Finding]]:
    """The facts about a log, or None where its rows cannot be judged at all, and what is wrong with its columns.

    Args:
        log: the log.
        widths: (obs_dim, act_dim) that the rows must have; None takes those of the environment the log names, if known.
    """
    findings = [_missing(log, name) for name in REQUIRED if name not in log.columns]
    fields: set[str] = set()
    for name in (name for name in (*REQUIRED, *OPTIONAL) if name in log.columns):
        wrong = _type_or_rank(log, name)
        findings += wrong
        if not wrong:
            fields.add(name)
    rows = len(log.columns["observations"]) if "observations" in log.columns else 0
    for name in sorted(fields):
        length = len(log.columns[name])
        if length != rows and "observations" in log.columns:
            fields.discard(name)
            findings.append(
                Finding(
                    "length-mismatch", "error", name, abs(length - rows), (),
                    f"has {length:,} rows, 'observations' has {rows:,}",
                    "every column needs one entry per step: find where rows were lost or added",
                )
            )  # fmt: skip
    if rows == 0:
        if "observations" in log.columns:
            findings.append(
                Finding("no-rows", "error", "", 0, (), "there are no rows", "record some, or check the path")
            )
        return None, findings
    obs_dim = log.columns["observations"].shape[1] if "observations" in fields else 0
    act_dim = log.columns["actions"].shape[1] if "actions" in fields else 0
    findings += _widths(log, fields, obs_dim, act_dim, widths)
    if "next_observations" in fields and log.columns["next_observations"].shape[1] != obs_dim:
        fields.discard("next_observations")
    names = log.action_names or tuple(f"action_{index}" for index in range(act_dim))
    low, high, wrong = _bounds(log, names, act_dim)
    return Facts(log, rows, frozenset(fields), obs_dim, act_dim, names, low, high), findings + wrong


def _missing(log: Log, name: str) -> Finding:
    present = sorted(log.columns)
    return Finding(
        "field-missing", "error", name, 1, (), f"is missing; present are {present}",
        f"say which column holds the {name}, or record them",
    )  # fmt: skip


def _type_or_rank(log: Log, name: str) -> list[Finding]:
    column = log.columns[name]
    kind = np.dtype(column.dtype).kind
    if name == "episode":
        allowed = "biufSUOM"
    elif name == "time":
        allowed = "iufM"
    else:
        allowed = "biuf"
    if kind not in allowed:
        return [_not_numbers(log, name)]
    axes = len(column.shape)
    single = axes == 1 or (axes == 2 and column.shape[1] == 1)
    if name in _MATRICES and (axes != 2 or column.shape[1] == 0):
        remedy = "give one row per step: an array of one number per step needs a second axis of length 1"
        if axes > 2:
            remedy = "flatten each row to one axis; pictures are not supported"
        return [_shape(name, column.shape, "[rows, dimensions]", remedy)]
    if name not in _MATRICES and not single:
        return [_shape(name, column.shape, "[rows]", "give one value per step")]
    return []


def _shape(name: str, shape: tuple[int, ...], expected: str, remedy: str) -> Finding:
    return Finding("wrong-shape", "error", name, 1, (), f"must be {expected}, its shape is {shape}", remedy)


def _not_numbers(log: Log, name: str) -> Finding:
    """Passes over the one column to say which entries do not read as numbers."""
    column = log.columns[name]
    count, rows, example = 0, [], ""
    for first in range(0, len(column), 65_536):
        piece = np.asarray(column[first : first + 65_536])
        for place, value in enumerate(piece.reshape(len(piece), -1)):
            if all(_reads_as_number(entry) for entry in value):
                continue
            count += 1
            if len(rows) < SHOWN_ROWS:
                rows.append(first + place)
                example = example or next(repr(entry) for entry in value if not _reads_as_number(entry))
    what = f"holds {np.dtype(column.dtype)} values, not numbers"
    if count:
        return Finding(
            "not-numbers",
            "error",
            name,
            count,
            tuple(rows),
            f"{what}; {example} is none",
            _EXPORT,
        )
    return Finding("not-numbers", "error", name, len(column), (), f"{what}, although each reads as one", _EXPORT)


def _reads_as_number(entry: object) -> bool:
    try:
        float(entry)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def _widths(log: Log, fields: set[str], obs_dim: int, act_dim: int, widths: tuple[int, int] | None) -> list[Finding]:
    findings = []
    environment, origin = log.provenance.get("environment"), "the environment asked for"
    if widths is None and isinstance(environment, Mapping):
        name = str(environment.get("id") or environment.get("name") or "")
        widths = next((size for start, size in KNOWN_WIDTHS.items() if name.startswith(start)), None)
        origin = name
    for name, width, index in (("observations", obs_dim, 0), ("actions", act_dim, 1)):
        if widths is None or name not in fields or width == widths[index]:
            continue
        hint = "take the data of that environment, or name the right one"
        if index == 0 and (width, widths[0]) == (27, 29):
            hint = "the position is missing: put the achieved goal in front of each observation"
        findings.append(
            Finding(
                "wrong-width", "error", name, 1, (), f"has {width} columns, {origin} needs {widths[index]}", hint
            )
        )  # fmt: skip
    if "next_observations" in fields and "observations" in fields:
        width = log.columns["next_observations"].shape[1]
        if width != obs_dim:
            findings.append(
                Finding(
                    "wrong-width", "error", "next_observations", 1, (),
                    f"has {width} columns, 'observations' has {obs_dim}",
                    "both must describe the same quantities in the same order",
                )
            )  # fmt: skip
    for field, given, width in (
        ("observations", log.observation_names, obs_dim),
        ("actions", log.action_names, act_dim),
    ):
        if given is not None and field in fields and len(given) != width:
            findings.append(
                Finding(
                    "wrong-width", "error", field, 1, (), f"has {width} columns but {len(given)} names",
                    "give one name per column",
                )
            )  # fmt: skip
    return findings


def _bounds(
    log: Log, names: tuple[str, ...], act_dim: int
) -> tuple[np.ndarray | None, np.ndarray | None, list[Finding]]:
    if log.action_bounds is None or act_dim == 0 or len(names) != act_dim:
        return None, None, []
    try:
        pair = validation.action_bounds(log.source, np.zeros((1, act_dim), np.float32), names, log.action_bounds)
    except DatasetError as error:
        text = str(error).removeprefix(f"{log.source}: ").removeprefix("field 'action_bounds': ")
        message, _, remedy = text.rpartition("; ")
        return None, None, [Finding("action-bounds", "error", "actions", 1, (), message or text, remedy)]
    return pair[0], pair[1], []


def flags_present(facts: Facts) -> tuple[str, ...]:
    """The end flags that the log has."""
    return tuple(name for name in FLAGS if name in facts.fields)
