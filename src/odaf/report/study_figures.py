"""Pictures of studies: bars with their seeds, curves over a setting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odaf.report.extras import check_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odaf.report.layout import Layout
    from odaf.report.quantities import Trajectories


@dataclass(frozen=True)
class Bar:
    """A bar: its name, its height, and the values that it is the mean of."""

    name: str
    height: float
    values: Sequence[float] = ()


@dataclass(frozen=True)
class Line:
    """A curve: for each place on the axis the values of its seeds; an empty place is left out."""

    name: str
    places: Sequence[float]
    values: Sequence[Sequence[float]]


def bars_figure(panels: Mapping[str, Sequence[Bar]], out: Path, title: str, note: str, columns: int = 3) -> Path:
    """Writes a PNG of bars, a panel each, every seed as a dot.

    Args:
        panels: by heading.
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.
        columns: panels side by side.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from odaf.report import drawing
    from odaf.report.figures import write_figure
    from odaf.report.lettering import fitted

    palette = drawing.LIGHT
    figure, every = _grid(len(panels), columns, (3.0, 2.6))
    for axes, (heading, bars) in zip(every, panels.items(), strict=False):
        drawing.style_axes(axes, palette, "y")
        for number, bar in enumerate(bars):
            axes.bar(number, bar.height, 0.7, color=palette.method(number), alpha=0.85)
            axes.plot([number] * len(bar.values), bar.values, "o", color=palette.ink, markersize=2.5, alpha=0.7)
        axes.set_xticks(range(len(bars)), labels=[bar.name for bar in bars], rotation=30, ha="right", fontsize=7)
        axes.set_title(fitted(heading, 72 * 2.8, 9), fontsize=9, color=palette.ink, parse_math=False)
    _words(figure, title, note)
    return write_figure(figure, out)


def lines_figure(
    panels: Mapping[str, Sequence[Line]],
    out: Path,
    title: str,
    note: str,
    across: str,
    up: str,
    references: Mapping[str, Sequence[tuple[str, float]]] | None = None,
    columns: int = 3,
) -> Path:
    """Writes a PNG of curves, a panel each: the mean over seeds and one standard deviation around it.

    Args:
        panels: by heading.
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.
        across: what the horizontal axis is.
        up: what the vertical axis is.
        references: by heading, names and heights of horizontal lines.
        columns: panels side by side.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from odaf.report import drawing
    from odaf.report.figures import write_figure
    from odaf.report.lettering import fitted

    palette = drawing.LIGHT
    figure, every = _grid(len(panels), columns, (3.3, 2.8))
    names = list(dict.fromkeys(line.name for lines in panels.values() for line in lines))
    for axes, (heading, lines) in zip(every, panels.items(), strict=False):
        drawing.style_axes(axes, palette, "both")
        for line in lines:
            number = names.index(line.name)
            there = [place for place, values in enumerate(line.values) if len(values)]
            if not there:
                continue
            places = [line.places[place] for place in there]
            means = np.array([np.mean(line.values[place]) for place in there])
            spread = np.array([np.std(line.values[place]) for place in there])
            colour, dash = palette.method(number), drawing.DASHES[number % len(drawing.DASHES)]
            axes.plot(places, means, color=colour, linestyle=dash, marker="o", markersize=3, linewidth=1.5)
            axes.fill_between(places, means - spread, means + spread, color=colour, alpha=0.15, linewidth=0)
        for name, height in (references or {}).get(heading, ()):
            axes.axhline(height, color=palette.muted, linewidth=0.8, linestyle=":")
            axes.annotate(name, (0.01, height), xycoords=("axes fraction", "data"), fontsize=6.5, color=palette.muted)
        axes.set_xlabel(across, fontsize=8)
        axes.set_ylabel(up, fontsize=8)
        axes.set_title(fitted(heading, 72 * 3.0, 9), fontsize=9, color=palette.ink, parse_math=False)
    for number, name in enumerate(names):
        dash = drawing.DASHES[number % len(drawing.DASHES)]
        every[0].plot([], [], color=palette.method(number), linestyle=dash, marker="o", markersize=3, label=name)
    legend = figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=7.5)
    for text in legend.get_texts():
        text.set_parse_math(False)
    _words(figure, title, note)
    return write_figure(figure, out)


def _grid(panels: int, columns: int, size: tuple[float, float]) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    across = max(1, min(columns, panels))
    down = -(-panels // across)
    figure = Figure(figsize=(size[0] * across, size[1] * down + 0.6), layout="constrained", facecolor="white")
    return figure, [figure.add_subplot(down, across, place + 1) for place in range(panels)]


def _words(figure: "Figure", title: str, note: str) -> None:
    from odaf.report import drawing
    from odaf.report.lettering import fitted

    room = 72 * (figure.get_figwidth() - 0.3)
    figure.suptitle(fitted(title, room, 11), fontsize=11, parse_math=False)
    figure.supxlabel(fitted(note, room, 7.5), fontsize=7.5, color=drawing.LIGHT.muted, parse_math=False)


@dataclass(frozen=True)
class Cloud:
    """Points over a density: the corners of its grid, counts in its cells, and points (x, y) by name."""

    low: Sequence[float]
    high: Sequence[float]
    counts: Sequence[Sequence[int]]
    points: dict[str, Sequence[Sequence[float]]]


def clouds_figure(panels: Mapping[str, Cloud], out: Path, title: str, note: str, columns: int = 3) -> Path:
    """Writes a PNG of points over a grey density, a panel each; what lies outside the grid is drawn at its edge.

    Args:
        panels: by heading.
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.
        columns: panels side by side.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from odaf.report import drawing
    from odaf.report.figures import write_figure
    from odaf.report.lettering import fitted

    palette = drawing.LIGHT
    figure, every = _grid(len(panels), columns, (3.3, 3.0))
    for axes, (heading, cloud) in zip(every, panels.items(), strict=False):
        (left, bottom), (right, top) = cloud.low, cloud.high
        density = np.log1p(np.array(cloud.counts, float)).T
        axes.imshow(density, origin="lower", extent=(left, right, bottom, top), cmap="Greys", aspect="auto", alpha=0.6)
        reach = (right - left) * 0.25, (top - bottom) * 0.25
        for number, (name, points) in enumerate(cloud.points.items()):
            across, up = np.array(points, float).T
            across = np.clip(across, left - reach[0], right + reach[0])
            up = np.clip(up, bottom - reach[1], top + reach[1])
            axes.plot(across, up, ".", color=palette.method(number), markersize=2.5, alpha=0.6, label=name)
        axes.tick_params(colors=palette.muted, labelsize=7, length=0)
        axes.set_title(fitted(heading, 72 * 3.0, 9), fontsize=9, color=palette.ink, parse_math=False)
        for text in axes.legend(fontsize=6.5, frameon=False, markerscale=3).get_texts():
            text.set_parse_math(False)
    _words(figure, title, note)
    return write_figure(figure, out)


