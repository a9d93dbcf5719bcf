"""The tables of scores on the page, column by column; a column without a single entry is left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from odaf.report.configuration import ABSENT
from odaf.report.drawing import plain_number
from odaf.report.records import RunRecord
from odaf.report.scores import Score, normalised

STATISTIC = (
    "The spread is everywhere the 95 % interval over seeds: Student's t over the seeds' mean returns. With two seeds "
    "it is wide, because two seeds tell little."
)
ONE_SEED = (
    "One seed has no such interval; ± is the standard deviation over its episodes, which says nothing of other seeds."
)


@dataclass(frozen=True)
class Column:
    """A column: its heading, one entry a row, and whether it holds words, which stand to the left."""

    heading: str
    cells: tuple[str, ...]
    text: bool = False

    @property
    def empty(self) -> bool:
        """Whether no row has an entry."""
        return all(cell in ("", ABSENT) for cell in self.cells)


def score_columns(scores: Sequence[Score], places: int) -> list[Column]:
    """What is said of each run, the mean return first; `places` digits after the point."""
    several = any(entry.interval for entry in scores)
    columns = [
        Column("mean return", tuple(figure(entry.mean, places) for entry in scores)),
        Column(
            "95 % interval over seeds" if several else "spread over episodes",
            tuple(_spread(entry, places, several) for entry in scores),
        ),
        Column("normalised score", tuple(normalised_cell(entry.normalised) for entry in scores)),
        Column("success", tuple(share(entry.success_rate) for entry in scores)),
        Column("stitched", tuple(share(entry.stitched_rate) for entry in scores)),
        Column("updates", tuple(count(entry.step) for entry in scores)),
        Column("updates/s", tuple(figure(entry.updates_per_second) for entry in scores)),
        Column("training", tuple(duration(entry.train_seconds) for entry in scores)),
        Column("seeds", tuple(_seeds(entry) for entry in scores)),
        Column("episodes", tuple(count(entry.episodes or None) for entry in scores)),
    ]
    return [column for place, column in enumerate(columns) if place == 0 or not column.empty]


def log_rows(run: RunRecord, name: str, columns: Sequence[Column], places: int) -> list[tuple[str, list[str]]]:
    """The best and the mean of the log, under the columns that speak of returns; without what the run does not tell."""
    rows = []
    for which, value in (("best episode", run.data_best), ("mean", run.data_mean)):
        if value is not None:
            known = {
                "mean return": figure(value, places),
                "normalised score": normalised_cell(normalised(run.data_environment_id, value)),
            }
            rows.append((f"{name}, {which}", [known.get(column.heading, "") for column in columns]))
    return rows


def seed_columns(runs: Sequence[RunRecord], places: int) -> list[Column]:
    """The same seed by seed; here the spread over a seed's own episodes is the only one there is."""
    seeds = [(run, seed) for run in runs for seed in run.seeds]
    found = [seed.evaluation for _, seed in seeds]
    scored = [
        normalised_cell(normalised(run.evaluation_environment_id, seed.evaluation and seed.evaluation.mean))
        for run, seed in seeds
    ]
    columns = [
        Column("seed", tuple(str(seed.seed) for _, seed in seeds)),
        Column("mean return", tuple(figure(one and one.mean, places) for one in found)),
        Column("normalised score", tuple(scored)),
        Column("spread over episodes", tuple(f"± {figure(one.std, places)}" if one else ABSENT for one in found)),
        Column("episodes", tuple(count(one.episodes if one else None) for one in found)),
        Column("success", tuple(share(one and one.success_rate) for one in found)),
        Column("stitched", tuple(share(one and one.stitched_rate) for one in found)),
        Column("updates", tuple(count(seed.step) for _, seed in seeds)),
        Column("status", tuple(seed.status for _, seed in seeds), text=True),
    ]
    return [column for column in columns if not column.empty]


def note_of(entry: Score) -> str:
    """What stands in small print under a run's name."""
    directory = "" if entry.label in (entry.directory, f"({entry.directory})") else entry.directory
    directory = "" if entry.label.endswith(f"({directory})") else directory
    return " · ".join(
        part for part in (directory, "" if entry.status == "finished" else entry.status, entry.simulator) if part
    )


def statistic(scores: Sequence[Score]) -> str:
    """What the spread of the table is."""
    kinds = {entry.interval is not None for entry in scores if entry.mean is not None}
    return " ".join(text for text, needed in ((STATISTIC, True), (ONE_SEED, False)) if needed in kinds)


def normalised_cell(score: Mapping[str, Any] | None) -> str:
    """A normalised score with the version of its environment in small print."""
    if not score:
        return ABSENT
    return Markup("{} <small>{}</small>").format(figure(score["normalised_score"], 1), score["environment"])


def _spread(entry: Score, places: int, several: bool) -> str:
    if entry.interval is not None:
        return f"{figure(entry.interval[0], places)} to {figure(entry.interval[1], places)}"
    if entry.std is None:
        return ABSENT
    return f"± {figure(entry.std, places)}{' over episodes, one seed' if several else ''}"


def _seeds(entry: Score) -> str:
    return f"{entry.evaluated} of {entry.seeds}" if entry.evaluated != entry.seeds else str(entry.seeds)


def figure(value: int | float | None, places: int | None = None) -> str:
    """A number for a table; a dash for none."""
    if value is None:
        return ABSENT
    return plain_number(value) if places is None else f"{value:,.{places}f}"


def count(value: int | float | None) -> str:
    """A whole number with separators; a dash for none."""
    return ABSENT if value is None else f"{round(value):,}"


def share(value: int | float | None) -> str:
    """A rate in percent; a dash for none."""
    return ABSENT if value is None else f"{100 * value:.0f} %"


def duration(seconds: int | float | None) -> str:
    """Seconds as a person says them."""
    if seconds is None:
        return ABSENT
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
