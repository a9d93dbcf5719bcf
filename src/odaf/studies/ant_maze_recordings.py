"""The ant mazes' part of the generators' study: do their ants reach their goals, on their feet, everywhere?"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies.ant_maze_logs import AntMazeLog
from odaf.studies.job import Record, Work
from odaf.studies.logs import LOCAL

if TYPE_CHECKING:
    from odaf.data import Dataset
    from odaf.training.progress import ProgressReport

TRANSITIONS = 100_000
SEED = 0
METRES = 1.0  # width of the squares in which rows are counted


@dataclass(frozen=True)
class AntMazeRecording(Work):
    """One set recorded, with its figures and where its rows are.

    Attributes:
        set_name: as in `antmaze-medium-play`.
        transitions: rows.
        seed: of starts, goals and actions.
    """

    set_name: str
    transitions: int = TRANSITIONS
    seed: int = SEED

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"task": ("antmaze",), "set": (self.set_name,)}

    def identity(self) -> dict[str, Any]:
        return {"version": 1, **AntMazeLog(self.set_name, self.transitions, self.seed).recipe()}

    def said(self, record: Record) -> str:
        verdict = {True: "accepted", False: "not accepted", None: "unknown"}[record["acceptance"]["passed"]]
        return f"{verdict}, {record['transitions_per_second']:,.0f} transitions/s"

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.data import fingerprint
        from odaf.environments.ant_maze_data import generate

        began, used = time.monotonic(), time.process_time()
        dataset = generate(self.set_name, self.transitions, self.seed, progress=progress)
        seconds, processor_seconds = time.monotonic() - began, time.process_time() - used
        return {
            "origin": LOCAL,
            "same_set": AntMazeLog(self.set_name, self.transitions, self.seed).command,
            "identity": self.identity(),
            **fingerprint.record(dataset),
            "seconds": seconds,
            "processor_seconds": processor_seconds,
            "transitions_per_second": self.transitions / seconds,
            **{key: dataset.provenance[key] for key in ("name", "seed", "environment", "goal", "policies", "versions")},
            **{key: dataset.provenance[key] for key in ("statistics", "acceptance", "findings")},
            "coverage": coverage(dataset),
        }


def coverage(dataset: "Dataset") -> dict[str, Any]:
    """How many rows are in each square of the maze: [across][down] from its upper left corner, "low", in metres."""
    import numpy as np

    from odaf.environments.ant_maze_map import CELL, map_of

    maze = map_of(dataset.environment or {})
    assert maze is not None
    low = np.subtract(maze.centre((1, 1)), CELL / 2)
    size = CELL * np.array([len(maze.rows[0]) - 2, len(maze.rows) - 2])
    squares = np.round(size / METRES).astype(int)
    counts, _, _ = np.histogram2d(
        *dataset.observations[:, :2].T, bins=squares.tolist(), range=list(zip(low, low + size, strict=True))
    )
    return {"low": low.tolist(), "metres": METRES, "rows": counts.astype(int).tolist()}


def of_mazes(records: Sequence[Record]) -> list[Record]:
    """Those of the ant mazes, in the order of their names."""
    from odaf.environments.ant_maze_sets import NAMES

    found = {record["name"]: record for record in records}
    return [found[name] for name in NAMES if name in found]


def table(records: Sequence[Record]) -> list[str]:
    """Lines of Markdown: a row a set; none where there are no records."""
    mazes = of_mazes(records)
    if not mazes:
        return []
    lines = [
        "",
        "Ants in mazes, led by our own walker: the share of walks that reach a goal, their own or that of evaluation,",
        "the share that end on their back, and how many end at the goal of evaluation.",
        "",
        "| set | rows | whole walks | reach a goal | steps there | on their back | at the goal of evaluation "
        "| cells visited | shortest walk | accepted | transitions/s | by processor time |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
        *map(_row, mazes),
    ]
    missed = [record for record in mazes if record["acceptance"]["passed"] is not True]
    if missed:
        lines += ["", "Not accepted, check by check:", ""]
        lines += [f"- `{record['name']}`: {finding['message']}" for record in missed for finding in record["findings"]]
    return lines


def _row(record: Record) -> str:
    figures = record["statistics"]
    passed = {True: "yes", False: "no", None: "unknown"}[record["acceptance"]["passed"]]
    head = f"| {record['name']} | {figures['transitions']:,} | {figures['whole_walks']:,} "
    seen = f"{figures['visited_share']:.0%}"
    speeds = f"{record['transitions_per_second']:,.0f} | {figures['transitions'] / record['processor_seconds']:,.0f} |"
    if not figures["whole_walks"]:
        return f"{head}| | | | | {seen} | | {passed} | {speeds}"
    steps = f"{figures['steps_to_goal']:.0f}" if "steps_to_goal" in figures else ""
    ends = f"{figures['reached_share']:.0%} | {steps} | {figures['flipped_share']:.0%} | {figures['goal_walks']:,}"
    return f"{head}| {ends} | {seen} | {figures['shortest_walk']} | {passed} | {speeds}"


def figure(records: Sequence[Record], out: Path) -> None:
    """Where the rows of each set are, over its maze, drawn to `out`."""
    from odaf.report.layout import maze_layout
    from odaf.report.study_figures import Ground, grounds_figure

    panels = {}
    for record in of_mazes(records):
        layout, found = maze_layout(record["environment"]), record["coverage"]
        assert layout is not None
        panels[f"{record['name']}, {record['statistics']['transitions']:,} rows"] = Ground(
            layout, tuple(found["low"]), found["metres"], found["rows"]
        )
    if panels:
        note = f"{LOCAL}; darker where more rows are, on a logarithmic scale"
        grounds_figure(panels, out, "Where ants have been", note)
