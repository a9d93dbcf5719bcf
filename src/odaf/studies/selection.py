"""The selection study: what a choice without a simulator is worth, beside a random pick and a few tries in one.

On each of three logs TD3+BC is trained with nine weights of the value against cloning, on four fifths of the episodes.
Estimates from the other fifth choose one of the nine; what each earns in the simulator says how good the choice is.
"""

import itertools
import json
import math
import time
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.estimator_scores import Estimated, score
from odaf.studies.identity import by_name, todays_learner
from odaf.studies.job import PRINTS, DataEntries, Job, Log, Phase, Record, Study, Work, prints_of
from odaf.studies.logs import LOCAL, RecordedLog
from odaf.studies.recorded_estimates import LIKENESS, intervals
from odaf.studies.tables import grouped
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.training.progress import ProgressReport

SETS = ("hopper-medium", "halfcheetah-medium", "walker2d-medium")
PRESET, FIELD = "td3-bc", "value_weight"
GRID = (0.25, 1.0, 2.5, 5.0, 10.0, 20.0, 40.0, 100.0, 400.0)
ROWS, LOG_SEED, SPLIT_SEED, HOLDOUT = 100_000, 3, 0, 0.2
STEPS = 30_000
EVALUATION = Evaluation(every=10_000, episodes=20)
HORIZON = 1_000
CHOOSES = "fqe"  # the estimator of "chosen"; the table has the others
COMPARED = ("fqe, calibrated", "shrunk", LIKENESS)  # with true values
FIGURES = ("spearman", "mean_absolute_error", "coverage", "width")
TRIES = 3  # in the simulator, of "best_of_three"
VERSION = 3


@dataclass(frozen=True)
class PartOfLog(RecordedLog):
    """The episodes of a recorded set that are learnt from, or those that are held out.

    Attributes:
        part: "train" or "holdout".
    """

    part: str = "train"

    @property
    def name(self) -> str:
        return f"{self.set_name}-{self.part}"

    def recipe(self) -> dict[str, Any]:
        return {**super().recipe(), "part": self.part, "holdout": HOLDOUT, "split_seed": SPLIT_SEED}

    def make(self, path: Path) -> None:
        from odaf.environments.locomotion_data import generate

        whole = generate(self.set_name, self.transitions, self.seed, edition=self.edition)
        train, holdout = whole.split(HOLDOUT, SPLIT_SEED)
        (train if self.part == "train" else holdout).save(path)


def training(set_name: str, weight: float, rows: int = ROWS, steps: int = STEPS) -> Training:
    """One of the grid."""
    task = Task(PartOfLog(set_name, rows, LOG_SEED), EVALUATION, score="normalised_score")
    return Training(PRESET, task, 0, steps, ((FIELD, weight),))


