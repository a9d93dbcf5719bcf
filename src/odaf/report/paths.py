"""Paths through a maze: logged ones, the best logged one, and those of the learned policy."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odaf.report import drawing
from odaf.report.chart import NARROW, Chart, chart_svg
from odaf.report.layout import Layout, maze_layout
from odaf.report.quantities import FLAGS, Trajectories
from odaf.report.records import RunRecord
from odaf.report.svg import THEMED

MAX_PATHS = 60
_KEYS = {"stitch": "stitches: at G without the detour", "reach the goal": "reaches the goal"}


def maze_charts(runs: Sequence[RunRecord], labels: Sequence[str]) -> list[Chart]:
    """One maze a run: logged paths in grey, the last checkpoint's paths on top. Empty where no run has both."""
    charts = []
    for index, (run, label) in enumerate(zip(runs, labels, strict=True)):
        layout, learned = maze_layout(run.environment), learned_paths(run)
        if layout is None or learned is None:
            continue
        svg = chart_svg(
            f"maze-{index}",
            f"Paths of {label} in the maze {layout.name}",
            (NARROW, NARROW * layout.aspect),
            lambda axes, layout=layout, run=run, learned=learned: drawing.draw_maze(
                axes, THEMED, layout, thinned(learned), logged_paths(run), best_path(run)
            ),
            margins=(0, 0, 0, 0),
        )
        charts.append(Chart(label, svg, _paths_caption(learned, layout)))
    return charts


def good_key(runs: Sequence[RunRecord]) -> str:
    """What paths in the colour of the good ones do, for a legend."""
    found = [learned_paths(run) for run in runs if maze_layout(run.environment) is not None]
    return ", or ".join(dict.fromkeys(_KEYS[paths.doing] for paths in found if paths is not None))


def _paths_caption(learned: Trajectories, layout: Layout) -> str:
    count = len(learned.positions)
    shown = f"{count} episodes" if count <= MAX_PATHS else f"{count} episodes, {MAX_PATHS} of them drawn"
    goals = " Each has a goal of its own within the ring." if layout.hidden and layout.goal is not None else ""
    if learned.good is None:
        return f"{shown}; the environment does not tell which ones {learned.doing}.{goals}"
    drawn = "" if count <= MAX_PATHS else f"; {MAX_PATHS} drawn"
    return f"{int(np.sum(learned.good))} of {count} {learned.doing}{drawn}.{goals}"


def learned_paths(run: RunRecord) -> Trajectories | None:
    """Positions of the last recorded evaluation of every seed, or `None` where none was recorded."""
    recorded = [seed.episodes[1] for seed in run.seeds if seed.episodes is not None]
    recorded = [arrays for arrays in recorded if _plane(arrays.get("observations"))]
    if not recorded:
        return None
    positions = stacked([arrays["observations"][:, :, :2] for arrays in recorded])
    for flag, doing in FLAGS.items():
        if all(flag in arrays for arrays in recorded):
            good = np.concatenate([np.asarray(arrays[flag], bool) for arrays in recorded])
            return Trajectories(positions, good, doing)
    return Trajectories(positions)


def logged_paths(run: RunRecord) -> Trajectories | None:
    """Positions of the sample of logged episodes."""
    observations = run.sample.get("observations")
    return Trajectories(np.asarray(observations)[:, :, :2]) if _plane(observations) else None


def best_path(run: RunRecord) -> np.ndarray | None:
    """[time, 2] positions of the best logged episode."""
    observations = run.sample.get("best_observations")
    return None if observations is None or observations.ndim != 2 or observations.shape[1] < 2 else observations[:, :2]


def _plane(observations: np.ndarray | None) -> bool:
    return observations is not None and observations.ndim == 3 and observations.shape[2] >= 2 and len(observations) > 0


def stacked(paths: Sequence[np.ndarray]) -> np.ndarray:
    """[episodes, time, 2] float64 of sets of paths; those that end sooner are filled up with NaN."""
    longest = max(path.shape[1] for path in paths)
    padded = [
        np.pad(path.astype(np.float64), ((0, 0), (0, longest - path.shape[1]), (0, 0)), constant_values=np.nan)
        for path in paths
    ]
    return np.concatenate(padded)


def thinned(paths: Trajectories) -> Trajectories:
    """At most `MAX_PATHS` of them, evenly from all seeds."""
    if len(paths.positions) <= MAX_PATHS:
        return paths
    chosen = np.unique(np.linspace(0, len(paths.positions) - 1, MAX_PATHS).astype(int))
    return replace(paths, positions=paths.positions[chosen], good=None if paths.good is None else paths.good[chosen])