@dataclass(frozen=True)
class Ground:
    """How many rows of a log are in each square of a maze: its corner, their width, and counts [across][along y]."""

    layout: "Layout"
    low: tuple[float, float]
    width: float
    counts: Sequence[Sequence[int]]


def grounds_figure(panels: Mapping[str, Ground], out: Path, title: str, note: str, columns: int = 2) -> Path:
    """Writes a PNG of mazes with the rows of logs in them as a grey density, a panel each.

    Args:
        panels: by heading.
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.
        columns: panels side by side.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from odaf.report import drawing
    from odaf.report.figures import write_figure
    from odaf.report.lettering import fitted

    figure, every = _grid(len(panels), columns, (3.3, 2.7))
    for axes, (heading, ground) in zip(every, panels.items(), strict=False):
        density = np.log1p(np.array(ground.counts, float)).T
        (left, low), (down, across) = ground.low, np.multiply(density.shape, ground.width)
        extent = (left, left + across, low, low + down)
        axes.imshow(density, origin="lower", extent=extent, cmap="Blues", interpolation="nearest", zorder=0.5)
        drawing.draw_maze(axes, drawing.LIGHT, ground.layout, None, None)
        axes.set_title(fitted(heading, 72 * 3.0, 9), fontsize=9, color=drawing.LIGHT.ink, parse_math=False)
    _words(figure, title, note)
    return write_figure(figure, out)


@dataclass(frozen=True)
class Paths:
    """Paths of a policy in a maze, perhaps over logged ones, and what is said of them."""

    layout: "Layout"
    learned: "Trajectories"
    logged: "Trajectories | None"
    said: str


def paths_figure(
    rows: Mapping[str, Sequence[Paths | None]], columns: Sequence[str], out: Path, title: str, note: str
) -> Path:
    """Writes a PNG of mazes with paths, a row for each policy and a column for each maze.

    Args:
        rows: by name of the policy, a panel for every column; None stays empty.
        columns: headings.
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from odaf.report import drawing
    from odaf.report.figures import write_figure
    from odaf.report.lettering import fitted

    figure, every = _grid(len(rows) * len(columns), len(columns), (2.1, 1.75))
    panels = [(name, place, panel) for name, row in rows.items() for place, panel in enumerate(row)]
    for axes, (name, place, panel) in zip(every, panels, strict=True):
        if panel is None:
            axes.set_axis_off()
            continue
        drawing.draw_maze(axes, drawing.LIGHT, panel.layout, panel.learned, panel.logged)
        heading = fitted(f"{name}\n{columns[place]}: {panel.said}", 72 * 2.0, 6.5)
        axes.set_title(heading, fontsize=6.5, color=drawing.LIGHT.ink, parse_math=False)
    _words(figure, title, note)
    return write_figure(figure, out)
