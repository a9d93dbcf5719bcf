"""The pictures of an assessment, each with the sentence that says what to see in it."""

import numpy as np
from matplotlib.axes import Axes

from odaf.assessment.after import Aftermath, ratios
from odaf.assessment.assess import DECIDES, Assessment
from odaf.data import Dataset
from odaf.estimation import Interval
from odaf.report.chart import NARROW, WIDE, Chart, chart_svg
from odaf.report.data_page.coverage import coverage
from odaf.report.drawing import plain_number, short_values, style_axes
from odaf.report.svg import THEMED

MOST_ACTIONS = 12
BINS = 40
_MARGINS = (0.55, 0.08, 0.42, 0.1)


def values_chart(found: Assessment, after: Aftermath | None) -> Chart:
    """What an episode is worth: logged, by each estimator that answered, and once the policy ran."""
    rows: list[tuple[str, Interval, bool]] = [("whoever wrote the log", found.valuation.behaviour, False)]
    for each in found.valuation.estimates:
        told = each.calibrated or each.value
        if told is not None and each.verdict != "refused":
            rows.append((each.method, told, each.method == DECIDES))
    if after is not None:
        rows.append(("once it ran", after.value, False))
    svg = chart_svg(
        "values", "Values of an episode with their intervals", (WIDE, 0.75 + 0.34 * len(rows)),
        lambda axes: _intervals(axes, rows), (1.5, 0.1, 0.42, 0.1),
    )  # fmt: skip
    return Chart(
        "What an episode is worth", svg,
        f"{found.valuation.confidence:.0%} intervals over episodes, in the log's unit of reward, to step "
        f"{found.valuation.horizon:,}. The band is what whoever wrote the log earned; the verdict goes by "
        f"{DECIDES}.",
    )  # fmt: skip


def _intervals(axes: Axes, rows: list[tuple[str, Interval, bool]]) -> None:
    logged = rows[0][1]
    if np.isfinite(logged.low):
        axes.axvspan(logged.low, logged.high, color=THEMED.grid, linewidth=0)
    for place, (_, interval, decides) in enumerate(rows):
        colour = THEMED.method(0) if decides else THEMED.muted
        if np.isfinite(interval.low):
            axes.plot([interval.low, interval.high], [place, place], color=colour, linewidth=2.2)
        axes.plot([interval.value], [place], marker="o", markersize=5, color=colour)
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("value of an episode", fontsize=8)
    style_axes(axes, THEMED, "x")


def action_charts(found: Assessment) -> list[Chart]:
    """Each action's values, logged and of the policy in the same states; the first dozen of them."""
    charts = []
    for index, column in enumerate(found.columns[:MOST_ACTIONS]):
        logged, own = found.holdout.actions[:, index], found.own[:, index]
        edges = float(found.holdout.action_low[index]), float(found.holdout.action_high[index])
        svg = chart_svg(
            f"action-{index}", f"Values of action {column.name}, logged and of the policy", (NARROW, 1.9),
            lambda axes, logged=logged, own=own, edges=edges, label=column.unit: _two_histograms(
                axes, logged, own, edges, label or "action"
            ),
            _MARGINS,
        )  # fmt: skip
        charts.append(
            Chart(
                column.name, svg,
                f"Grey: logged; line: the policy in the same states, {column.outside:.1%} of it beyond every logged "
                f"value. Usual change a step {plain_number(column.policy_change[1])}, logged "
                f"{plain_number(column.logged_change[1])}.",
            )
        )  # fmt: skip
    return charts


def _two_histograms(axes: Axes, logged: np.ndarray, own: np.ndarray, edges: tuple[float, float], label: str) -> None:
    shares, borders = np.histogram(logged, BINS, edges)
    axes.bar(borders[:-1], shares / max(len(logged), 1), np.diff(borders), align="edge", color=THEMED.data, linewidth=0)
    mine, _ = np.histogram(own, BINS, edges)
    axes.stairs(mine / max(len(own), 1), borders, color=THEMED.method(0), linewidth=1.3)
    axes.set_xlim(*edges)
    axes.set_xlabel(label, fontsize=8).set_parse_math(False)
    axes.set_ylabel("share of rows", fontsize=8)
    style_axes(axes, THEMED)
    short_values(axes)


