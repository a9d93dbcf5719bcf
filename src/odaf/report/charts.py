"""From run records to the pictures of the page, each with the sentence that says what to see in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from odaf.data.spec import Spec
from odaf.report import drawing
from odaf.report.chart import NARROW, WIDE, Chart, chart_svg
from odaf.report.drawing import plain_number
from odaf.report.lettering import width_of
from odaf.report.quantities import Curve, Returns
from odaf.report.records import RunRecord, data_prints, optional
from odaf.report.scores import Score, episode_returns
from odaf.report.svg import THEMED
from odaf.training.monitors import value_bounds

COVERAGES = (50, 90)  # intervals in percent, as dynamics models report them


def references(runs: Sequence[RunRecord]) -> list[tuple[str, float]]:
    """Best and mean of the logged returns, once for every dataset that has a score to compare with."""
    lines: dict[Any, list[tuple[str, float]]] = {}
    for run, data in zip(runs, data_prints(runs), strict=True):
        if not run.evaluated:
            continue
        known = [("best logged", run.data_best), ("logged mean", run.data_mean)]
        lines.setdefault(data, [(name, value) for name, value in known if value is not None])
    return [line for group in lines.values() for line in group]


def return_curves(runs: Sequence[RunRecord], labels: Sequence[str]) -> list[Curve]:
    """Mean return at each evaluation, a curve a run; runs that were never evaluated have none."""
    curves = []
    for index, (run, label) in enumerate(zip(runs, labels, strict=True)):
        curve = quantity(run, label, index, "evaluation/return_mean")
        if curve is None:
            continue
        spread = quantity(run, label, index, "evaluation/return_std")
        one = spread is not None and len(curve.values) == 1 and np.array_equal(spread.steps, curve.steps)
        curves.append(
            Curve(label, curve.steps, curve.values, spread.values[0] if one and spread is not None else None, index)
        )
    return curves


def quantity(run: RunRecord, label: str, index: int, name: str) -> Curve | None:
    """One logged quantity of all seeds on a common axis, or `None` where no seed has a finite value."""
    logged = [seed.series[name] for seed in run.seeds if name in seed.series]
    logged = [series for series in logged if np.isfinite(series.values).any()]
    if not logged:
        return None
    steps = np.unique(np.concatenate([series.steps for series in logged]))
    values = np.full((len(logged), steps.size), np.nan)
    for row, series in zip(values, logged, strict=True):
        row[np.searchsorted(steps, series.steps)] = series.values
    return Curve(label, steps, values, None, index)


def curves_chart(runs: Sequence[RunRecord], labels: Sequence[str]) -> Chart | None:
    """Mean return over updates against the data's best and mean."""
    curves = return_curves(runs, labels)
    if not curves:
        return None

    def draw(axes: Axes) -> None:
        drawing.draw_curves(axes, THEMED, curves, references(runs))
        drawing.name_lines(axes, THEMED, references(runs))

    svg = chart_svg(
        "curves",
        "Mean return over updates",
        (WIDE, 3.1),
        draw,
    )
    several = any(len(curve.values) > 1 for curve in curves)
    shade = "the 95 % interval over seeds" if several else "one standard deviation over episodes, for there is one seed"
    if several and any(len(curve.values) == 1 for curve in curves):
        shade += ", or one standard deviation over episodes where there is one seed"
    if several:
        shade += ", cut off where it would squeeze the lines. Thin lines: the seeds"
    lines = "Above the upper dotted line is better than anything logged. " if references(runs) else ""
    return Chart("Return over updates", svg, f"{lines}Shaded: {shade}.")


