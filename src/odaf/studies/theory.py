"""The theory study: every statement of the paper's theory, as it can be proved and as printed, on finite problems."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies.job import Job, Phase, Record, Study, Work

if TYPE_CHECKING:
    from odaf.theory.experiments import Experiment
    from odaf.training.progress import ProgressReport

VERSION = 1  # raised when the same settings would give other figures
PAGE = "docs/results/theory.md"


@dataclass(frozen=True)
class Testing(Work):
    """One experiment, whose settings hold its seed.

    Attributes:
        experiment: what is put to the test.
    """

    experiment: "Experiment"

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"experiment": (self.experiment.label, self.experiment.name)}

    def identity(self) -> dict[str, Any]:
        from odaf.training.files import plain

        return {"version": VERSION, "experiment": self.experiment.name, "settings": plain(vars(self.experiment))}

    def guess(self) -> float:
        return 5.0

    def said(self, record: Record) -> str:
        return verdicts(record)["corrected"]

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        del place
        begun = time.monotonic()
        progress.start(self.experiment.name, 0)
        found = self.experiment.measure()
        progress.close()
        return {
            "label": self.experiment.label,
            "name": self.experiment.name,
            "passed": found.passed,
            "checks": [asdict(check) for check in found.checks],
            "repetitions": dict(found.repetitions),
            "details": dict(found.details),
            "identity": self.identity(),
            "versions": _versions(),
            "seconds": time.monotonic() - begun,
        }


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {package: version(package) for package in ("numpy", "scipy")}


def plan() -> list[Phase]:
    """One phase, in the order of the page."""
    from odaf.theory.experiments import EXPERIMENTS

    return [Phase("E1 to E6", tuple(Job(each.name, Testing(each)) for each in EXPERIMENTS))]


# ---- what records say -----------------------------------------------------------------------------------------------


def in_order(records: Sequence[Record]) -> "list[tuple[Experiment, Record]]":
    """The records with their experiments, in the order of the page."""
    from odaf.theory.experiments import EXPERIMENTS

    found = {record["name"]: record for record in records}
    return [(each, found[each.name]) for each in EXPERIMENTS if each.name in found]


def verdicts(record: Record) -> dict[str, str]:
    """Of the corrected and of the printed statement, the worst that a check says of it; "-" where none is about it."""
    return {of: _worst([check for check in record["checks"] if check["of"] == of]) for of in ("corrected", "printed")}


def _worst(checks: Sequence[Mapping[str, Any]]) -> str:
    said = [check["verdict"] for check in checks]
    return next((each for each in ("not held", "held", "says nothing") if each in said), "-")


def summary(records: Sequence[Record]) -> str:
    """JSON: for each experiment both statements with their verdicts, every check, seed and repetitions."""
    content = {
        record["name"]: {
            "label": record["label"],
            "passed": record["passed"],
            "corrected": {"statement": experiment.corrected, "verdict": verdicts(record)["corrected"]},
            "printed": {"statement": experiment.printed, "verdict": verdicts(record)["printed"]},
            "checks": record["checks"],
            "seed": record["identity"]["settings"].get("seed"),
            "repetitions": record["repetitions"],
        }
        for experiment, record in in_order(records)
    }
    return json.dumps(content, indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: a line an experiment, then for each what it states and every check."""
    lines = [
        "The statements of the paper's theory on finite decision problems, where everything can be computed.",
        "*Corrected* is what can be proved, *printed* what the paper has in its place. `says nothing`: the check was",
        f"far from failing. {PAGE} has the formulas. Made by `odaf reproduce theory` from the records in this folder.",
        "",
        "| | experiment | corrected | printed | repetitions |",
        "|---|---|---|---|---|",
    ]
    for _, record in in_order(records):
        said = [_overall(record, of) for of in ("corrected", "printed")]
        repetitions = ", ".join(f"{number:,} {what}" for what, number in record["repetitions"].items())
        lines.append(f"| {record['label']} | {record['name']} | {' | '.join(said)} | {repetitions} |")
    for experiment, record in in_order(records):
        lines += [
            "",
            f"**{record['label']}, {record['name']}**",
            "",
            f"Corrected: `{experiment.corrected}`",
            "",
            f"Printed: `{experiment.printed}`",
            "",
            "| of | measured | figure | criterion | verdict |",
            "|---|---|---|---|---|",
            *(
                f"| {check['of']} | {_cell(check['what'])} | {check['figure']:.4g} | {_cell(check['criterion'])} "
                f"| {check['verdict']} |"
                for check in record["checks"]
            ),
        ]
    return "\n".join(lines) + "\n"


def _overall(record: Record, of: str) -> str:
    """The verdict, and how many of the checks behind it say nothing."""
    said = [check["verdict"] for check in record["checks"] if check["of"] == of]
    nothing = said.count("says nothing")
    return verdicts(record)[of] + (f"; {nothing} of {len(said)} checks says nothing" if nothing else "")


def _cell(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`" if "|" in text else text


def figure(records: Sequence[Record], out: Path) -> None:
    """The error of learned values and its bounds over the size of the log, and the paths beside the trap."""
    from odaf.report.figures import theory_figure

    found = {record["name"]: record for record in records}
    if "error-bound" not in found or "trap" not in found:
        return
    bound, trap = found["error-bound"]["details"], found["trap"]["details"]
    by_size = bound["by_size"]
    curves = {
        "corrected bound": "mean_bound",
        "printed bound, largest pair": "mean_printed_bound",
        "error, sup norm": "mean_error",
    }
    theory_figure(
        [int(rows) for rows in by_size],
        {name: [each[key] for each in by_size.values()] for name, key in curves.items()},
        f"Learned values: the error falls as N to the power of {bound['slope']:.2f}",
        trap["map"],
        {name: [tuple(cell) for cell in path] for name, path in trap["paths"].items()},
        out,
    )


STUDY = Study(
    "theory",
    "the paper's theory on finite problems, statement by statement, corrected and as printed",
    plan,
    {"table.md": table, "summary.json": summary},
    {"figure.png": figure},
)
