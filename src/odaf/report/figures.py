"""Picture files for READMEs and result pages; the report draws the same things on its page."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from odaf.data.writing import write_atomically
from odaf.errors import ConfigError
from odaf.report.extras import check_extra
from odaf.report.names import names_of
from odaf.report.quantities import Curve
from odaf.report.records import RunRecord, find_runs, read_run
from odaf.report.scores import score
from odaf.runs.evaluate_attacks import AttackCurve

RESOLUTION = 180  # dots per inch


def maze_figure(
    run_directories: Sequence[Path], out: Path, names: Sequence[str] | None = None, title: str | None = None
) -> Path:
    """Writes a PNG with one maze a run, side by side: logged paths in grey, the last checkpoint's paths on top.

    Args:
        run_directories: runs in a maze with recorded evaluations, in the order of the panels.
        out: the file to write; its folder is made when missing.
        names: panel headings; `None` takes the methods' names.
        title: written above the panels.

    Returns:
        `out`.

    Raises:
        ConfigError: a run is not in a maze or kept no evaluation episodes, or the `report` extra is not installed.
    """
    check_extra()
    from matplotlib.figure import Figure

    from odaf.report import drawing, paths
    from odaf.report.layout import maze_layout
    from odaf.report.lettering import fitted

    runs = [read_run(directory) for directory in find_runs(run_directories)]
    headings = list(names) if names is not None else names_of(runs)
    if len(headings) != len(runs):
        raise ConfigError(f"maze_figure: {len(headings)} names for {len(runs)} runs; give one name a run")
    width = 3.6 * len(runs)
    headings = [fitted(heading, 72 * 3.4, 11, bold=True) for heading in headings]
    legend = fitted(_maze_legend(runs), 72 * (width - 0.2), 8)
    title = title and fitted(title, 72 * (width - 0.2), 12)
    more = 0.24 * max(heading.count("\n") for heading in headings) + 0.14 * legend.count("\n")
    more += 0.0 if not title else 0.3 + 0.21 * title.count("\n")
    figure = Figure(figsize=(width, 2.75 + more), layout="constrained", facecolor="white")
    figure.supxlabel(legend, fontsize=8, color=drawing.LIGHT.muted, parse_math=False)
    for place, (run, heading) in enumerate(zip(runs, headings, strict=True)):
        layout, learned = maze_layout(run.environment), paths.learned_paths(run)
        if layout is None or learned is None:
            what = "its data name no maze" if layout is None else "it kept no evaluation episodes"
            raise ConfigError(f"{run.directory}: no paths to draw, {what}; train it with an evaluation in a maze")
        axes = figure.add_subplot(1, len(runs), place + 1)
        drawing.draw_maze(
            axes, drawing.LIGHT, layout, paths.thinned(learned), paths.logged_paths(run), paths.best_path(run)
        )
        axes.set_anchor("S")  # what is left over of the height is above, where headings are
        entry = score(run, heading)
        under = f"mean return {drawing.plain_number(entry.mean)}" if entry.mean is not None else ""
        if learned.good is not None:
            rate = entry.stitched_rate if learned.doing == "stitch" else entry.success_rate
            under += "" if rate is None else f"{', ' if under else ''}{100 * rate:.0f} % {learned.doing}"
        axes.set_title(heading, fontsize=11, fontweight="bold", color=drawing.LIGHT.ink, parse_math=False)
        axes.text(
            0.5, -0.03, under, transform=axes.transAxes, ha="center", va="top", fontsize=9, color=drawing.LIGHT.muted
        )
    if title:
        figure.suptitle(title, fontsize=12, parse_math=False)
    return write_figure(figure, out)


def learning_curves_figure(
    curves: Sequence[Curve],
    out: Path,
    references: Sequence[tuple[str, float]] = (),
    title: str | None = None,
    note: str | None = None,
) -> Path:
    """Writes a PNG of mean return over updates, a line a method with the 95 % interval over its seeds.

    Args:
        curves: as `run_curves` gives them, or made from other records of scores.
        out: the file to write; its folder is made when missing.
        references: names and heights of horizontal lines, for example ("best logged", 72.6).
        title: written above.
        note: written below in small print, for example where the data came from.

    Returns:
        `out`.

    Raises:
        ConfigError: there are no curves, or the `report` extra is not installed.
    """
    check_extra()
    if not curves:
        raise ConfigError(
            "learning_curves_figure: no curves; train with an evaluation, so that there is a return to draw"
        )
    figure = _curves(curves, references, title, note)
    return write_figure(figure, out)


def _curves(
    curves: Sequence[Curve], references: Sequence[tuple[str, float]], title: str | None, note: str | None
) -> Any:
    """The figure of `learning_curves_figure`: as many names side by side as fit, and taller where they are many."""
    from matplotlib.figure import Figure

    from odaf.report import drawing
    from odaf.report.lettering import fitted, width_of

    room, handle = 72 * 6.2, 50.0  # points across, and those of a line of the legend before its name
    names = [fitted(curve.label, room - handle, 8.5) for curve in curves]
    longest = max(width_of(line, 8.5) for name in names for line in name.split("\n"))
    columns = max(min(len(curves), 3, int(room // (longest + handle))), 1)
    lines = max(name.count("\n") + 1 for name in names) * -(-len(curves) // columns)
    figure = Figure(figsize=(6.4, 4.0 + 0.18 * (lines - 1)), layout="constrained", facecolor="white")
    axes = figure.add_subplot()
    drawing.draw_curves(axes, drawing.LIGHT, curves, references)
    axes.set_ylabel("mean return", fontsize=8)
    handles, _ = axes.get_legend_handles_labels()
    legend = figure.legend(
        handles, names, loc="outside upper left", ncols=columns, frameon=False, fontsize=8.5, handlelength=3
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    if title:
        # Below the legend; a figure's own title would lie on it.
        axes.set_title(fitted(title, 72 * 5.4, 12), fontsize=12, parse_math=False)
    if note:
        figure.supxlabel(fitted(note, room, 7.5), fontsize=7.5, color=drawing.LIGHT.muted, parse_math=False)
    figure.draw_without_rendering()  # the axes gets its size, by which its lines are named
    figure.set_layout_engine("none")
    drawing.name_lines(axes, drawing.LIGHT, references)
    return figure


def check_attack_figure(out: Path) -> None:
    """Passes where `attack_figure` can write `out`, so that nothing is measured in vain.

    Raises:
        ConfigError: the name does not end in .svg or .png, or the `report` extra is not installed.
    """
    if Path(out).suffix not in (".svg", ".png"):
        raise ConfigError(f"{out}: a picture is written as SVG or PNG; let the name end in .svg or .png")
    check_extra()


def attack_figure(curve: AttackCurve, out: Path, name: str) -> Path:
    """Writes an SVG or PNG of return against budget: the mean over seeds, its 95 % interval, and each of them.

    Args:
        curve: what was measured; drawn as normalised scores where the environment has reference returns.
        out: the file to write, by its ending; its folder is made when missing.
        name: whose curve it is.

    Returns:
        `out`.

    Raises:
        ConfigError: as `check_attack_figure`.
    """
    check_attack_figure(out)
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    from odaf.environments.reference_returns import reference_of
    from odaf.report import drawing
    from odaf.report.lettering import fitted

    reference = None if curve.environment is None else reference_of(curve.environment)
    values = np.array([[score.mean_return for score in scores.by_seed] for scores in curve.scores]).T
    if reference is not None:
        values = np.vectorize(reference.normalise)(values)
    figure = Figure(figsize=(6.4, 4.0), layout="constrained", facecolor="white")
    axes = figure.add_subplot()
    drawing.draw_curves(axes, drawing.LIGHT, [Curve(name, np.array(curve.budgets), values, None, 0)])
    axes.xaxis.set_major_locator(MaxNLocator(nbins=7))
    axes.set_xlabel("largest offset of an observation, in standard deviations of the log", fontsize=8)
    axes.set_ylabel("mean return" if reference is None else f"normalised score, {curve.environment}", fontsize=8)
    axes.set_title(fitted(f"{name} under {curve.attack}", 72 * 5.4, 12), fontsize=12, parse_math=False)
    return write_figure(figure, out)


def estimates_figure(
    panels: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], out: Path, title: str
) -> Path:
    """Writes a PNG of estimates with their intervals over true values, a panel each; on the line both are equal.

    Args:
        panels: by heading, true values, estimates, and the lower and upper ends of their intervals.
        out: the file to write; its folder is made when missing.
        title: written above the panels.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from matplotlib.figure import Figure

    from odaf.report import drawing

    palette = drawing.LIGHT
    figure = Figure(figsize=(3.2 * len(panels), 3.3), layout="constrained", facecolor="white")
    for place, (heading, (truth, values, low, high)) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), place + 1)
        drawing.style_axes(axes, palette, "both")
        axes.axline((float(truth.min()), float(truth.min())), slope=1.0, color=palette.muted, linewidth=0.8)
        reach = np.nan_to_num(np.stack([values - low, high - values]))
        axes.errorbar(
            truth, values, yerr=reach, fmt="o", markersize=3.5, linewidth=0.8, color=palette.method(0), alpha=0.7
        )
        axes.set_title(heading, fontsize=10, color=palette.ink, parse_math=False)
        axes.set_xlabel("true value", fontsize=8)
        axes.set_ylabel("estimate" if place == 0 else "", fontsize=8)
    figure.suptitle(title, fontsize=11, parse_math=False)
    return write_figure(figure, out)


