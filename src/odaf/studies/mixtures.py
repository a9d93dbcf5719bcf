"""The mixtures study: how scores fall as random rows are mixed into an expert's, on three robots."""

import json
import statistics
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from odaf.studies.final_scores import Finals, finals_of, pairs
from odaf.studies.job import Phase, Record, Study
from odaf.studies.robots import ROBOTS, Method, robot_form, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training, phases_of
from odaf.studies.verdict import Claim, Part, Verdict, decide

EVALUATION = Evaluation(every=10_000, episodes=20)
STEPS, ROWS, MORE_ROWS = 50_000, 100_000, 1_000_000
SHARES, FIRST_SHARES = (50, 60, 70, 80, 90), (50, 80, 90)
SEEDS, MORE_SEEDS = 2, 4

CHEAP: tuple[Method, ...] = (
    ("behaviour-cloning-best", ()),
    ("rebrac-return", ()),
    ("rebrac-return", (("sampling", "uniform"),)),
    ("svr", ()),
)
OURS: tuple[Method, ...] = (("odaf-locomotion", ()), ("odaf-locomotion-without-outcome", ()))
OTHERS: tuple[Method, ...] = (("osr-10", ()), ("osr", ()), ("sdc", ()))
PAPER: tuple[Method, ...] = (("odaf-paper", ()),)
RIVALS = ("svr", "osr", "osr-10", "sdc")
"""The paper's, in its figure of the levels of non-expert data."""


def plan(data: Path | None = None) -> list[Phase]:
    """Hopper at three shares, cheap methods first; five shares of three robots need lanes."""

    def runs(
        methods: Sequence[Method], robots: Sequence[str], shares: Sequence[int], seeds: range, rows: int = ROWS
    ) -> list[Training]:
        found = []
        for seed in seeds:
            for robot in robots:
                for share in shares:
                    task = robot_task(robot, "mixture", EVALUATION, rows, data, share)
                    found += [
                        Training(preset, task, seed, STEPS, changes, robot_form(preset, task))
                        for preset, changes in methods
                    ]
        return found

    some, more = range(SEEDS), range(SEEDS, MORE_SEEDS)
    every = (*CHEAP, *OURS, *OTHERS, *PAPER)
    rest = [share for share in SHARES if share not in FIRST_SHARES]
    hopper, others = ROBOTS[:1], ROBOTS[1:]
    phases = [
        ("Hopper, three shares: cheap methods", runs(CHEAP, hopper, FIRST_SHARES, some)),
        ("Hopper, three shares: our form and its base", runs(OURS, hopper, FIRST_SHARES, some)),
        ("Hopper, three shares: OSR, OSR-10, SDC", runs(OTHERS, hopper, FIRST_SHARES, some)),
        ("Hopper, three shares: the paper's form", runs(PAPER, hopper, FIRST_SHARES, some)),
        (
            "five shares, three robots, four seeds (lanes)",
            [
                *runs(every, hopper, rest, some),
                *runs(every, others, SHARES, some),
                *runs(every, ROBOTS, SHARES, more),
            ],
        ),
    ]
    if data is None:  # public mixtures have a million rows already
        long = runs(every, ROBOTS, SHARES, range(MORE_SEEDS), MORE_ROWS)
        phases.append(("the same with a million rows (lanes)", long))
    return phases_of(*phases)


def by_share(finals: Finals, robot: str, method: str) -> dict[int, dict[int, float]]:
    """By the percentage of random rows the score of each seed, on logs of the first size."""
    found = {share: finals.get(f"{robot}-mixture-{share}", {}).get(method, {}) for share in SHARES}
    return {share: seeds for share, seeds in found.items() if seeds}


def parts_of(finals: Finals, method: str, rivals: Sequence[str]) -> list[Part]:
    """On each robot, over each rival: the mean over shares is higher, and the fall from half to nine tenths smaller."""
    parts = []
    for robot in ROBOTS:
        for rival in rivals:
            ours, theirs = (by_share(finals, robot, name) for name in (method, rival))
            shares = sorted(ours.keys() & theirs.keys())
            void = "" if len(shares) == len(SHARES) else f"{len(shares)} of {len(SHARES)} shares are measured with both"
            means = [_by_seed(each, shares, np.mean) for each in (ours, theirs)]
            falls = [_by_seed(each, shares, lambda scores: scores[0] - scores[-1]) for each in (ours, theirs)]
            first, second = pairs(*means)
            parts.append(Part(f"{robot}: mean over shares, {method} over {rival}", first, second, void=void))
            first, second = pairs(falls[1], falls[0])
            parts.append(Part(f"{robot}: fall of {rival} over that of {method}", first, second, void=void))
    return parts


def _by_seed(scores: dict[int, dict[int, float]], shares: Sequence[int], value: Any) -> dict[int, float]:
    """A figure of the curve of each seed that has all these shares."""
    if not shares:
        return {}
    seeds = set.intersection(*(set(scores[share]) for share in shares))
    return {seed: float(value([scores[share][seed] for share in shares])) for seed in sorted(seeds)}


