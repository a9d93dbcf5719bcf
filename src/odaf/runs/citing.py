"""Which papers a method implements: a preset, a learner, a term, or the learner of a run."""

import difflib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import odaf
from odaf.algorithms import citations, config
from odaf.algorithms.base import Algorithm
from odaf.algorithms.citations import Citation, software
from odaf.algorithms.registry import ALGORITHMS, TERMS
from odaf.errors import ConfigError
from odaf.runs import presets
from odaf.training.run_directory import RunDirectory

# Weights by return and by advantage are the first paper's; the second carries them on. The best tenth is cloned in the
# last one's comparison.
_WEIGHTS = (citations.TRAJECTORY_WEIGHTING, citations.IMBALANCED_DATASETS)
_OF_SAMPLING = {"return": _WEIGHTS, "advantage": _WEIGHTS, "best": (citations.DECISION_TRANSFORMER,)}


@dataclass(frozen=True)
class Part:
    """A part of a method and its papers; none where its author names none."""

    name: str
    citations: tuple[Citation, ...]


def parts_of(method: str) -> list[Part]:
    """The learner of a method, how its rows are drawn unless all alike, and each of its terms that is not switched off.

    Args:
        method: a preset or its file, a learner's kind, a term's name, or a run directory.

    Raises:
        ConfigError: it is none of these; the message lists what is known.
    """
    found = _resolved(method)
    terms = getattr(found, "active_terms", getattr(found, "terms", ()))
    kind = getattr(found, "kind", None)
    own = f"term {found.name}" if kind is None else f"learner {kind}"
    parts = [Part(own, found.citations())]
    if isinstance(found, Algorithm) and found.sampling != "uniform":
        parts.append(Part(f"rows drawn by sampling={found.sampling!r}", _OF_SAMPLING[found.sampling]))
    return [*parts, *(Part(f"term {term.name}", term.citations()) for term in terms)]


def bibliography(methods: Sequence[str], layout: str = "bibtex") -> str:
    """Every paper of the methods once, after lines that say what each is for, and this package itself last.

    Args:
        methods: as `parts_of` takes them, or folders that hold run directories.
        layout: "bibtex", whose leading lines are comments, or "text".
    """
    mark = "% " if layout == "bibtex" else ""
    lines, entries = [], {}
    for method in itertools.chain.from_iterable(map(_members, methods)):
        lines.append(f"{mark}{method}")
        for part in parts_of(method):
            keys = ", ".join(citation.key for citation in part.citations)
            lines.append(f"{mark}  {part.name}: {keys or 'has no citation of its own; its author knows what to cite'}")
            entries |= {citation.key: citation for citation in part.citations}
    own = software(odaf.__version__)
    lines.append(f"{mark}the software: {own.key}")
    found = [*entries.values(), own]
    if layout == "bibtex":
        return "\n\n".join(["\n".join(lines), *(citation.bibtex() for citation in found)])
    return "\n".join([*lines, "", *(f"[{citation.key}] {citation.text()}" for citation in found)])


def _members(method: str) -> list[str]:
    """The runs of a folder that holds some and is no run itself; any other method alone."""
    if (Path(method) / "config.json").is_file() or method in {*presets.names(), *ALGORITHMS, *TERMS}:
        return [method]
    return sorted(str(file.parent) for file in Path(method).glob("*/config.json")) or [method]


def _resolved(method: str) -> Any:
    """The learner or the term of that name."""
    if (Path(method) / "config.json").is_file():
        return config.from_dict(RunDirectory(Path(method)).config["algorithm"], str(Path(method) / "config.json"))
    known = presets.names()
    if method in known or (presets.is_file(method) and not Path(method).is_dir()):
        return presets.load(method)
    for registry in (ALGORITHMS, TERMS):
        if method in registry:
            try:
                return registry[method]()
            except TypeError:
                raise ConfigError(f"{method}: its settings have no defaults; name a preset or a run of it") from None
    names = [*known, *ALGORITHMS, *TERMS]
    near = difflib.get_close_matches(method, names, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"known are: {', '.join(dict.fromkeys(names))}"
    raise ConfigError(f"{method}: is no preset, learner, term or run directory; {hint}")
