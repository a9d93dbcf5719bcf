"""The drawings of the report, each on a Matplotlib axes that the caller gives.

Nothing here opens a window or touches Matplotlib's global state, and no text is read as mathematical markup. The same
functions draw for the page, whose colours follow the reader's light or dark setting, and for picture files.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from scipy.special import stdtrit

from odaf.report.layout import Layout
from odaf.report.lettering import LINE, fitted, spread_out, width_of
from odaf.report.quantities import Curve, Returns, Trajectories

DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))
"""Line styles in the order of the methods, so that colour is never the only difference."""


@dataclass(frozen=True)
class Palette:
    """Colours by purpose, as Matplotlib takes them; those that carry meaning differ for colour-blind readers too."""

    ink: str
    muted: str
    grid: str
    surface: str
    wall: str
    data: str
    allowed: str
    stitched: str
    detour: str
    methods: tuple[str, ...]

    def method(self, index: int) -> str:
        """Colour of the method at `index`, going round when there are many."""
        return self.methods[index % len(self.methods)]


LIGHT = Palette(
    ink="#1c2329",
    muted="#5a6670",
    grid="#dde3e8",
    surface="#ffffff",
    wall="#cfd6dc",
    data="#7b868f",
    allowed="#e9eff4",
    stitched="#00795f",
    detour="#a83279",
    methods=("#0067a8", "#c94f00", "#a07400", "#4a3fa3", "#2b8fc4", "#7d5a3c", "#00795f", "#a83279"),
)
DARK = Palette(
    ink="#e8ecef",
    muted="#a2adb6",
    grid="#343c44",
    surface="#171c21",
    wall="#3a444d",
    data="#8c979f",
    allowed="#222b33",
    stitched="#3fd0a8",
    detour="#ee8fc6",
    methods=("#56b4ee", "#f58b4c", "#e3bc4b", "#a9a0f2", "#8ed1f5", "#c9a284", "#3fd0a8", "#ee8fc6"),
)


def draw_maze(
    axes: Axes,
    palette: Palette,
    layout: Layout,
    learned: Trajectories | None,
    logged: Trajectories | None,
    best: np.ndarray | None = None,
) -> None:
    """Walls and cell letters, logged paths in thin grey, the best logged path dotted, learned paths on top."""
    for x, y in layout.walls:
        # The edge closes the hairlines that renderers leave between neighbouring squares.
        corner = x - 0.5 * layout.cell, y - 0.5 * layout.cell
        square = Rectangle(corner, layout.cell, layout.cell, facecolor=palette.wall, linewidth=1.2)
        square.set_edgecolor(palette.wall)
        axes.add_patch(square)
    left, right, bottom, top = layout.view
    across, up = 0.44 * layout.cell, math.copysign(0.43 * layout.cell, top - bottom)
    for name, (x, y) in layout.names.items():
        text = axes.text(
            x - across, y + up, name, color=palette.muted, fontsize=8, fontweight="bold", va="top", ha="left"
        )
        text.set_parse_math(False)
        text.set_zorder(6)
    goal = layout.goal
    if goal is not None:
        axes.add_patch(
            Circle(goal, layout.reached, fill=False, edgecolor=palette.ink, linewidth=0.9, linestyle=(0, (3, 2)))
        )
    if logged is not None:
        for line in _joined(logged.positions, groups=8):
            axes.plot(line[:, 0], line[:, 1], color=palette.data, linewidth=0.5, alpha=0.4, solid_joinstyle="round")
    if best is not None:
        axes.plot(best[:, 0], best[:, 1], color=palette.ink, linewidth=1.3, linestyle=(0, (1, 1.6)), zorder=3)
    if learned is not None:
        _draw_learned(axes, palette, learned)
    x, y = layout.start
    axes.plot([x], [y], "o", markersize=6, markerfacecolor=palette.surface, markeredgecolor=palette.ink, zorder=7)
    if goal is not None:
        x, y = goal
        axes.plot([x], [y], "*", markersize=10, color=palette.ink, markeredgecolor=palette.surface, zorder=7)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_learned(axes: Axes, palette: Palette, learned: Trajectories) -> None:
    positions = learned.positions
    kinds = [(np.ones(len(positions), bool), palette.method(0), "-", "o")]
    if learned.good is not None:
        # The others first, so that the good paths lie on top where both go.
        others = (~learned.good, palette.detour, (0, (4, 1.5)), "x")
        kinds = [others, (learned.good, palette.stitched, "-", "o")]
    for chosen, colour, style, mark in kinds:
        if not chosen.any():
            continue
        paths = positions[chosen]
        for line in _joined(paths, groups=6):
            axes.plot(line[:, 0], line[:, 1], color=colour, linewidth=0.9, alpha=0.6, linestyle=style, zorder=4)
        last = np.isfinite(paths[:, :, 0]).sum(axis=1) - 1  # NaN comes only after the end
        ends = paths[np.arange(len(paths)), last]
        axes.plot(ends[:, 0], ends[:, 1], color=colour, linestyle="", marker=mark, markersize=3.5, alpha=0.9, zorder=5)


def _joined(paths: np.ndarray, groups: int) -> list[np.ndarray]:
    """Few long lines instead of many short ones, broken between episodes: quick to draw, and overlaps still darken."""
    broken = np.pad(paths, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    return [broken[start::groups].reshape(-1, 2) for start in range(min(groups, len(broken)))]


def draw_curves(
    axes: Axes,
    palette: Palette,
    curves: Sequence[Curve],
    references: Sequence[tuple[str, float]] = (),
    logarithmic: bool = False,
) -> None:
    """Mean over seeds as a line; around it the 95 % interval over seeds, or with one seed the spread over episodes.

    Each seed is a thin line. The axis has room for all lines, and for what is shaded as far as that does not squeeze
    them: two seeds give a wide interval. `references` are horizontal lines, which `name_lines` names once the axes has
    its size.
    """
    single = all(curve.steps.size == 1 for curve in curves)
    for curve in curves:
        colour = palette.method(curve.index)
        mean, low, high = band(curve)
        axes.fill_between(curve.steps, low, high, color=colour, alpha=0.16, linewidth=0)
        for values in curve.values if len(curve.values) > 1 else ():
            axes.plot(curve.steps, values, color=colour, linewidth=0.6, alpha=0.45)
        marker = "o" if curve.steps.size <= 12 else ""
        dashes = DASHES[curve.index % len(DASHES)]
        axes.plot(
            curve.steps,
            mean,
            color=colour,
            linewidth=1.9,
            linestyle=dashes,
            marker=marker,
            markersize=3.5,
            label=curve.label,
        )
    for _, value in references:
        axes.axhline(value, color=palette.ink, linewidth=1.0, linestyle=(0, (1, 1.6)), zorder=1)
    low, high = _room(curves, [value for _, value in references], logarithmic)
    if logarithmic:
        axes.set_yscale("log")
        _plain_powers(axes.yaxis)
    if low < high:
        axes.set_ylim(low, high)
    if not single:
        axes.set_xlim(left=0)
    style_axes(axes, palette)
    step_axis(axes)
    if not logarithmic:
        short_values(axes)


def name_lines(axes: Axes, palette: Palette, references: Sequence[tuple[str, float]]) -> None:
    """Names the horizontal lines of `draw_curves`, each just above its line where no other name stands.

    Called when the axes has the size and the limits that it will have. Names stand at the left, where curves that learn
    are still low.
    """
    points = axes.get_window_extent().height * 72.0 / axes.get_figure(root=True).dpi  # type: ignore[union-attr]
    low, high = axes.get_ylim()
    size = 7.5
    heights = [points * (value - low) / (high - low) + 1.5 for _, value in references]
    for (name, value), place in zip(references, spread_out(heights, LINE * size, 0.0, points), strict=True):
        text = axes.annotate(
            f"{name} {plain_number(value)}", (0.01, 0.0), xycoords="axes fraction", xytext=(0, place),
            textcoords="offset points", fontsize=size, color=palette.ink, va="bottom",
        )  # fmt: skip
        text.set_parse_math(False)


def _room(curves: Sequence[Curve], references: Sequence[float], logarithmic: bool) -> tuple[float, float]:
    """Limits of the vertical axis: all lines, and the shaded bands as far as half the height of the lines."""
    lines = np.concatenate([*(curve.values.ravel() for curve in curves), np.asarray(references, np.float64)])
    lines = lines[np.isfinite(lines)]
    if not lines.size:
        return 0.0, 0.0
    low, high = float(lines.min()), float(lines.max())
    if logarithmic:
        return 0.8 * low, 1.25 * high
    bands = [band(curve)[1:] for curve in curves]
    size = high - low
    lowest = max(min([low, *(float(np.nanmin(edge, initial=low)) for edge, _ in bands)]), low - 0.5 * size)
    highest = min(max([high, *(float(np.nanmax(edge, initial=high)) for _, edge in bands)]), high + 0.5 * size)
    size = (highest - lowest) or 1e-3 * max(abs(high), 1.0)
    return lowest - 0.05 * size, highest + 0.07 * size


def band(curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[points] mean over seeds, and the lower and upper edge of what is drawn around it.

    With several seeds that is Student's 95 % interval of the mean at each point, without width where only one seed has
    a value; with one seed, the mean less and plus the spread over episodes.
    """
    known = np.isfinite(curve.values)
    count = known.sum(axis=0)
    total = np.where(known, curve.values, 0.0).sum(axis=0)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    if len(curve.values) > 1:
        squares = np.where(known, (curve.values - mean) ** 2, 0.0).sum(axis=0)
        error = np.sqrt(squares / np.maximum(count - 1, 1) / np.maximum(count, 1))
        half = np.where(count > 1, stdtrit(np.maximum(count - 1, 1), 0.975) * error, 0.0)
        return mean, mean - half, mean + half
    spread = np.zeros_like(mean) if curve.spread is None else curve.spread
    return mean, mean - spread, mean + spread


