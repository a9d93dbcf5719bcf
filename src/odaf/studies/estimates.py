"""The estimates study: policies of known value, judged from logs of somebody else.

For each robot eleven snapshots along a training run are judged from logs of its medium policy, one log a seed, all
policies of a log in one compiled program. The estimator that is recommended, how much wider its intervals have to be,
and the numbers of `odaf.estimation.shrinkage` are fixed on the first two logs of each robot and judged on the others.
"""

import json
import math
import time
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.estimator_scores import Estimated, Score, score, widening
from odaf.studies.job import PRINTS, DataEntries, Job, Log, Phase, Record, Study, Work, prints_of
from odaf.studies.known_policies import DISCOUNTS, TrueValues, as_policy, snapshots
from odaf.studies.known_shrinkage import Known, fitted
from odaf.studies.logs import LOCAL, RecordedLog, policies_print
from odaf.studies.recorded_estimates import RECORDED, intervals
from odaf.studies.tables import grouped

if TYPE_CHECKING:
    from odaf.training.progress import ProgressReport

ROBOTS = ("hopper", "halfcheetah", "walker2d")
LOGS = 7
FIXED_ON = (0, 1)  # logs by which the recommended estimator is chosen
ROWS = 100_000
HORIZON = 1_000
CONFIDENCE = 0.95
UNKNOWABLE = "expert"  # acts as nobody in the logs did, and earns most
VERSION = 3  # raised when the same settings would give other estimates


@dataclass(frozen=True)
class SeededLog(RecordedLog):
    """A recorded set among others of the same name: its name tells the seed."""

    @property
    def name(self) -> str:
        return f"{self.set_name}-{self.seed}"


