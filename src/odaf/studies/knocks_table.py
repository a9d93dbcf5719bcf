"""What the records of the knocks study say: scores by knock, who comes back, and where policies go."""

import json
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from odaf.studies.final_scores import pairs
from odaf.studies.job import Record
from odaf.studies.of_policy import below_log, diverged, log_mean
from odaf.studies.robots import ROBOTS
from odaf.studies.tables import grouped
from odaf.studies.verdict import Claim, Part, Verdict, decide

PAPER = ("odaf-paper", "odaf-paper-without-outcome")
OURS = ("odaf-locomotion", "odaf-locomotion-without-outcome")
NEEDED = 2  # robots


def knocked(records: Sequence[Record]) -> list[Record]:
    """The records of knocked policies that did not diverge."""
    return [one for one in records if one.get("measure") == "knocked" and one["found"] is not None]


def part(records: Sequence[Record], task: str, method: str, base: str, at: int = 500) -> Part:
    """That more of the base's states after the large knock lie outside the log than of the method's; see `verdict`.

    Void where one of them earns less than the log unknocked, or diverged, or no episode lasted until the knock.
    """
    beyond: dict[str, dict[int, float]] = {method: {}, base: {}}
    void = ""
    for name in beyond:
        every = [
            one
            for one in records
            if one.get("measure") == "knocked"
            and (one["task"], one["method"], one["identity"]["settings"]["at"]) == (task, name, at)
        ]
        own = knocked(every)
        if not void and (reason := diverged(every)):
            void = f"{name}: {reason}"
        for one in own:
            if one["found"]["after"] is not None:
                beyond[name][one["seed"]] = one["found"]["after"]["beyond"]
        if own and not void:
            reason = below_log(statistics.fmean(one["found"]["levels"]["none"]["score"] for one in own), own[0])
            void = f"{name}: {reason}" if reason else ""
            if not void and not beyond[name]:
                void = f"{name}: no episode lasted until the knock"
    first, second = pairs(beyond[base], beyond[method])
    return Part(f"{task}: share of states outside the log, {base} over {method}", first, second, void=void)


def verdict(records: Sequence[Record], forms: tuple[str, str] = PAPER) -> Verdict:
    """Whether after the large knock a smaller share of states lies outside the log than without the term, on at least
    two robots of three."""
    parts = [part(records, f"{robot}-medium-expert", *forms) for robot in ROBOTS]
    return decide(parts, needed=NEEDED)


def ours(records: Sequence[Record]) -> Verdict:
    """The same of our form and its base."""
    return verdict(records, OURS)


CLAIM = Claim(
    "the method comes back from states outside the data, sooner than without its term",
    (
        "Once, at step 500, motors are off for 5 to 30 simulator steps, which are not counted; 20 episodes of 1,000 "
        "counted steps, deterministic policy. Starts with noise of 0.05 to 0.2 standard deviations beside it.",
        "After the large knock (15 steps) 100 steps are followed: a state is outside the log if its nearest logged "
        "neighbour is further than the 95th percentile of such distances within the log, or if the robot has fallen.",
        "Held if the share of states outside the log is smaller with the term than without it, on at least two robots "
        "of three. A policy that earns less than its log unknocked decides nothing.",
    ),
    (
        "OSR's protocol is taken for the paper's, which names its level only; 8 episodes there.",
        "Levels of 20 and 30 steps, unusual starts and knocks at step 100 are additions.",
        "The plane of the figure is the log's two principal axes.",
    ),
    verdict,
    ours,
)


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each log, method and time of the knock."""
    found = knocked(records)
    levels = list(dict.fromkeys(name for one in found for name in one["identity"]["settings"]["levels"]))
    noises = list(dict.fromkeys(noise for one in found for noise in one["found"]["starts"]))
    lines = [
        "Normalised scores of episodes in which the controls are off for so many simulator steps once, at the counted",
        "step given; then from starts with noise, in standard deviations of the log. Means over seeds. `outside`:",
        "share of the 100 steps after the large knock that lie outside the log or after a fall; `back`: episodes that",
        "come back, and the median of the steps it takes. A policy below its log's mean unknocked is marked, and",
        "decides nothing.",
        "Made by `odaf reproduce knocks` from the records in this folder.",
        "",
        f"| log | at | method | seeds | {' | '.join(levels)} | {' | '.join(f'start {noise}' for noise in noises)} "
        "| outside | back | steps | |",
        f"|{'---|' * (len(levels) + len(noises) + 8)}",
    ]
    for (task, at, method), group in _groups(found).items():
        cells = [_mean(group, lambda one, name=name: one["found"]["levels"][name]["score"]) for name in levels]
        cells += [_mean(group, lambda one, noise=noise: one["found"]["starts"][noise]["score"]) for noise in noises]
        after = [one["found"]["after"] for one in group if one["found"]["after"] is not None]
        steps = [each["median_recovery"] for each in after if each["median_recovery"] is not None]
        outside = f"{statistics.fmean(each['beyond'] for each in after):.2f}" if after else "fell before"
        back = f"{statistics.fmean(each['recovered'] for each in after):.0%}" if after else ""
        clean = statistics.fmean(one["found"]["levels"]["none"]["score"] for one in group)
        mark = "below its log" if below_log(clean, group[0]) else ""
        lines.append(
            f"| {task} | {at} | {method} | {len(group)} | {' | '.join(cells)} | {outside} | {back} "
            f"| {f'{statistics.median(steps):.0f}' if steps else ''} | {mark} |"
        )
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by log, time and method the scores of each seed by knock, the share outside, and the log's mean."""
    content: dict[str, Any] = {}
    for (task, at, method), group in _groups(knocked(records)).items():
        content.setdefault(task, {}).setdefault(str(at), {})[method] = {
            "log_mean": log_mean(group[0]),
            "by_seed": {
                str(one["seed"]): {
                    "scores": {name: level["score"] for name, level in one["found"]["levels"].items()},
                    "outside": None if one["found"]["after"] is None else one["found"]["after"]["beyond"],
                }
                for one in group
            },
        }
    return json.dumps(content, indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """The log's states on its two principal axes, and over them the states of each policy after the large knock."""
    from odaf.report.study_figures import Cloud, clouds_figure

    panels: dict[str, Cloud] = {}
    for (task, at, _), group in _groups(knocked(records)).items():
        first = group[0]
        if first["found"]["after"] is None:
            continue
        log = first["found"]["after"]["log"]
        cloud = panels.setdefault(f"{task}, at {at}", Cloud(log["low"], log["high"], log["counts"], {}))
        cloud.points[first["method"]] = first["found"]["after"]["points"]
    if panels:
        note = "grey: the log's states on its principal axes; dots: states after the large knock, one seed"
        clouds_figure(panels, out, "Where policies go after a knock", note)


def _groups(records: Sequence[Record]) -> dict[tuple[str, int, str], list[Record]]:
    return grouped(records, lambda one: (one["task"], one["identity"]["settings"]["at"], one["method"]))


def _mean(group: Sequence[Record], value: Callable[[Record], float]) -> str:
    return f"{statistics.fmean(map(value, group)):.1f}"