def grid_figure(
    rows: Sequence[str], columns: Sequence[str], values: np.ndarray, out: Path, title: str, note: str
) -> Path:
    """Writes a PNG of a table of scores in which a high one is dark; a cell without a finite one stays empty.

    Args:
        rows: their names.
        columns: their names.
        values: normalised scores, of shape (rows, columns).
        out: the file to write; its folder is made when missing.
        title: written above.
        note: written below in small print.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from matplotlib.figure import Figure

    from odaf.report import drawing
    from odaf.report.lettering import fitted

    palette = drawing.LIGHT
    figure = Figure(
        figsize=(2.2 + 0.75 * len(columns), 1.9 + 0.27 * len(rows)), layout="constrained", facecolor="white"
    )
    axes = figure.add_subplot()
    shades = axes.imshow(values, cmap="Blues", vmin=0.0, vmax=120.0, aspect="auto")
    for row, column in np.argwhere(np.isfinite(values)):
        score = values[row, column]
        colour = palette.surface if score > 70.0 else palette.ink
        axes.text(column, row, f"{score:.0f}", ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(columns)), labels=columns, rotation=35, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), labels=rows, fontsize=8)
    for text in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        text.set_parse_math(False)
        text.set_color(palette.ink)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    figure.colorbar(shades, ax=axes, shrink=0.8).ax.tick_params(labelsize=7)
    axes.set_title(title, fontsize=11, color=palette.ink, parse_math=False)
    room = 72 * (figure.get_figwidth() - 0.3)
    figure.supxlabel(fitted(note, room, 7.5), fontsize=7.5, color=palette.muted, parse_math=False)
    return write_figure(figure, out)


def theory_figure(
    sizes: Sequence[int],
    curves: Mapping[str, Sequence[float]],
    heading: str,
    rows: Sequence[str],
    paths: Mapping[str, Sequence[tuple[int, int]]],
    out: Path,
) -> Path:
    """Writes a PNG of errors and bounds over the size of a log, and beside it a grid with the paths of policies.

    Args:
        sizes: rows of the logs.
        curves: by name, a positive number for each size.
        heading: written above these.
        rows: the grid's map; `#` is no cell, and other signs than `.` are written into theirs.
        paths: by the name of the actions that the policy may take, the cells (row, column) that it visits.
        out: the file to write; its folder is made when missing.

    Returns:
        `out`.

    Raises:
        ConfigError: the `report` extra is not installed.
    """
    check_extra()
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    from odaf.report import drawing

    palette = drawing.LIGHT
    figure = Figure(figsize=(8.6, 3.5), layout="constrained", facecolor="white")
    errors, grid = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    drawing.style_axes(errors, palette, "both")
    for number, (name, values) in enumerate(curves.items()):
        errors.loglog(
            sizes,
            values,
            marker="o",
            markersize=3,
            color=palette.method(number),
            linestyle=drawing.DASHES[number],
            label=name,
        )
    errors.tick_params(which="minor", length=0)
    errors.set_xlabel("rows of the log, N", fontsize=8)
    errors.set_title(heading, fontsize=10, color=palette.ink, parse_math=False)
    errors.legend(fontsize=7.5, frameon=False)

    for row, line in enumerate(rows):
        for column, sign in enumerate(line):
            if sign != "#":
                colour = palette.wall if sign == "X" else palette.surface
                grid.add_patch(
                    Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=colour, edgecolor=palette.grid, linewidth=0.8)
                )
            if sign in "SGX":
                grid.text(column - 0.42, row - 0.26, sign, fontsize=8, color=palette.ink)
    for number, (name, cells) in enumerate(paths.items()):
        down, right = np.array(cells, float).T + 0.12 * (number - 1)
        label = f"{name}: {len(cells) - 1} moves"
        grid.plot(
            right, down, color=palette.method(number), linestyle=drawing.DASHES[number], linewidth=1.8, label=label
        )
        grid.plot(right[-1], down[-1], "o", color=palette.method(number), markersize=4)
    grid.set_aspect("equal")
    grid.invert_yaxis()
    grid.axis("off")
    grid.set_title("Paths beside a cell outside the data (X)", fontsize=10, color=palette.ink)
    grid.legend(fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, columnspacing=1.0)
    return write_figure(figure, out)


def run_curves(run_directories: Sequence[Path]) -> tuple[list[Curve], list[tuple[str, float]]]:
    """Return curves of runs, and the logged best and mean as reference lines, for `learning_curves_figure`."""
    check_extra()
    from odaf.report import charts

    runs = [read_run(directory) for directory in find_runs(run_directories)]
    return charts.return_curves(runs, names_of(runs)), charts.references(runs)


def _maze_legend(runs: Sequence[RunRecord]) -> str:
    from odaf.report import paths

    good = paths.good_key(runs).replace(": at G without the detour", "")
    parts = ["grey: logged episodes", "dotted: the best of them", f"green: {good}", "purple, dashed: does not"]
    return " · ".join(parts + sorted({run.origin for run in runs if run.origin}))


def write_figure(figure: Any, out: Path) -> Path:
    """By the ending of the name, SVG or PNG; equal figures give equal bytes."""
    import matplotlib

    out = Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    kind, nothing = ("svg", "Date") if out.suffix == ".svg" else ("png", "Software")
    save = functools.partial(figure.savefig, format=kind, dpi=RESOLUTION, metadata={nothing: None})
    with matplotlib.rc_context({"svg.hashsalt": out.name, "svg.fonttype": "none"}):
        write_atomically(out, save)
    return out