@dataclass(frozen=True)
class Choosing(Work):
    """Estimates of all policies of a grid, from the hold-out.

    Attributes:
        grid: the trainings, all on the same log.
        holdout: what estimates are made from.
        horizon: steps of an episode that are counted.
        changes: settings of the estimates other than the defaults.
    """

    grid: tuple[Training, ...]
    holdout: PartOfLog
    horizon: int = HORIZON
    changes: tuple[tuple[str, Any], ...] = ()

    @property
    def log(self) -> Log:
        return self.holdout

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"task": (self.grid[0].task.name,)}

    def likeness(self) -> tuple[Hashable, ...]:
        return (type(self).__name__,)

    def guess(self) -> float:
        return 600.0

    def identity(self) -> dict[str, Any]:
        from odaf.algorithms import config
        from odaf.estimation import EstimateSettings
        from odaf.training.files import plain

        return {
            "version": VERSION,
            "settings": plain(asdict(EstimateSettings(**dict(self.changes)))),
            "horizon": self.horizon,
            "data": {"print": "known", **self.holdout.recipe()},
            "train": self.grid[0].log.recipe(),
            "learner": by_name(config.to_dict(self.grid[0].learner())),
            "grid": [dict(each.changes)[FIELD] for each in self.grid],
            "steps": self.grid[0].steps,
        }

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        prints, entry = prints_of(record["data"]), data.get(self.holdout.name, {"recipe": {}, "sha256": []})
        known = "known" if set(prints) & set(entry["sha256"]) else f"{prints[0][:8]}, not in data.json"
        learner = todays_learner(record["identity"]["learner"])
        return {**record["identity"], "learner": learner, "data": {"print": known, **entry["recipe"]}}

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.data import fingerprint
        from odaf.data.dataset import Dataset
        from odaf.estimation import estimate_many

        begun = time.monotonic()
        policies = [each.trained(place, progress).policy(each.seed) for each in self.grid]
        dataset = Dataset.load(self.holdout.present(place))
        progress.start(f"estimates, {self.holdout.name}", 1_000, unit="thousandths")
        found = estimate_many(
            policies,
            dataset,
            horizon=self.horizon,
            progress=lambda done, total: progress.advance(1_000 * done // total),
            **dict(self.changes),
        )
        progress.close()
        prints = fingerprint.record(dataset)
        return {
            "kind": "choice",
            "task": self.grid[0].task.name,
            "data": {"origin": LOCAL, **{kind: prints[kind] for kind in PRINTS if kind in prints}},
            "identity": {name: value for name, value in self.identity().items() if name != "data"},
            "estimates": {
                each.method: valuation[0].to_dict() for each, valuation in zip(self.grid, found, strict=True)
            },
            "seconds": time.monotonic() - begun,
        }


def plan() -> list[Phase]:
    """A phase a set: its grid, then the choice."""
    phases = []
    for set_name in SETS:
        grid = tuple(training(set_name, weight) for weight in GRID)
        holdout = PartOfLog(set_name, ROWS, LOG_SEED, part="holdout")
        jobs = [Job(each.name, each) for each in grid]
        jobs.append(Job(f"{set_name}-choice", Choosing(grid, holdout), tuple(each.name for each in grid)))
        phases.append(Phase(set_name, tuple(jobs)))
    return phases


# ---- what records say -----------------------------------------------------------------------------------------------


def expected_best(scores: Sequence[float], tries: int) -> float:
    """The expected highest score of so many of them, drawn without replacement."""
    best = [max(drawn) for drawn in itertools.combinations(scores, min(tries, len(scores)))]
    return sum(best) / len(best)


def chosen_by(estimates: Mapping[str, Any], method: str) -> str | None:
    """The policy that `odaf select` would choose by this estimator."""

    def place(name: str) -> tuple[bool, float]:
        each = next(each for each in estimates[name]["estimates"] if each["method"] == method)
        low = None if each["difference"] is None else each["difference"]["low"]
        return each["verdict"] != "refused", -math.inf if low is None else float(low)

    best = max(estimates, key=place)
    return best if math.isfinite(place(best)[1]) else None


def figures(records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """For each set whose grid is whole and judged, the normalised scores of every way to choose."""
    found: dict[str, dict[str, Any]] = {}
    for task, group in grouped(records, lambda record: record["task"]).items():
        choice = next((record for record in group if record.get("kind") == "choice"), None)
        trained = {record["method"]: record for record in group if record.get("kind") != "choice"}
        if choice is None or set(trained) != set(choice["estimates"]):
            continue
        # A diverged run has no policy to try; it counts as the worst of the others.
        finals = {name: record["final"] for name, record in trained.items()}
        known = [final["normalised_score"] for final in finals.values() if final is not None]
        scores = {name: min(known) if final is None else final["normalised_score"] for name, final in finals.items()}
        methods = [each["method"] for each in next(iter(choice["estimates"].values()))["estimates"]]
        names = {method: chosen_by(choice["estimates"], method) for method in methods}
        by_method = {method: None if name is None else scores[name] for method, name in names.items()}
        ordered = sorted(scores.values())
        found[task] = {
            "random": sum(ordered) / len(ordered),
            "chosen": by_method[CHOOSES],
            "best_of_three": expected_best(ordered, TRIES),
            "oracle": ordered[-1],
            "worst": ordered[0],
            "by_estimator": {method: score for method, score in by_method.items() if score is not None},
            "log": next(iter(trained.values()))["data"]["normalised_score"],
            "beside_true_values": beside_true_values(choice, finals),
        }
    return found


def beside_true_values(choice: Record, finals: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Figures of estimators (`odaf.studies.estimator_scores`) on the policies of a grid, which the simulator tried."""
    members = choice["identity"]["settings"]["members"]
    said = {name: intervals(choice["estimates"][name], members) for name, final in finals.items() if final is not None}
    truth = np.array([finals[name]["mean_return"] for name in said])
    found = {}
    for estimator in COMPARED:
        values, low, high = np.array([each[estimator] for each in said.values()]).T
        figures = asdict(score([Estimated(values, low, high, truth)]))
        found[estimator] = {name: value for name, value in figures.items() if not math.isnan(value)}
    return found


def summary(records: Sequence[Record]) -> str:
    """JSON: for each set the normalised scores of every way to choose."""
    return json.dumps(figures(records), indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: a row a set, then the scores of every policy of the grids."""
    found = figures(records)
    lines = [
        f"Normalised scores on {LOCAL}, 0 for a random policy and 100 for an expert:",
        f"one of {len(GRID)} settings of `{PRESET}` ({FIELD} {GRID[0]:g} to {GRID[-1]:g}, {STEPS:,} updates,",
        "one seed) chosen in different ways. `random` is the mean of all, `best of three` the expected best of three",
        f"tried in the simulator, `chosen` the one that `odaf select` takes by {CHOOSES} on a hold-out of",
        f"{HOLDOUT:.0%} of the episodes, without a simulator; the other estimators stand behind it. `half way` says",
        "whether it is at least half way from random to best of three. Made by `odaf reproduce selection` from the",
        "records in this folder.",
        "",
        "| log | log's mean | worst | random | chosen | best of three | oracle | half way | by the others |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for task, each in found.items():
        middle = (each["random"] + each["best_of_three"]) / 2
        others = ", ".join(f"{name} {score:.1f}" for name, score in each["by_estimator"].items() if name != CHOOSES)
        chosen = "-" if each["chosen"] is None else f"{each['chosen']:.1f}"
        reached = "yes" if each["chosen"] is not None and each["chosen"] >= middle else "no"
        cells = [f"{each[name]:.1f}" for name in ("log", "worst", "random")]
        cells += [chosen, f"{each['best_of_three']:.1f}", f"{each['oracle']:.1f}", reached, others]
        lines.append(f"| {task.removesuffix('-train')} | {' | '.join(cells)} |")
    lines += [
        "",
        "The same policies beside what they earn in the simulator, as `odaf reproduce estimates` has it for others:",
        "",
        f"| log | estimator | {' | '.join(name.replace('_', ' ') for name in FIGURES)} |",
        f"|---|---|{'---|' * len(FIGURES)}",
    ]
    for task, each in found.items():
        for estimator, own in each["beside_true_values"].items():
            cells = ["-" if name not in own else f"{own[name]:.2f}" for name in FIGURES]
            lines.append(f"| {task.removesuffix('-train')} | {estimator} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


STUDY = Study(
    "selection",
    "a grid of settings, chosen from by estimates, beside a random pick and tries in the simulator",
    plan,
    {"table.md": table, "summary.json": summary},
)