def returns_chart(runs: Sequence[RunRecord], scores: Sequence[Score]) -> Chart | None:
    """Where the returns of logged and learned episodes lie, on one axis."""
    rows = [
        Returns(score.label, episode_returns(run), score.mean, score.interval, index)
        for index, (run, score) in enumerate(zip(runs, scores, strict=True))
    ]
    rows = [row for row in rows if row.returns.size]
    if not rows:
        return None
    logged = runs[0].logged_returns
    if logged is not None:
        rows.insert(0, Returns(f"the log ({logged.size:,} episodes)", logged, float(logged.mean()), None, None))
    left, right, bottom, top = margins = (0.02, 0.06, 0.42, 0.04)
    height = drawing.returns_height(rows, len(references(runs)), WIDE - left - right)
    svg = chart_svg(
        "returns", "Returns of logged and learned episodes", (WIDE, height + bottom + top),
        lambda axes: drawing.draw_returns(axes, THEMED, rows, references(runs)), margins=margins,
    )  # fmt: skip
    bars = " Bar: 95 % interval over seeds." if any(row.interval is not None for row in rows) else ""
    return Chart("Where the returns lie", svg, f"Every episode at the last checkpoint. Dot: mean.{bars}")


def critic_charts(runs: Sequence[RunRecord], labels: Sequence[str]) -> list[Chart]:
    """The critic's mean, smallest and largest output over training, a picture a run that has a critic."""
    charts = []
    for index, (run, label) in enumerate(zip(runs, labels, strict=True)):
        mean = quantity(run, label, index, "critic/mean")
        if mean is None:
            continue
        lowest, highest = (quantity(run, label, index, f"critic/{name}") for name in ("min", "max"))
        allowed = allowed_range(run)
        svg = chart_svg(
            f"critic-{index}", f"Critic range of {label}", (NARROW, 2.1),
            lambda axes, mean=mean, lowest=lowest, highest=highest, allowed=allowed: drawing.draw_critic(
                axes, THEMED, mean, lowest, highest, allowed
            ),
        )  # fmt: skip
        inside = _stays_inside(lowest, highest, allowed)
        charts.append(Chart(label, svg, inside, index))
    return charts


def allowed_range(run: RunRecord) -> tuple[float, float] | None:
    """Values that the logged rewards allow at the run's discount, as the divergence monitor takes them."""
    algorithm, spec = run.config.get("algorithm"), run.data.get("spec")
    settings = algorithm if isinstance(algorithm, Mapping) else {}
    discount = optional(settings.get("discount"))
    if discount is None or not 0 <= discount < 1 or not isinstance(spec, Mapping):
        return None
    try:
        return value_bounds(Spec.from_dict(spec), discount, float(settings.get("reward_shift", 0.0)))
    except (KeyError, TypeError, ValueError):
        return None


def _stays_inside(lowest: Curve | None, highest: Curve | None, allowed: tuple[float, float] | None) -> str:
    if lowest is None or highest is None:
        return "Line: mean output of the critics; their extremes were not logged."
    low, high = float(np.nanmin(lowest.values)), float(np.nanmax(highest.values))
    seen = f"from {plain_number(low)} to {plain_number(high)}"
    if allowed is None:
        return f"Outputs {seen}."
    beyond = max(allowed[0] - low, high - allowed[1])
    if beyond <= 0:
        return f"Outputs {seen}: inside what the rewards allow."
    return f"Outputs {seen}: up to {plain_number(beyond)} outside what the rewards allow."


def metric_chart(
    runs: Sequence[RunRecord], labels: Sequence[str], name: str, heading: str, caption: str, logarithmic: bool = False
) -> Chart | None:
    """One logged quantity of all runs that have it."""
    curves = [quantity(run, label, index, name) for index, (run, label) in enumerate(zip(runs, labels, strict=True))]
    known = [curve for curve in curves if curve is not None]
    if not known:
        return None
    finite = np.concatenate([curve.values[np.isfinite(curve.values)] for curve in known])
    decades = finite.min() > 0 and finite.max() > 10 * finite.min()
    svg = chart_svg(
        name.replace("/", "-"), heading, (NARROW, 2.1),
        lambda axes: drawing.draw_curves(axes, THEMED, known, logarithmic=logarithmic and bool(decades)),
    )  # fmt: skip
    return Chart(heading, svg, caption)