def extremes(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """[points] the least and the greatest value over seeds, NaN where no seed has one."""
    known = np.isfinite(curve.values)
    low = np.where(known, curve.values, np.inf).min(axis=0)
    high = np.where(known, curve.values, -np.inf).max(axis=0)
    return np.where(known.any(axis=0), low, np.nan), np.where(known.any(axis=0), high, np.nan)


_LABEL, _HISTOGRAM, _TICKS = 8.0, 0.35, 0.15  # size of a row's name in points; heights in inches


def returns_height(rows: Sequence[Returns], references: int, width: float) -> float:
    """Inches that `draw_returns` needs for its axes, `width` inches wide, with so many references."""
    return _row_height(rows, width) * (max(len(rows), 2) + 0.3) + _TICKS * max(references, 1)


def _row_height(rows: Sequence[Returns], width: float) -> float:
    lines = max(_name_of_row(row, width).count("\n") + 1 for row in rows)
    return _HISTOGRAM + 0.15 + LINE * _LABEL / 72.0 * lines


def _name_of_row(row: Returns, width: float) -> str:
    return fitted(row.label, 72.0 * width - 4.0, _LABEL, bold=True)


def draw_returns(
    axes: Axes, palette: Palette, rows: Sequence[Returns], references: Sequence[tuple[str, float]]
) -> None:
    """One histogram a row on a common axis, with the mean as a dot and its interval over seeds as a bar."""
    width = axes.get_window_extent().width / axes.get_figure(root=True).dpi  # type: ignore[union-attr]
    inches = _row_height(rows, width)
    tall = _HISTOGRAM / inches
    known = [row.returns for row in rows if row.returns.size]
    everything = np.concatenate(known) if known else np.zeros(1)
    low, high = float(everything.min()), float(everything.max())
    edges = np.linspace(low, high if high > low else low + 1.0, 61)
    for position, row in enumerate(rows):
        base = len(rows) - 1 - position
        colour = palette.data if row.index is None else palette.method(row.index)
        if row.returns.size:
            heights, _ = np.histogram(row.returns, edges)
            axes.bar(
                edges[:-1], tall * heights / max(heights.max(), 1), np.diff(edges), bottom=base, align="edge",
                color=colour, alpha=0.55 if row.index is None else 0.75, linewidth=0,
            )  # fmt: skip
        axes.axhline(base, color=palette.grid, linewidth=0.8, zorder=0)
        if row.interval is not None:
            axes.plot(row.interval, [base - 0.08] * 2, color=palette.ink, linewidth=1.6)
        if row.mean is not None:
            axes.plot([row.mean], [base - 0.08], "o", markersize=5, color=colour, markeredgecolor=palette.ink)
        label = axes.annotate(
            _name_of_row(row, width), (0.0, base + tall), xycoords=("axes fraction", "data"), xytext=(2, 2),
            textcoords="offset points", fontsize=_LABEL, color=palette.ink, fontweight="bold", va="bottom",
            linespacing=1.1, bbox={"facecolor": palette.surface, "edgecolor": "none", "pad": 0.5},
        )  # fmt: skip
        label.set_parse_math(False)
    wanted = [row.interval for row in rows if row.interval is not None] + [(value, value) for _, value in references]
    left, right = _limits(edges, wanted)
    axes.set_xlim(left, right)
    visible = [(name, value) for name, value in references if left <= value <= right]
    # Each name on a line of its own, because best and mean may lie close together.
    for place, (name, value) in enumerate(visible):
        axes.axvline(value, color=palette.ink, linewidth=1.0, linestyle=(0, (1, 1.6)), zorder=1)
        said = f"{name} {plain_number(value)}"
        leftwards = (value - left) / (right - left) + width_of(said, 7.5) / (72.0 * width) > 0.97
        text = axes.annotate(
            said, (value, 1.0), xycoords=("data", "axes fraction"), va="top", ha="right" if leftwards else "left",
            xytext=(-3 if leftwards else 3, -72 * _TICKS * place), textcoords="offset points", fontsize=7.5,
            color=palette.ink,
        )  # fmt: skip
        text.set_parse_math(False)
    axes.set_ylim(-0.3, max(len(rows), 2) + _TICKS / inches * max(len(visible), 1))
    axes.set_yticks([])
    style_axes(axes, palette, lines="x")
    axes.set_xlabel("undiscounted return of an episode", color=palette.muted, fontsize=8)


def _limits(edges: np.ndarray, intervals: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Room for all returns, and for intervals and marks as far as they do not squeeze the returns."""
    low, high = float(edges[0]), float(edges[-1])
    width = high - low
    lowest = max(min([low, *(interval[0] for interval in intervals)]), low - 0.5 * width)
    highest = min(max([high, *(interval[1] for interval in intervals)]), high + 0.5 * width)
    return lowest - 0.03 * width, highest + 0.03 * width


def draw_critic(
    axes: Axes,
    palette: Palette,
    mean: Curve,
    lowest: Curve | None,
    highest: Curve | None,
    allowed: tuple[float, float] | None,
) -> None:
    """Mean of the critic, its smallest and largest output as a band, and behind them what the rewards allow."""
    colour = palette.method(mean.index)
    middle, _, _ = band(mean)
    shown = [middle]
    if lowest is not None and highest is not None and np.array_equal(lowest.steps, highest.steps):
        low, high = extremes(lowest)[0], extremes(highest)[1]
        axes.fill_between(lowest.steps, low, high, color=colour, alpha=0.22, linewidth=0, zorder=2)
        shown += [low, high]
    axes.plot(mean.steps, middle, color=colour, linewidth=1.9, zorder=3)
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    if allowed is not None:
        axes.axhspan(*allowed, color=palette.allowed, zorder=0, linewidth=0)
        for edge in allowed:
            axes.axhline(edge, color=palette.muted, linewidth=0.8, linestyle=(0, (1, 1.6)), zorder=1)
        note = axes.annotate(
            f"rewards allow {plain_number(allowed[0])} to {plain_number(allowed[1])}", (0.01, allowed[1]),
            xycoords=("axes fraction", "data"), xytext=(0, -3), textcoords="offset points", fontsize=7.5,
            color=palette.muted, va="top",
        )  # fmt: skip
        note.set_parse_math(False)
        width = max(allowed[1] - allowed[0], 1e-6)
        if values.size and (values.max() > allowed[1] + 3 * width or values.min() < allowed[0] - 3 * width):
            axes.set_yscale("symlog", linthresh=width)
            axes.yaxis.set_minor_locator(NullLocator())
    if mean.steps.size > 1:
        axes.set_xlim(0, mean.steps[-1])
    style_axes(axes, palette)
    step_axis(axes)
    short_values(axes)


NAMES = 1.3
"""Inches that the names of dimensions may take beside `draw_errors`."""


def draw_errors(
    axes: Axes, palette: Palette, names: Sequence[str], model: np.ndarray, baseline: np.ndarray, index: int
) -> None:
    """Per dimension, the model's hold-out error beside that of predicting no change, on a logarithmic axis."""
    places = np.arange(len(names))[::-1]
    for place, left, right in zip(places, model, baseline, strict=True):
        axes.plot([left, right], [place, place], color=palette.grid, linewidth=2, zorder=1)
    axes.plot(baseline, places, "D", color=palette.data, markersize=5, zorder=2)
    axes.plot(model, places, "o", color=palette.method(index), markersize=6, zorder=3)
    if (np.concatenate([model, baseline]) > 0).all():
        axes.set_xscale("log")
        _plain_powers(axes.xaxis)
    axes.set_yticks(places, [fitted(name, 72.0 * NAMES, 8.0, lines=1) for name in names])
    for tick in axes.get_yticklabels():
        tick.set_parse_math(False)
    axes.set_ylim(-0.6, len(names) - 0.4)
    style_axes(axes, palette, lines="x")
    axes.tick_params(axis="y", labelcolor=palette.ink)


def step_axis(axes: Axes) -> None:
    """Updates on the horizontal axis, written short: 5k, 1.5M."""
    axes.xaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: short_count(value)))
    axes.set_xlabel("updates", fontsize=8)