def coverage_chart(found: Assessment) -> Chart | None:
    """The ground that the hold-out covers, and where the policy's own actions would lead off it."""
    ground = coverage(found.holdout)
    if ground is None or found.guard is None:
        return None
    marked = ratios(found.guard, found.holdout, own=True)[ground.rows] > 1.0
    svg = chart_svg(
        "coverage", "States of the hold-out along their two principal axes", (WIDE, 3.4),
        lambda axes: _ground(axes, ground.points, marked), _MARGINS,
    )  # fmt: skip
    return Chart(
        "Where the policy would leave the log", svg,
        f"Each dot is a state of the hold-out; the dark ones ({marked.mean():.1%}) are those where the guard has an "
        "alarm about what the policy would do there.",
    )  # fmt: skip


def _ground(axes: Axes, points: np.ndarray, marked: np.ndarray) -> None:
    for chosen, colour, alpha in ((~marked, THEMED.data, 0.35), (marked, THEMED.detour, 0.8)):
        axes.plot(
            points[chosen, 0], points[chosen, 1], linestyle="", marker="o", markersize=2.2, markeredgewidth=0,
            color=colour, alpha=alpha,
        )  # fmt: skip
    axes.set_xlabel("first component", fontsize=8)
    axes.set_ylabel("second component", fontsize=8)
    style_axes(axes, THEMED)
    short_values(axes)


def guard_chart(found: Assessment) -> Chart | None:
    """The guard's score over the hold-out episode in which it is highest."""
    if found.over_time is None:
        return None
    logged, own = found.over_time
    svg = chart_svg(
        "guard", "The guard's score over the episode in which it is highest", (WIDE, 2.6),
        lambda axes: _over_time(axes, logged, own), _MARGINS,
    )  # fmt: skip
    return Chart(
        "The guard over its worst episode", svg,
        "Score beside the threshold, which is 1, step by step: grey of the logged actions, coloured of the policy's "
        "own in the same states.",
    )  # fmt: skip


def _over_time(axes: Axes, logged: np.ndarray, own: np.ndarray) -> None:
    steps = np.arange(len(logged))
    axes.axhline(1.0, color=THEMED.ink, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.plot(steps, logged, color=THEMED.data, linewidth=1.0)
    axes.plot(steps, own, color=THEMED.method(0), linewidth=1.0)
    axes.set_yscale("log")
    axes.set_xlabel("step", fontsize=8)
    axes.set_ylabel("score / threshold", fontsize=8)
    style_axes(axes, THEMED)


def drift_chart(after: Aftermath) -> Chart:
    """How far each column moved once the policy ran."""
    rows = [(each.name, each.shift, each.moved) for each in after.drift]
    svg = chart_svg(
        "drift", "Shift of each column", (WIDE, 0.75 + 0.26 * len(rows)), lambda axes: _shifts(axes, rows),
        (1.5, 0.1, 0.42, 0.1),
    )  # fmt: skip
    return Chart(
        "What moved", svg,
        "Difference of each column's mean from the hold-out's, in standard deviations of its rows, with intervals over "
        "episodes. Coloured: surely moved, by more than a fifth.",
    )  # fmt: skip


def _shifts(axes: Axes, rows: list[tuple[str, Interval, bool]]) -> None:
    axes.axvline(0.0, color=THEMED.muted, linewidth=0.8)
    for place, (_, shift, moved) in enumerate(rows):
        colour = THEMED.detour if moved else THEMED.muted
        axes.plot([shift.low, shift.high], [place, place], color=colour, linewidth=2.0)
        axes.plot([shift.value], [place], marker="o", markersize=4, color=colour)
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=8)
    for text in axes.get_yticklabels():
        text.set_parse_math(False)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("standard deviations", fontsize=8)
    style_axes(axes, THEMED, "x")


def samples(dataset: Dataset) -> str:
    """How much stands behind it, in words."""
    return f"{dataset.num_episodes:,} episodes of {len(dataset):,} rows"