@dataclass(frozen=True)
class DynamicsCheck:
    """Hold-out error of one run's dynamics model, mean squared and in normalised units.

    Attributes:
        label: the method.
        kind: the model.
        rows: hold-out rows, `None` where not told.
        error: over all dimensions.
        no_change: error of predicting that nothing changes.
        names: dimensions with an error of their own, empty where not told.
        by_dimension: [dimensions] model's error.
        no_change_by_dimension: [dimensions].
        coverages: share of hold-out targets inside the predicted intervals, by what it should be; empty where the model
            predicts none.
        chart: picture of the two, `None` without dimensions.
    """

    label: str
    kind: str
    rows: int | None
    error: float
    no_change: float
    names: tuple[str, ...]
    by_dimension: tuple[float, ...]
    no_change_by_dimension: tuple[float, ...]
    coverages: dict[int, float]
    chart: Chart | None


def dynamics_checks(runs: Sequence[RunRecord], labels: Sequence[str]) -> list[DynamicsCheck]:
    """One check a run that pre-trained a dynamics model: the mean over seeds."""
    checks = []
    for index, (run, label) in enumerate(zip(runs, labels, strict=True)):
        reports = [found for seed in run.seeds if (found := _holdout_report(seed.summary.get("pretrain"))) is not None]
        if not reports:
            continue
        model, nothing = (_per_dimension(reports, f"{name}_mse_by_dimension") for name in ("holdout", "no_change"))
        names = list(run.summary_of_data.get("observation_names") or ())
        if len(names) != model.size:
            names = [f"dimension {place}" for place in range(model.size)]
        chart = None
        if model.size and model.size == nothing.size:
            svg = chart_svg(
                f"dynamics-{index}", f"Hold-out error of the dynamics model of {label}",
                (NARROW, 0.4 + 0.24 * model.size),
                lambda axes, names=names, model=model, nothing=nothing, index=index: drawing.draw_errors(
                    axes, THEMED, names, model, nothing, index
                ),
                margins=(0.15 + min(max(width_of(name, 8.0) for name in names) / 72, drawing.NAMES), 0.1, 0.25, 0.02),
            )  # fmt: skip
            chart = Chart(label, svg, "Dot: the model. Diamond: predicting no change. Left is better.", index)
        else:
            model, nothing, names = np.empty(0), np.empty(0), []
        checks.append(
            DynamicsCheck(
                label=label,
                kind=str(reports[0].get("kind", "dynamics model")),
                rows=reports[0].get("holdout_rows"),
                error=float(np.mean([report["holdout_mse"] for report in reports])),
                no_change=float(np.mean([report["no_change_mse"] for report in reports])),
                names=tuple(names),
                by_dimension=tuple(model.tolist()),
                no_change_by_dimension=tuple(nothing.tolist()),
                coverages=_coverages(reports),
                chart=chart,
            )
        )
    return checks


def _holdout_report(report: Any) -> Mapping[str, Any] | None:
    """The group that holds hold-out errors, however deep: each term of a learner has a group of its own."""
    if not isinstance(report, Mapping):
        return None
    if optional(report.get("holdout_mse")) is not None and optional(report.get("no_change_mse")) is not None:
        return report
    return next((found for value in report.values() if (found := _holdout_report(value)) is not None), None)


def _coverages(reports: Sequence[Mapping[str, Any]]) -> dict[int, float]:
    """Means over seeds, of the intervals that each of them tells."""
    found: dict[int, float] = {}
    for level in COVERAGES:
        shares = [share for report in reports if (share := optional(report.get(f"coverage_{level}"))) is not None]
        if len(shares) == len(reports):
            found[level] = float(np.mean(shares))
    return found


def _per_dimension(reports: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    lists = [report.get(name) for report in reports]
    sizes = {len(entry) if isinstance(entry, list) else 0 for entry in lists}
    if len(sizes) != 1 or sizes == {0}:
        return np.empty(0)
    return np.asarray(lists, np.float64).mean(axis=0)