def short_count(value: int | float) -> str:
    """1500 as 1.5k, 2000000 as 2M."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{letter}"
    return f"{value:g}"


def plain_number(value: int | float) -> str:
    """About three digits that mean something: 1,234, 121.3, 7.26, 0.0123."""
    size = abs(value)
    if not np.isfinite(value):
        return "–"
    if size >= 1000:
        return f"{value:,.0f}" if size < 1e7 else f"{value:.2e}"
    if size >= 10 or value == 0:
        return f"{value:.1f}"
    return f"{value:.2f}" if size >= 1 else f"{value:.3g}"


def short_values(axes: Axes) -> None:
    """Numbers on the vertical axis written short: 5k, 1.5M."""
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: short_count(value)))


def _plain_powers(axis: Axis) -> None:
    """Powers of ten written out, without the marks between them."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("e-0", "e-").replace("e+0", "e")))
    axis.set_minor_locator(NullLocator())


def style_axes(axes: Axes, palette: Palette, lines: str = "y") -> None:
    """The look that all pictures share: no frame but the bottom line, quiet ticks, a grid across `lines`."""
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(palette.muted)
    axes.tick_params(colors=palette.muted, labelsize=8, length=0)
    axes.xaxis.label.set_color(palette.muted)
    axes.yaxis.label.set_color(palette.muted)
    axes.grid(axis=lines, color=palette.grid, linewidth=0.7)  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    axes.patch.set_alpha(0.0)