def verdict(records: Sequence[Record]) -> Verdict:
    """Of the paper's form against the paper's rivals."""
    return decide(parts_of(finals_of(records), "odaf-paper", RIVALS))


def ours(records: Sequence[Record]) -> Verdict:
    """Of our form against the same and its base."""
    return decide(parts_of(finals_of(records), "odaf-locomotion", (*RIVALS, "odaf-locomotion-without-outcome")))


CLAIM = Claim(
    "the method degrades least as random rows are mixed into an expert's log",
    (
        "The first rows of an expert's log, then the first of a random one, 100,000 in all, shares of random rows from "
        "0.5 to 0.9; nothing is shuffled.",
        "50,000 updates, 20 episodes at the last checkpoint, four seeds.",
        "Held if on each robot, against each of SVR, OSR, OSR-10 and SDC, the mean over shares is higher and the fall "
        "from 0.5 to 0.9 smaller, seed by seed.",
    ),
    (
        "The paper mixes a million rows of the public sets; --data DIR does so here.",
        "The paper shows curves without numbers, and no radius for mixtures: its robot's value is taken.",
    ),
    verdict,
    ours,
)


def table(records: Sequence[Record]) -> str:
    """Markdown: for each robot and size a row for every method: score by share, slope, mean, fall."""
    finals = finals_of(records)
    mixed = [record for record in records if "random_percent" in record["data"]]
    lines = [
        "Normalised scores at the last checkpoint by the percentage of random rows, means over seeds. `slope`: points",
        "gained for ten per cent more of them, by least squares; `fall` from the first share to the last.",
        "Made by `odaf reproduce mixtures` from the records in this folder.",
    ]
    for robot in ROBOTS:
        sizes: dict[str, int] = {}  # by what the name of a log has behind the share; public ones have nothing there
        for record in mixed:
            if record["task"].startswith(f"{robot}-mixture-"):
                suffix = record["task"].removeprefix(f"{robot}-mixture-").lstrip("0123456789")
                sizes[suffix] = max(sizes.get(suffix, 0), record["data"]["transitions"])
        for suffix, size in sorted(sizes.items(), key=lambda each: each[1]):
            rows = _rows(finals, robot, suffix)
            if rows:
                lines += [
                    "",
                    f"**{robot}**, {size:,} rows.",
                    "",
                    f"| method | {' | '.join(f'{share} %' for share in SHARES)} | slope | mean | fall | seeds |",
                    f"|{'---|' * (len(SHARES) + 5)}",
                    *rows,
                ]
    return "\n".join(lines) + "\n"


def _rows(finals: Finals, robot: str, suffix: str) -> list[str]:
    found: dict[str, dict[int, dict[int, float]]] = {}
    for share in SHARES:
        for method, seeds in finals.get(f"{robot}-mixture-{share}{suffix}", {}).items():
            found.setdefault(method, {})[share] = seeds
    rows = []
    for method, scores in found.items():
        means = {share: statistics.fmean(seeds.values()) for share, seeds in scores.items()}
        cells = [f"{means[share]:.1f}" if share in means else "" for share in SHARES]
        slope = fall = ""
        if len(means) > 1:
            line = np.polyfit(list(means), list(means.values()), 1)
            slope, values = f"{10 * line[0]:+.1f}", list(means.values())
            fall = f"{values[0] - values[-1]:.1f}"
        count = min(len(seeds) for seeds in scores.values())
        mean = statistics.fmean(means.values())
        rows.append((mean, f"| {method} | {' | '.join(cells)} | {slope} | {mean:.1f} | {fall} | {count} |"))
    return [row for _, row in sorted(rows, key=lambda each: -each[0])]


def summary(records: Sequence[Record]) -> str:
    """JSON: by log and method the score of each seed."""
    return json.dumps(finals_of(records), indent=1) + "\n"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel for each robot: a curve for every method."""
    from odaf.report.study_figures import Line, lines_figure

    finals, panels = finals_of(records), dict[str, list[Line]]()
    for robot in ROBOTS:
        methods = sorted({name for share in SHARES for name in finals.get(f"{robot}-mixture-{share}", {})})
        for method in methods:
            values = [list(by_share(finals, robot, method).get(share, {}).values()) for share in SHARES]
            panels.setdefault(robot, []).append(Line(method, SHARES, values))
    if panels:
        note = "mean over seeds, shade: one standard deviation"
        lines_figure(
            panels, out, "Scores by the share of random rows", note, "random rows, per cent", "normalised score"
        )


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "mixtures",
        "how scores fall as random rows are mixed into an expert's, on three robots",
        partial(plan, data),
        {"table.md": table, "summary.json": summary},
        {"figure.png": figure},
        CLAIM,
        on_files=study,
    )


STUDY = study()
