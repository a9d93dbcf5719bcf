"""How results are printed: plain tables that a terminal, a file and a person can read."""

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.cli.spelling import spelled
from odaf.errors import OdafError
from odaf.report.plain_tables import table

if TYPE_CHECKING:
    from odaf.data.checks import Report
    from odaf.evaluation import Estimate, Run, Scores
    from odaf.runs.evaluate_attacks import AttackCurve


def number(value: float | None, digits: int = 1) -> str:
    """A number with thousands separators; a dash for what is not known."""
    return "-" if value is None or math.isnan(value) else f"{value:,.{digits}f}"


def run_table(summaries: Mapping[int, Mapping[str, Any]]) -> str:
    """One line for each seed of a run: where it stands and what its last checkpoint scored."""
    evaluations = {seed: summary.get("evaluation") or {} for seed, summary in summaries.items()}
    rates = sorted({name for entry in evaluations.values() for name in entry if name.endswith("_rate")})
    header = ["seed", "updates", "status", "mean return", "std", *(_words(rate) for rate in rates), "updates/s"]
    rows = [
        [
            str(seed),
            f"{summary['step']:,}",
            str(summary["status"]),
            number(evaluations[seed].get("mean_return")),
            number(evaluations[seed].get("std_return")),
            *(number(evaluations[seed].get(rate), 2) for rate in rates),
            number(summary.get("updates_per_second")),
        ]
        for seed, summary in summaries.items()
    ]
    return table(header, rows)


def score_table(scores: "Scores") -> str:
    """One line for each seed that was evaluated."""
    rates = sorted({rate for score in scores.by_seed for rate in score.rates})
    header = ["seed", "updates", "mean return", "std", *(_words(rate) for rate in rates), "episodes"]
    rows = [
        [
            str(score.seed),
            f"{score.step:,}",
            number(score.mean_return),
            number(score.std_return),
            *(number(score.rates.get(rate), 2) for rate in rates),
            str(len(score.returns)),
        ]
        for score in scores.by_seed
    ]
    return f"{table(header, rows)}{played_in(scores)}"


def played_in(scores: "Scores") -> str:
    """A line on what played the episodes; empty where it is not known."""
    from odaf.environments.contact_margins import in_words

    words = in_words(scores.simulator)
    return f"\n\nplayed in {words}" if words else ""


def estimated(estimate: "Estimate") -> str:
    """A mean with its interval over seeds; alone where there is one seed."""
    if estimate.count < 2:
        return f"{number(estimate.mean)} (one seed)"
    return (
        f"{number(estimate.mean)}, {estimate.confidence:.0%} interval {_interval(estimate)} over {estimate.count} seeds"
    )


def attack_table(curve: "AttackCurve") -> str:
    """One line for each budget, and the area under the curve."""
    scores, normalised, area = curve.scores, curve.normalised, curve.area()
    rates = sorted({rate for score in scores[0].by_seed for rate in score.rates})
    header = ["eps", *(["normalised", "95 % interval"] if normalised else []), "mean return", "95 % interval"]
    rows = []
    for place, budget in enumerate(curve.budgets):
        entries = [*([normalised[place]] if normalised else []), curve.returns[place]]
        cells = [cell for entry in entries for cell in (number(entry.mean), _interval(entry))]
        rows.append([f"{budget:g}", *cells, *(number(scores[place].rate(rate), 2) for rate in rates)])
    text = table([*header, *(_words(rate) for rate in rates)], rows) + played_in(scores[0])
    if area is None:
        return text
    text += f"\n\narea under the curve, divided by its width: {estimated(area)}"
    if (score := curve.normalised_area()) is not None:
        text += f"\n{curve.environment}: as a normalised score {estimated(score)}"
    return text


def _interval(estimate: "Estimate") -> str:
    return "-" if estimate.count < 2 else f"{number(estimate.low)} to {number(estimate.high)}"


def quoted(place: Path) -> str:
    """A path as a word of the shell, in a command that is to be given next."""
    return shlex.quote(str(place))


def print_run(run: "Run") -> None:
    """The table of a run, the mean over its seeds, its warnings, and what to do next."""
    summaries = run.summary
    print(run_table(summaries))
    if len(summaries) > 1 and all(summary.get("evaluation") for summary in summaries.values()):
        print(f"\n{run.scores()}")
    scored = all(summary.get("evaluation") for summary in summaries.values())
    if scored:
        print(played_in(run.scores()).lstrip("\n"))
    for seed, summary in summaries.items():
        for warning in summary["warnings"]:
            print(f"\nwarning, seed {seed}: {warning['message']}")
    place = quoted(run.directory)
    print(f"\nThe run is in {run.directory}; draw it with: odaf report {place} --out report.html")
    if not scored and _counts_rewards(run):
        print(f"Its policy counts what it earns, so only playing it judges it: odaf evaluate {place} --env ID")
    elif not scored:
        print(f"Whether its policy may run, judged from a hold-out alone: odaf assess {place} --data HOLDOUT")


def _counts_rewards(run: "Run") -> bool:
    """Whether a hold-out cannot judge its policy; False where there is none yet."""
    try:
        return run.policy().actor.takes_rewards
    except OdafError:
        return False


def print_runs(runs: Sequence["Run"], folder: Path) -> None:
    """A line for each of several runs: how far its seeds are, and their mean; then warnings and what to do next."""
    header = ["run", "seeds", "updates", "status", "mean return", "95 % interval"]
    rows = []
    for run in runs:
        summaries = run.summary.values()
        scored = all(summary.get("evaluation") for summary in summaries)
        mean = run.scores().estimate() if scored else None
        rows.append(
            [
                str(run.directory),
                str(len(summaries)),
                f"{min(summary['step'] for summary in summaries):,}",
                ", ".join(dict.fromkeys(str(summary["status"]) for summary in summaries)),
                number(mean.mean if mean else None),
                _interval(mean) if mean else "-",
            ]
        )
    print(table(header, rows))
    for run in runs:
        for seed, summary in run.summary.items():
            for warning in summary["warnings"]:
                print(f"\nwarning, {run.directory}, seed {seed}: {warning['message']}")
    print(f"\nThe runs are in {folder}; draw them with: odaf report {quoted(folder)} --out report.html")
    if not all(summary.get("evaluation") for run in runs for summary in run.summary.values()):
        print(f"Which of them to deploy, judged from a hold-out alone: odaf select {quoted(folder)} --data HOLDOUT")


def print_report(report: "Report") -> None:
    """What the checks found, in the command line's spelling: coloured on a terminal, plain text 110 wide elsewhere."""
    findings = [replace(each, message=spelled(each.message), remedy=spelled(each.remedy)) for each in report.findings]
    report = replace(report, findings=tuple(findings))
    if not sys.stdout.isatty():
        print(report)
        return
    from rich.console import Console

    Console().print(report)


def _words(name: str) -> str:
    return name.removesuffix("_rate").replace("_", " ")
