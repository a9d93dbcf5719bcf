"""The paper's claims, each decided from the records of a study."""

import json
import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from odaf.data.writing import write_atomically
from odaf.studies import antmaze
from odaf.studies.job import Record
from odaf.studies.ledger import Ledger
from odaf.studies.pointmaze_methods import MBRCSL, STEPS, STEPS_OF
from odaf.studies.pointmaze_table import of_table
from odaf.studies.registry import STUDIES
from odaf.studies.tables import grouped
from odaf.studies.theory import verdicts as theory_verdicts
from odaf.studies.verdict import Part, Verdict, decide

Decision = Callable[[Sequence[Record]], Verdict]


@dataclass(frozen=True)
class Question:
    """A claim and where its records lie.

    Attributes:
        statement: what the paper claims.
        study: whose ledger holds the records.
        verdict: from the records that count; None takes the study's own.
        ours: the same of this package's form; None takes the study's own, if there is one.
    """

    statement: str
    study: str
    verdict: Decision | None = None
    ours: Decision | None = None


def stitching(records: Sequence[Record], method: str = "odaf-paper") -> Verdict:
    """Whether a method's mean return in the stitching maze exceeds the best logged one; a seed that diverged has 0."""
    values = tuple(
        (0.0 if one["final"] is None else one["final"]["mean_return"]) - one["data"]["best_return"]
        for one in _maze(records, method)
    )
    return decide([Part(f"{method} over the best logged return in the stitching maze", values)])


def cost(records: Sequence[Record], method: str = "odaf-paper") -> Verdict:
    """Whether training in the stitching maze takes less time than MBRCSL's, each alone on a processor."""
    ours, theirs = (
        tuple(
            one["seconds"]["total"]
            for one in _maze(records, name)
            if one.get("lanes", 1) == 1 and one["final"] is not None
        )
        for name in (method, MBRCSL)
    )
    return decide([Part(f"seconds in the stitching maze, {MBRCSL} over {method}", theirs, ours, paired=False)])


def ant_mazes(records: Sequence[Record], method: str = antmaze.PRINTED) -> Verdict:
    """Whether a method reaches more goals than every rival, set by set; a set has the mean of its seeds, a seed that
    diverged 0."""
    success = {
        (name, task): statistics.fmean(
            0.0 if one["final"] is None else one["final"]["normalised_score"] for one in runs
        )
        for name, own in grouped(records, lambda one: one["method"]).items()
        for task, runs in grouped(own, lambda one: one["task"]).items()
    }
    parts = []
    for rival in antmaze.RIVALS:
        both = [task for name, task in success if name == method and (rival, task) in success]
        ours, theirs = (tuple(success[name, task] for task in both) for name in (method, rival))
        parts.append(Part(f"{method} over {rival}, successes of {len(both)} sets", ours, theirs))
    return decide(parts)


def theory(records: Sequence[Record]) -> Verdict:
    """Whether the printed statements hold on finite problems, where everything can be computed."""
    said = {f"{one['label']} {one['name']}": theory_verdicts(one) for one in records}
    printed = {name: each["printed"] for name, each in said.items() if each["printed"] != "-"}
    corrected = [each["corrected"] for each in said.values()]
    failing = [name for name, verdict in printed.items() if verdict == "not held"]
    test = f"exact values on finite problems, {len(said)} experiments"
    tally = f"as corrected, {corrected.count('held')} of {len(said)} statements hold"
    if not said:
        return _undecided(test, "no records")
    held = all(verdict == "held" for verdict in printed.values())
    answer = "not held" if failing else "held" if held else "not decided"
    reasons = (*(f"as printed, not held: {name}" for name in failing), tally)
    return Verdict(answer, test, 1, None, None, failing[0] if failing else "all", reasons, {})


CLAIMS: Mapping[str, Question] = {
    "mujoco": Question("best on the robots' logs, non-expert ones above all (Table 1)", "mujoco"),
    "mixtures": Question("degrades least as random rows are mixed into an expert's", "mixtures"),
    "stitching": Question(
        "joins pieces of poor demonstrations to a new path", "pointmaze", stitching, partial(stitching, method="odaf")
    ),
    "attacks": Question("holds under attacks on what it sees", "attacks"),
    "validation": Question("the outcome's uncertainty tells safe actions from unsafe ones", "validation"),
    "ablation": Question(
        "its term is what matters: without it scores fall (by about a fifth, which is not asked for)", "ablation"
    ),
    "knocks": Question("comes back from states outside the data", "knocks"),
    "theory": Question("its theory holds as printed", "theory", theory),
    "antmaze": Question("best in the ant mazes", "antmaze", ant_mazes, partial(ant_mazes, method=antmaze.OURS)),
    "cost": Question("trains in less time than MBRCSL", "pointmaze", cost, partial(cost, method="odaf")),
}
"""By the name in `claims.json`."""


