"""What the records of the validation study say: bars, areas under the curve, and the criteria they are held to."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from odaf.studies.job import Record
from odaf.studies.of_policy import diverged
from odaf.studies.tables import grouped
from odaf.studies.verdict import Claim, Part, Verdict, decide

TRUE_AREA, MODEL_AREA, CONTROL_AREA, GAP_RATIO, R_SQUARED = 0.80, 0.75, (0.40, 0.65), (0.5, 2.0), 0.90
"""Criteria, fixed before anything was measured."""


def measured(records: Sequence[Record]) -> list[Record]:
    """The records of scored actions, without those of trainings and of policies that diverged."""
    return [record for record in records if record.get("measure") == "outcomes" and record["found"] is not None]


def is_control(task: str) -> bool:
    """Whether nothing is expected of a log: its actions are random."""
    return task.endswith("-random")


def areas(records: Sequence[Record], kind: str) -> list[float]:
    """Of each record the area under the ROC curve with outcomes told by the simulator or a model."""
    return [record["found"]["dynamics"][kind]["auroc"] for record in records]


def gap_ratios(records: Sequence[Record], kind: str) -> list[float]:
    """Of each record the gap between unsafe and safe by a model, over that by the simulator."""
    return [
        record["found"]["dynamics"][kind]["gap"] / record["found"]["dynamics"]["simulator"]["gap"]
        for record in records
        if record["found"]["dynamics"]["simulator"]["gap"] != 0.0
    ]


def parts_of(records: Sequence[Record], method: str, tasks: Sequence[str]) -> list[Part]:
    """What must be above zero: on each log both areas less their bars, and the gaps' ratio within its bounds; on random
    logs the area within the control's bounds. Models are the paper's."""
    found = []
    for task in tasks:
        every = [one for one in records if one.get("measure") == "outcomes"]
        every = [one for one in every if (one["task"], one["method"]) == (task, method)]
        own, lost = measured(every), diverged(every)
        true, model = tuple(areas(own, "simulator")), tuple(areas(own, "cvae"))
        if is_control(task):
            low, high = CONTROL_AREA
            found += [
                Part(f"{task}: control's AUROC above {low}", true, threshold=low, void=lost),
                Part(
                    f"{task}: control's AUROC below {high}", tuple(-each for each in true), threshold=-high, void=lost
                ),
            ]
            continue
        weak = [one["found"]["inverse_r_squared"] for one in own if one["found"]["inverse_r_squared"] < R_SQUARED]
        void = f"the inverse map's R2 is {min(weak):.2f}, below {R_SQUARED}" if weak else lost
        low, high = GAP_RATIO
        ratios = tuple(gap_ratios(own, "cvae"))
        found += [
            Part(f"{task}: AUROC, simulator, above {TRUE_AREA}", true, threshold=TRUE_AREA, void=void),
            Part(f"{task}: AUROC, CVAE, above {MODEL_AREA}", model, threshold=MODEL_AREA, void=void),
            Part(f"{task}: ratio of gaps above {low}", ratios, threshold=low, void=void),
            Part(f"{task}: ratio of gaps below {high}", tuple(-each for each in ratios), threshold=-high, void=void),
        ]
    return found


def verdict(records: Sequence[Record], method: str = "odaf") -> Verdict:
    """Whether a method's critics tell safe from unsafe on the robots' medium logs, and not on random ones."""
    tasks = [f"{robot}-{kind}" for kind in ("medium", "random") for robot in ("hopper", "halfcheetah", "walker2d")]
    return decide(parts_of(records, method, tasks))


CLAIM = Claim(
    "the outcome's uncertainty is low for safe actions and high for unsafe ones, by true and by learned dynamics",
    (
        "States are drawn from the log; a state of another episode within the 5th percentile of random distances is "
        "similar. The safe action is an inverse map's, to the recorded successor of the similar state; the unsafe one "
        "is uniform.",
        "The score is the mean over ten actions of the policy of the standard deviation of ten critics, at the outcome "
        "by the simulator, or averaged over ten draws of the paper's CVAE.",
        f"Held if on each medium log the area under the ROC curve exceeds {TRUE_AREA} by the simulator and "
        f"{MODEL_AREA} by the CVAE and the ratio of their gaps lies in {list(GAP_RATIO)}, and on each random log the "
        f"area lies in {list(CONTROL_AREA)}; the inverse map's R2 must reach {R_SQUARED}.",
    ),
    (
        "The paper shows bars without numbers; areas, intervals, the control and the three scores that do without "
        "outcomes or critics are added here.",
        "The square under the root of the uncertainty, which the paper's formula lost, is there.",
        "The critics are those of `odaf`, the term on its stabilised base; the paper's base, SAC-N, is in the table.",
        "Logs are recorded here unless --data names public files; policies learn for 20,000 updates.",
    ),
    verdict,
)


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each log and method."""
    lines = [
        "AUROC: probability that the score of an unsafe action (uniform) is above that of a safe one (an inverse",
        "map's, to the logged successor of a similar state). The score is the critics' disagreement where the action",
        "leads, by the simulator, the paper's CVAE, or our deterministic model. Beside it what does without:",
        "disagreement at the action, distance of the true outcome to the log, improbability under a clone. Asked for:",
        f"an AUROC of at least {TRUE_AREA} by the simulator and {MODEL_AREA} by the CVAE, a ratio of gaps",
        f"(CVAE over simulator) in {list(GAP_RATIO)}, and on random logs, the control, an AUROC in",
        f"{list(CONTROL_AREA)}. Means over seeds.",
        "Made by `odaf reproduce validation` from the records in this folder.",
        "",
        "| log | method | seeds | simulator | CVAE | deterministic | ratio of gaps | at the action | distance | clone "
        "| inverse R2 | CVAE's RMSE | rank correlation |",
        f"|{'---|' * 13}",
    ]
    for (task, method), group in grouped(measured(records), lambda one: (one["task"], one["method"])).items():
        others = group[0]["found"]["others"]
        ratios = gap_ratios(group, "cvae")
        cells = [
            *(f"{_mean(areas(group, kind)):.2f}" for kind in ("simulator", "cvae", "deterministic")),
            f"{_mean(ratios):.2f}" if ratios else "-",
            *(f"{_mean([one['found']['others'][name] for one in group]):.2f}" for name in others),
            f"{_mean([one['found']['inverse_r_squared'] for one in group]):.3f}",
            f"{_mean([one['found']['models']['cvae']['normalised_rmse'] for one in group]):.3f}",
            f"{_mean([one['found']['rank_correlation']['cvae'] for one in group]):.2f}",
        ]
        lines.append(f"| {task} | {method} | {len(group)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by log and method every seed's figures that the criteria ask for."""
    found: dict[str, Any] = {}
    for (task, method), group in grouped(measured(records), lambda one: (one["task"], one["method"])).items():
        found.setdefault(task, {})[method] = {
            str(one["seed"]): {
                "auroc": {kind: each["auroc"] for kind, each in one["found"]["dynamics"].items()},
                "gap_ratio": gap_ratios([one], "cvae"),
                "inverse_r_squared": one["found"]["inverse_r_squared"],
                "others": one["found"]["others"],
                "unseen": one["found"]["unseen"],
            }
            for one in group
        }
    return json.dumps(found, indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """Four bars a log, as in the paper: safe and unsafe by the simulator and by the CVAE, in units of the first."""
    from odaf.report.study_figures import Bar, bars_figure

    found: dict[str, list[Bar]] = {}
    for (task, method), group in grouped(measured(records), lambda one: (one["task"], one["method"])).items():
        unit = _mean([one["found"]["dynamics"]["simulator"]["safe"]["mean"] for one in group]) or 1.0
        found[f"{task}, {method}"] = [
            Bar(
                f"{name}, {kind}",
                _mean([one["found"]["dynamics"][kind][name]["mean"] for one in group]) / unit,
                [one["found"]["dynamics"][kind][name]["mean"] / unit for one in group],
            )
            for kind in ("simulator", "cvae")
            for name in ("safe", "unsafe")
        ]
    if found:
        note = "score of the outcome over that of safe actions by the simulator; dots are seeds"
        bars_figure(found, out, "Do the critics tell safe from unsafe?", note)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