@dataclass(frozen=True)
class Estimating(Work):
    """All policies of one robot judged from one log.

    Attributes:
        robot: as in `hopper`.
        seed: of the log.
        rows: of the log.
        horizon: steps of an episode that are counted.
        every: which snapshots are judged, see `known_policies.snapshots`.
        changes: settings of the estimates other than the defaults.
    """

    robot: str
    seed: int
    rows: int = ROWS
    horizon: int = HORIZON
    every: int = 2
    changes: tuple[tuple[str, Any], ...] = ()

    @property
    def log(self) -> Log:
        return SeededLog(f"{self.robot}-medium", self.rows, self.seed)

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"robot": (self.robot,), "log": (f"log-{self.seed}",)}

    def likeness(self) -> tuple[Hashable, ...]:
        return (("robot", self.robot), type(self).__name__)

    def guess(self) -> float:
        return 600.0

    def said(self, record: Record) -> str:
        return f"{len(record['policies'])} policies"

    def identity(self) -> dict[str, Any]:
        from odaf.estimation import EstimateSettings
        from odaf.training.files import plain

        return {
            "version": VERSION,
            "estimators": list(RECORDED),
            "settings": plain(asdict(EstimateSettings(**dict(self.changes)))),
            "data": {"print": "known", **self.log.recipe()},
            "horizon": self.horizon,
            "discounts": list(DISCOUNTS),
            "every": self.every,
            "policies_sha256": policies_print(f"{self.robot}-medium-replay"),
        }

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        prints, entry = prints_of(record["data"]), data.get(self.log.name, {"recipe": {}, "sha256": []})
        known = "known" if set(prints) & set(entry["sha256"]) else f"{prints[0][:8]}, not in data.json"
        return {**record["identity"], "data": {"print": known, **entry["recipe"]}}

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.data import fingerprint
        from odaf.data.dataset import Dataset
        from odaf.estimation import estimate_many

        begun = time.monotonic()
        dataset = Dataset.load(self.log.present(place))
        policies = snapshots(self.robot, self.every)
        progress.start(f"{self.robot}, log {self.seed}", 1_000, unit="thousandths")
        estimates = estimate_many(
            [as_policy(policy, dataset.observation_names) for policy in policies.values()],
            dataset,
            acting="draws",
            discounts=DISCOUNTS,
            horizon=self.horizon,
            seed=self.seed,
            progress=lambda done, total: progress.advance(1_000 * done // total),
            **dict(self.changes),
        )
        progress.close()
        identity = {name: value for name, value in self.identity().items() if name != "data"}
        return {
            "kind": "estimates",
            "robot": self.robot,
            "log": self.seed,
            "data": {"origin": LOCAL, **_prints(fingerprint.record(dataset))},
            "identity": identity,
            "policies": {
                name: {str(each.discount): each.to_dict() for each in found}
                for name, found in zip(policies, estimates, strict=True)
            },
            "seconds": time.monotonic() - begun,
        }


def _prints(found: Mapping[str, Any]) -> dict[str, Any]:
    return {kind: found[kind] for kind in PRINTS if kind in found}


def plan() -> list[Phase]:
    """For each robot its true values and its logs; the logs that decide what is recommended come first."""
    words = tuple(f"log-{seed}" for seed in range(LOGS))
    truths = [Job(f"truth-{robot}", TrueValues(robot, horizon=HORIZON, words=words)) for robot in ROBOTS]
    first, others = (
        [Job(f"{robot}-log{seed}", Estimating(robot, seed)) for seed in seeds for robot in ROBOTS]
        for seeds in (FIXED_ON, [seed for seed in range(LOGS) if seed not in FIXED_ON])
    )
    return [
        Phase("what the policies earn", tuple(truths)),
        Phase("logs by which an estimator is chosen", tuple(first)),
        Phase("logs by which it is judged", tuple(others)),
    ]


# ---- what records say -----------------------------------------------------------------------------------------------

Said = dict[str, dict[tuple[str, int], Estimated]]
"""For each estimator what it said of each robot's log."""


def said_at(records: Sequence[Record], discount: float) -> Said:
    """What every estimator said at a discount; logs of robots without true values are left out."""
    truths = {record["robot"]: record["policies"] for record in records if record["kind"] == "truth"}
    found: Said = {}
    for record in records:
        if record["kind"] != "estimates" or record["robot"] not in truths:
            continue
        policies = [policy for policy in record["policies"] if policy in truths[record["robot"]]]
        truth = [truths[record["robot"]][policy][str(discount)]["mean"] for policy in policies]
        members = record["identity"]["settings"]["members"]
        said = [intervals(record["policies"][policy][str(discount)], members) for policy in policies]
        for name in said[0]:
            values, low, high = np.array([each[name] for each in said]).T
            each = Estimated(values, low, high, np.array(truth), tuple(policies))
            found.setdefault(name, {})[record["robot"], record["log"]] = each
    return found


def known_of_first_logs(records: Sequence[Record]) -> list[Known]:
    """What the numbers of `odaf.estimation.shrinkage` are fitted to."""
    truths = {record["robot"]: record["policies"] for record in records if record["kind"] == "truth"}
    return [
        (valuation, record["identity"]["settings"]["members"], truths[record["robot"]][policy][discount]["mean"])
        for record in records
        if record["kind"] == "estimates" and record["robot"] in truths and record["log"] in FIXED_ON
        for policy, by_discount in record["policies"].items()
        if policy in truths[record["robot"]]
        for discount, valuation in by_discount.items()
    ]


@dataclass(frozen=True)
class Recommended:
    """What the first logs recommend: the estimator, and the factor by which its intervals are widened."""

    estimator: str
    factor: float


def recommended(said: Said) -> Recommended | None:
    """The estimator with the lowest interval score on the logs that choose; None where there are none."""
    chosen: tuple[float, str] | None = None
    for name, sets in said.items():
        choosing = _of_logs(sets, chooses=True)
        found = score(choosing) if choosing else None
        if found is not None and found.answered == 1.0 and (chosen is None or found.interval_score < chosen[0]):
            chosen = found.interval_score, name
    if chosen is None:
        return None
    return Recommended(chosen[1], max(1.0, widening(_of_logs(said[chosen[1]], chooses=True), CONFIDENCE)))


def _of_logs(sets: Mapping[tuple[str, int], Estimated], chooses: bool) -> list[Estimated]:
    return [each for (_, log), each in sets.items() if (log in FIXED_ON) == chooses]


def scores(said: Said) -> dict[str, Score]:
    """Of every estimator on the logs that judge, and of the recommended one with its wider intervals."""
    judging = {name: _of_logs(sets, chooses=False) for name, sets in said.items()}
    found = {name: score(sets) for name, sets in judging.items() if sets}
    choice = recommended(said)
    if choice is not None and judging[choice.estimator]:
        wide = [each.widened(choice.factor) for each in judging[choice.estimator]]
        found["recommended"] = score(wide)
        found[f"recommended, without the {UNKNOWABLE}"] = score([each.without(UNKNOWABLE) for each in wide])
    return found


def summary(records: Sequence[Record]) -> str:
    """JSON: figures of every estimator on the judging logs; those without a discount have ", undiscounted" behind."""
    content: dict[str, Any] = {}
    for discount in DISCOUNTS:
        said, suffix = said_at(records, discount), "" if discount < 1.0 else ", undiscounted"
        choice = recommended(said)
        for name, found in scores(said).items():
            figures: dict[str, Any] = {
                field: None if math.isnan(value) else value for field, value in asdict(found).items()
            }
            if name == "recommended" and choice is not None:
                figures |= {"estimator": choice.estimator, "widened_by": choice.factor}
            content[f"{name}{suffix}"] = figures
    return json.dumps(content, indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: the estimators at each discount, then for each robot what is to be told apart."""
    kinds = grouped(records, lambda record: record["kind"])
    estimates = kinds.get("estimates", ())
    logs = len(estimates)
    lines = [
        f"Snapshots of training runs judged from medium logs of {ROWS:,} rows, {LOCAL};",
        f"{logs} of {LOGS * len(ROBOTS)} logs are there. Logs {' and '.join(map(str, FIXED_ON))} of each robot choose",
        "the recommended estimator and how much its intervals are widened; the figures are of the other logs. Errors",
        "and widths are shares of the spread of the true values; coverage is of 95 % intervals. All policies draw",
        "their actions.",
        "Made by `odaf reproduce estimates` from the records in this folder.",
    ]
    for discount in DISCOUNTS:
        said = said_at(records, discount)
        choice, found = recommended(said), scores(said)
        if not found:
            continue
        title = f"discount {discount:g}" if discount < 1.0 else "undiscounted"
        chosen = "" if choice is None else f"; recommended: {choice.estimator}, widened by {choice.factor:.2f}"
        lines += [
            "",
            f"**{title}**{chosen}",
            "",
            "| estimator | Spearman | regret@1 | mean absolute error | coverage | width | answered | interval score |",
            "|---|---|---|---|---|---|---|---|",
            *(
                f"| {name} | {' | '.join(_shown(value) for value in asdict(each).values())} |"
                for name, each in found.items()
            ),
        ]
    numbers = fitted(known_of_first_logs(records))
    if numbers is not None:
        said_of = ", ".join(f"{name} {value:.2f}" for name, value in vars(numbers).items())
        lines += ["", f"Fitted Q is shrunk by what the first logs say: {said_of}."]
    lines += [
        "",
        "| robot | policies | true values, undiscounted | standard error at most | discount 0.99 | log's own |",
        "|---|---|---|---|---|---|",
    ]
    for record in kinds.get("truth", ()):
        lines.append(_robot_row(record, [each for each in estimates if each["robot"] == record["robot"]]))
    return "\n".join(lines) + "\n"


def _robot_row(record: Record, estimates: Sequence[Record]) -> str:
    plain = [each["1.0"] for each in record["policies"].values()]
    means, error = [each["mean"] for each in plain], max(each["standard_error"] or math.nan for each in plain)
    discounted = [each["0.99"]["mean"] for each in record["policies"].values()]
    own = [next(iter(each["policies"].values()))["1.0"]["behaviour"]["value"] for each in estimates]
    logged = "-" if not own else f"{min(own):,.0f} to {max(own):,.0f}"
    return (
        f"| {record['robot']} | {len(plain)} | {min(means):,.0f} to {max(means):,.0f} | {error:,.1f} "
        f"| {min(discounted):,.1f} to {max(discounted):,.1f} | {logged} |"
    )


def _shown(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"


def figure(records: Sequence[Record], out: Path) -> None:
    """A panel a robot: the recommended estimator's values and intervals beside the true values, on the judging logs."""
    from odaf.report.figures import estimates_figure

    said = said_at(records, DISCOUNTS[0])
    choice = recommended(said)
    if choice is None:
        return
    panels = {}
    for robot in ROBOTS:
        own = [each for (of, log), each in said[choice.estimator].items() if of == robot and log not in FIXED_ON]
        if own:
            wide = [each.widened(choice.factor) for each in own]
            truth, values, low, high = (
                np.concatenate([getattr(each, part) for each in wide]) for part in ("truth", "values", "low", "high")
            )
            panels[robot] = (truth, values, low, high)
    if panels:
        estimates_figure(panels, out, f"{choice.estimator}, discount {DISCOUNTS[0]:g}")


STUDY = Study(
    "estimates",
    "policies of known value, judged from logs of another policy",
    plan,
    {"table.md": table, "summary.json": summary},
    {"figure.png": figure},
)
