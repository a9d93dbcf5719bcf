"""The pictures of a data set, each with the sentence that says what to see in it."""

import numpy as np
from matplotlib.axes import Axes

from odaf.data import Dataset
from odaf.report.chart import NARROW, WIDE, Chart, chart_svg
from odaf.report.data_page.coverage import Coverage, coverage
from odaf.report.drawing import Palette, draw_maze, plain_number, short_count, short_values, style_axes
from odaf.report.layout import maze_layout
from odaf.report.paths import MAX_PATHS, stacked
from odaf.report.quantities import Trajectories
from odaf.report.svg import THEMED

BINS = 40
MOST_ACTIONS = 24
_MARGINS = (0.5, 0.08, 0.42, 0.1)


def returns_chart(dataset: Dataset) -> Chart:
    """How the returns of episodes are spread."""
    returns = dataset.episode_returns()
    svg = chart_svg(
        "returns", "Returns of the logged episodes", (WIDE, 2.6),
        lambda axes: histogram(axes, THEMED, returns, "return of an episode", "episodes"), _MARGINS,
    )  # fmt: skip
    few = "" if len(returns) >= 20 else " There are few episodes: the shape says little."
    return Chart(
        "Returns", svg,
        f"Undiscounted sums of rewards: mean {plain_number(float(returns.mean()))}, "
        f"best {plain_number(float(returns.max()))}, worst {plain_number(float(returns.min()))}.{few}",
    )  # fmt: skip


def lengths_chart(dataset: Dataset) -> Chart:
    """How long episodes are."""
    lengths = dataset.episode_lengths()
    svg = chart_svg(
        "lengths", "Lengths of the logged episodes", (WIDE, 2.6),
        lambda axes: histogram(axes, THEMED, lengths, "steps of an episode", "episodes"), _MARGINS,
    )  # fmt: skip
    share = dataset.summary()["terminal_share"]
    return Chart("Lengths", svg, f"{share:.1%} of the episodes ended by themselves, the others were cut.")


def coverage_chart(dataset: Dataset) -> Chart | None:
    """The ground that the observations cover; None where fewer than two columns vary."""
    found = coverage(dataset)
    if found is None:
        return None
    svg = chart_svg(
        "coverage", "Observations along their two principal axes", (WIDE, 3.6),
        lambda axes: draw_coverage(axes, THEMED, found), _MARGINS,
    )  # fmt: skip
    axes = [
        f"the {which} axis holds {share:.0%} of the variance, most of it in {', '.join(names)}"
        for which, share, names in zip(("horizontal", "vertical"), found.explained, found.leading, strict=True)
    ]
    return Chart(
        "Ground covered", svg,
        f"Principal components of the normalised observations: {'; '.join(axes)}. Dark: rows of the best tenth of the "
        "episodes by return. A policy can be trusted where there are dots, and not far from them.",
    )  # fmt: skip


def maze_chart(dataset: Dataset) -> Chart | None:
    """Some logged paths in the maze that the data are of; None where they are of none that can be drawn."""
    layout = maze_layout(dataset.environment)
    if layout is None or dataset.obs_dim < 2:
        return None
    chosen = np.unique(np.linspace(0, dataset.num_episodes - 1, MAX_PATHS).astype(int)).tolist()
    paths = [dataset.observations[dataset.episode(index), :2][None] for index in chosen]
    svg = chart_svg(
        "maze", f"Logged paths in the maze {layout.name}", (NARROW, NARROW * layout.aspect),
        lambda axes: draw_maze(axes, THEMED, layout, None, Trajectories(stacked(paths))), (0, 0, 0, 0),
    )  # fmt: skip
    every = len(chosen) == dataset.num_episodes
    shown = "All episodes" if every else f"{len(chosen)} of {dataset.num_episodes:,} episodes"
    return Chart("Paths", svg, f"{shown}, in the plane of the first two observations. ○ start, ★ goal.")


def action_charts(dataset: Dataset) -> list[Chart]:
    """How each action is spread between its bounds, one picture an action, the first two dozen of them."""
    charts = []
    for index, name in enumerate(dataset.action_names[:MOST_ACTIONS]):
        low, high = float(dataset.action_low[index]), float(dataset.action_high[index])
        values = dataset.actions[:, index]
        unit = (dataset.action_units or ("",) * dataset.act_dim)[index]
        svg = chart_svg(
            f"action-{index}", f"Logged values of action {name}", (NARROW, 1.9),
            lambda axes, values=values, edges=(low, high), unit=unit: histogram(
                axes, THEMED, values, unit or "action", "rows", edges
            ),
            _MARGINS,
        )  # fmt: skip
        on = float(np.mean((values <= dataset.action_low[index]) | (values >= dataset.action_high[index])))
        charts.append(Chart(name, svg, f"{on:.1%} of the rows lie on a bound ({low:g} or {high:g})."))
    return charts


def histogram(
    axes: Axes, palette: Palette, values: np.ndarray, label: str, of: str, edges: tuple[float, float] | None = None
) -> None:
    """Counts of `values` in equal bins, between `edges` or over their own range."""
    low, high = (float(values.min()), float(values.max())) if edges is None else edges
    if low == high:
        low, high = low - 0.5, high + 0.5
    counts, borders = np.histogram(values, BINS, (low, high))
    axes.bar(borders[:-1], counts, np.diff(borders), align="edge", color=palette.method(0), linewidth=0)
    axes.set_xlim(low, high)
    axes.set_xlabel(label, fontsize=8).set_parse_math(False)
    axes.set_ylabel(of, fontsize=8)
    style_axes(axes, palette)
    short_values(axes)
    axes.xaxis.set_major_formatter(lambda value, _: short_count(round(value, 6)))


def draw_coverage(axes: Axes, palette: Palette, found: Coverage) -> None:
    """All drawn rows as pale dots, those of good episodes above them as dark ones."""
    for chosen, colour, alpha in ((~found.good, palette.data, 0.35), (found.good, palette.stitched, 0.7)):
        axes.plot(
            found.points[chosen, 0], found.points[chosen, 1], linestyle="", marker="o", markersize=2.2,
            markeredgewidth=0, color=colour, alpha=alpha,
        )  # fmt: skip
    for axis, share, name in zip((axes.xaxis, axes.yaxis), found.explained, ("first", "second"), strict=True):
        axis.set_label_text(f"{name} component, {share:.0%} of the variance", fontsize=8)
    style_axes(axes, palette)