@dataclass(frozen=True)
class Answer:
    """What records say of a claim.

    Attributes:
        verdict: on the form of the method that the paper prints.
        ours: the same question of this package's form; None where it is not asked.
    """

    verdict: Verdict
    ours: Verdict | None


def decided(results: Path) -> dict[str, Answer]:
    """The answer to each claim from the ledgers in a folder; not decided where records are missing.

    Raises:
        ConfigError: a record cannot be read.
    """
    records: dict[str, list[Record]] = {}
    found = {}
    for name, question in CLAIMS.items():
        study = STUDIES[question.study]
        if study.name not in records:
            records[study.name] = Ledger(study.among(results), results / study.name).held()
        claim = study.claim
        decide_by = question.verdict or (None if claim is None else claim.verdict)
        ours = question.ours or (None if claim is None else claim.ours)
        assert decide_by is not None
        held = records[study.name]
        found[name] = Answer(decide_by(held), None if ours is None else ours(held))
    return found


def command(question: Question) -> str:
    """What measures the records of a claim."""
    return f"odaf reproduce {question.study}"


def write(found: Mapping[str, Answer], out: Path, page: Path) -> None:
    """Writes the verdicts as JSON, and as a Markdown page beside whose folder the figures lie."""
    content = {}
    for name, answer in found.items():
        entry = answer.verdict.to_dict()
        content[name] = {**entry, "claim": CLAIMS[name].statement, "command": command(CLAIMS[name])}
        if answer.ours is not None:
            content[name]["ours"] = answer.ours.to_dict()
    for path, text in ((out, json.dumps(content, indent=1) + "\n"), (page, markdown(found, out.parent, page.parent))):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda file, text=text: file.write(text.encode("utf-8")))


def markdown(found: Mapping[str, Answer], results: Path, folder: Path) -> str:
    """The page: a table of all claims, then each with its test, its reasons, its figure and its command."""
    lines = [
        "# The paper's claims",
        "",
        "Drawn by `odaf claims` from the ledgers in `results/`. A claim is **held** where the 95 % interval of every",
        "part lies on its side, **not held** where one lies on the other (corrected for the number of parts), and",
        "**not decided** otherwise: too few seeds, no records, or a policy no better than its log.",
        "",
        "| claim | | verdict | seeds | command |",
        "|---|---|---|---|---|",
    ]
    for name, answer in found.items():
        question, verdict = CLAIMS[name], answer.verdict
        row = f"| [{name}](#{name}) | {question.statement} | {verdict.verdict} | {verdict.seeds} "
        lines.append(f"{row}| `{command(question)}` |")
    for name, answer in found.items():
        lines += ["", f"## {name}", "", *_section(CLAIMS[name], answer, results, folder)]
    return "\n".join(lines) + "\n"


MOST_REASONS = 8


def _section(question: Question, answer: Answer, results: Path, folder: Path) -> list[str]:
    verdict = answer.verdict
    capital = question.statement[0].upper() + question.statement[1:]
    lines = [f"{capital}: **{verdict.verdict}**.", "", f"Test: {verdict.test}."]
    if verdict.interval is not None:
        low, high = verdict.interval
        lines.append(f"{verdict.part}: interval {low:+.3g} to {high:+.3g}, {verdict.seeds} seeds.")
    if verdict.verdict == "not decided":
        enough = "what is missing says nothing of how many" if verdict.enough is None else f"about {verdict.enough:,}"
        lines.append(f"Seeds that would decide: {enough}.")
    if answer.ours is not None:
        lines += ["", f"The same of this package's own form: {answer.ours}."]
    if verdict.reasons:
        more = len(verdict.reasons) - MOST_REASONS
        lines += ["", *(f"- {reason}" for reason in verdict.reasons[:MOST_REASONS])]
        lines += [f"- and {more} more"] if more > 0 else []
    figure = results / question.study / "figure.png"
    if figure.exists():
        lines += ["", f"![{question.study}]({Path(os.path.relpath(figure, folder)).as_posix()})"]
    return lines


def _undecided(test: str, reason: str) -> Verdict:
    return Verdict("not decided", test, 0, None, None, "", (reason,), {})


def _maze(records: Sequence[Record], preset: str) -> list[Record]:
    """A method's trainings in the stitching maze, on the log of the tables where two seeds are there, else on that of
    the first part of the study. A rival's settings are those that it is trained with most often."""
    own = [one for one in records if one.get("preset") == preset and one["steps"] == STEPS_OF.get(preset, STEPS)]
    own = [one for one in own if "measure" not in one]
    table = [one for one in of_table(own) if one["map"] == "stitch"]
    first = [one for one in own if one["maze"] == "stitch" and not one["changes"]]
    same = max(grouped(table, lambda one: one["method"]).values(), key=len, default=[])
    return same if len(same) > 1 else first
