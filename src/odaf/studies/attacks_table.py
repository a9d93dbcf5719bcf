"""What the records of the attacks study say: curves, their areas, and who holds better than whom."""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from odaf.studies.final_scores import pairs
from odaf.studies.job import Record
from odaf.studies.of_policy import below_log, diverged, log_mean
from odaf.studies.robots import ROBOTS
from odaf.studies.tables import grouped
from odaf.studies.verdict import Claim, Part, Verdict, decide

ATTACKS = ("action-diff", "min-q")
PAPER, RIVALS = "odaf-paper-attack", ("sac-n", "edac-num_critics-10", "rorl-attack")
OURS, BASE = "odaf-locomotion", "odaf-locomotion-without-outcome"


def attacked(records: Sequence[Record]) -> list[Record]:
    """The records of attacks on policies that did not diverge."""
    return [one for one in records if one.get("measure") == "attacked" and one["found"] is not None]


def part(records: Sequence[Record], task: str, attack: str, method: str, other: str) -> Part:
    """That a method's area exceeds another's, seed by seed; void where one is below the log unattacked, or diverged."""
    areas: dict[str, dict[int, float]] = {method: {}, other: {}}
    every = [one for one in records if one.get("measure") == "attacked" and one["task"] == task]
    lost = {name: diverged([one for one in every if one["method"] == name]) for name in areas}
    void = "; ".join(f"{name}: {reason}" for name, reason in lost.items() if reason)
    for one in attacked(records):
        if (one["task"], one["found"]["attack"]) == (task, attack) and one["method"] in areas:
            areas[one["method"]][one["seed"]] = one["found"]["area"]
    for name in areas:
        own = [one for one in attacked(records) if (one["task"], one["method"]) == (task, name)]
        if own and not void:
            clean = statistics.fmean(one["found"]["scores"][0] for one in own)
            reason = below_log(clean, own[0])
            void = f"{name}: {reason}" if reason else ""
    first, second = pairs(areas[method], areas[other])
    return Part(f"{task}, {attack}: {method} over {other}", first, second, void=void)


def verdict(records: Sequence[Record], method: str = PAPER, rivals: Sequence[str] = RIVALS) -> Verdict:
    """Whether a method's area is above that of each rival, on each robot, under both attacks."""
    tasks = [f"{robot}-medium" for robot in ROBOTS]
    return decide(
        [part(records, task, attack, method, rival) for task in tasks for attack in ATTACKS for rival in rivals]
    )


def ours(records: Sequence[Record]) -> Verdict:
    """The same of our form over its base without the term."""
    return verdict(records, OURS, (BASE,))


CLAIM = Claim(
    "the method holds its score under attacks on what it sees, above SAC-N, EDAC and RORL",
    (
        "Only the policy's input is moved, by at most so many standard deviations of each dimension of the log; the "
        "offset is the worst of 50 draws by the victim's own critics (min-q) or by the change of its policy "
        "(action-diff), or is found by gradient steps.",
        "Ten episodes of 1,000 steps at each of seven budgets from 0 to 0.3; the area is the mean score over budgets.",
        "Held if the area exceeds each rival's on three robots under both attacks. A victim that earns less than its "
        "log's mean without an attack decides nothing.",
    ),
    (
        "The paper announces this evaluation and prints no result.",
        "Gradient steps are 0.2 of the box along the sign; the released code's step ignores the scale of a dimension.",
        "EDAC has ten critics on Hopper too, not fifty; RORL is trained for 10,000 updates, the others for 50,000.",
    ),
    verdict,
    ours,
)


def table(records: Sequence[Record]) -> str:
    """Markdown: for each robot and attack a row for every victim."""
    found = attacked(records)
    budgets = sorted({budget for one in found for budget in one["found"]["budgets"]})
    lines = [
        "Normalised scores while what the policy sees is moved by at most so many standard deviations, means over",
        "seeds. `area`: the mean over budgets. A victim below its log's mean unattacked is marked: it decides nothing.",
        "Made by `odaf reproduce attacks` from the records in this folder.",
        "",
        f"| log | attack | victim | seeds | {' | '.join(f'{budget:g}' for budget in budgets)} | area | |",
        f"|{'---|' * (len(budgets) + 6)}",
    ]
    for (task, attack, method), group in grouped(
        found, lambda one: (one["task"], one["found"]["attack"], one["method"])
    ).items():
        cells = [f"{statistics.fmean(values):.1f}" if (values := _at(group, budget)) else "" for budget in budgets]
        clean = statistics.fmean(one["found"]["scores"][0] for one in group)
        area = statistics.fmean(one["found"]["area"] for one in group)
        mark = "below its log" if below_log(clean, group[0]) else ""
        lines.append(f"| {task} | {attack} | {method} | {len(group)} | {' | '.join(cells)} | {area:.1f} | {mark} |")
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by log, attack and victim the area of each seed, the clean score and the log's mean."""
    content: dict[str, Any] = {}
    for (task, attack, method), group in grouped(
        attacked(records), lambda one: (one["task"], one["found"]["attack"], one["method"])
    ).items():
        content.setdefault(task, {}).setdefault(attack, {})[method] = {
            "area": {str(one["seed"]): one["found"]["area"] for one in group},
            "clean": {str(one["seed"]): one["found"]["scores"][0] for one in group},
            "log_mean": log_mean(group[0]),
        }
    return json.dumps(content, indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel for each robot under the two attacks that the claim is about, a curve for every victim."""
    from odaf.report.study_figures import Line, lines_figure

    panels: dict[str, list[Line]] = {}
    for (task, attack, method), group in grouped(
        attacked(records), lambda one: (one["task"], one["found"]["attack"], one["method"])
    ).items():
        if attack in ATTACKS:
            budgets = group[0]["found"]["budgets"]
            values = [_at(group, budget) for budget in budgets]
            panels.setdefault(f"{task}, {attack}", []).append(Line(method, budgets, values))
    if panels:
        note = "mean over seeds, shade: one standard deviation; the log's mean is not drawn"
        lines_figure(panels, out, "Scores under attack", note, "offset, standard deviations", "normalised score")


def _at(group: Sequence[Record], budget: float) -> list[float]:
    return [
        score
        for one in group
        for at, score in zip(one["found"]["budgets"], one["found"]["scores"], strict=True)
        if at == budget
    ]
