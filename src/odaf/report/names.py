"""What each run is called: its method, and beside runs of the same method what differs between them."""

import contextlib
import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from odaf.errors import ConfigError
from odaf.report.configuration import ABSENT, flatten
from odaf.report.records import RunRecord, data_prints, environment_name

ALL_UP_TO = 3
"""So many settings that differ are all named; of more, those that tell the runs apart."""

_LONGEST = 40  # characters of a value; a longer one tells little and fills the page


def names_of(runs: Sequence[RunRecord], given: Sequence[str] | None = None) -> list[str]:
    """A name for each run, unique among them.

    Runs of one preset are named by the settings in which they differ ("odaf, num_critics 4"), then by the length of the
    training, where they were evaluated, their data and their seeds. Runs that differ in none of these are told apart by
    their directories.

    Args:
        runs: in the order of the report.
        given: names chosen by the user, one a run; None makes them.

    Raises:
        ConfigError: `given` has another number of names than there are runs, an empty one, or one twice.
    """
    if given is not None:
        return _checked(list(given), runs)
    groups: defaultdict[str, list[int]] = defaultdict(list)
    for index, run in enumerate(runs):
        groups[run.method].append(index)
    names = [run.method for run in runs]
    for method, members in groups.items():
        if len(members) > 1:
            for index, told in zip(members, _told_apart([runs[index] for index in members]), strict=True):
                names[index] = ", ".join([method, *told])
    alike = _repeated(names)
    pairs = list(zip(names, runs, strict=True))
    placed = [f"{name} ({run.directory.name})" if name in alike else name for name, run in pairs]
    alike = _repeated(placed)
    return [
        f"{name} ({run.directory})" if place in alike else place
        for place, (name, run) in zip(placed, pairs, strict=True)
    ]


def listed(names: Sequence[str]) -> str:
    """Names in a row; those that hold a comma are parted by semicolons."""
    return ("; " if any("," in name for name in names) else ", ").join(names)


def _checked(names: list[str], runs: Sequence[RunRecord]) -> list[str]:
    if len(names) != len(runs):
        raise ConfigError(
            f"{len(names)} names for {len(runs)} runs ({', '.join(str(run.directory) for run in runs)}); "
            "give names= one for each run, in their order"
        )
    if any(not name.strip() for name in names):
        raise ConfigError("a name is empty; give names= one for each run")
    twice = _repeated(names)
    if twice:
        raise ConfigError(f"the name {sorted(twice)[0]!r} is given twice; give names= another for each run")
    return names


def _told_apart(runs: Sequence[RunRecord]) -> list[list[str]]:
    """For each of several runs of one method, the settings that name it."""
    prints = [str(print_) for print_ in data_prints(runs)]
    several = len(set(prints)) > 1
    files = _files(runs, prints)
    entries = [
        _settings(run, files[print_], print_[:8] if several else "") for run, print_ in zip(runs, prints, strict=True)
    ]
    fields = list(dict.fromkeys(field for one in entries for field in one))
    values = {field: [one.get(field, ABSENT) for one in entries] for field in fields}
    differing = [field for field in fields if len(set(values[field])) > 1]
    learner = [field for field in differing if not field.startswith("\0")]
    # Length, place, data and seeds name the runs only where the settings of the learner leave some alike.
    chosen = learner if len(learner) <= ALL_UP_TO else []
    kinds = len({tuple(values[field][run] for field in chosen) for run in range(len(runs))})
    for field in differing:
        more = len({tuple(values[one][run] for one in [*chosen, field]) for run in range(len(runs))})
        if more > kinds:
            chosen, kinds = [*chosen, field], more
    return [[_said(field, values[field][run]) for field in chosen] for run in range(len(runs))]


def _files(runs: Sequence[RunRecord], prints: Sequence[str]) -> dict[str, str]:
    """For each print of data the file's name, with as many of its folders as tell the files apart."""
    paths = {print_: Path(str(run.data.get("path") or ABSENT)) for run, print_ in zip(runs, prints, strict=True)}
    for count in range(1, 1 + max(len(path.parts) for path in paths.values())):
        named = {print_: "/".join(path.parts[-count:]) for print_, path in paths.items()}
        if len(set(named.values())) == len(named):
            return named
    return {print_: path.name for print_, path in paths.items()}


def _settings(run: RunRecord, file: str, data_print: str) -> dict[str, str]:
    """What may tell a run from another, in the order in which it is looked at; settings of the learner come first.

    Data are named by their file, and by `data_print`; where that is empty, all runs saw the same data.
    """
    config = run.config
    algorithm = config.get("algorithm")
    settings = flatten(algorithm) if isinstance(algorithm, Mapping) and algorithm else {}
    found = {_short(name): value for name, value in settings.items()}
    others: dict[str, Any] = {
        "steps": config.get("steps", ABSENT),
        "data": file if data_print else "",
        "environment": environment_name(run.evaluation_environment or {}),
        "data print": data_print,
        "seeds": " ".join(map(str, config.get("seeds") or ())) or ABSENT,
    }
    return found | {f"\0{name}": str(value) for name, value in others.items()}


def _short(name: str) -> str:
    """`terms[outcome].weight` as the command line spells it, `outcome.weight`."""
    return name.replace("terms[", "", 1).replace("]", "", 1) if name.startswith("terms[") else name


def _said(field: str, value: str) -> str:
    field = field.lstrip("\0")
    if value == ABSENT:
        return f"without {field}"
    if value.startswith("["):
        with contextlib.suppress(ValueError):  # a text that happens to begin so
            value = " ".join(str(entry) for entry in json.loads(value))
    return f"{field} {value if len(value) <= _LONGEST else value[: _LONGEST - 1] + '…'}"


def _repeated(names: Sequence[str]) -> set[str]:
    return {name for name, count in Counter(names).items() if count > 1}
