"""The plant study: does the verdict from a log alone tell which policies may run two tanks?

For each seed operators write a log, half of its shifts are set aside, and six policies learn from the others. The
verdict on each comes from the shifts set aside (`odaf.assessment.verdict`, by the blend); what it is truly worth is
asked of the simulator afterwards. `TUNING` is the log on which the rules were settled before the others were judged.
"""

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies.job import Job, Phase, Record, Study, Work

if TYPE_CHECKING:
    from odaf.data.dataset import Dataset
    from odaf.training.policy import Policy
    from odaf.training.progress import ProgressReport

TUNING = 0
SEEDS = (0, 1, 2, 3)
DECIDES = "blend"
VERDICTS = ("better", "not decided", "worse", "refused")
VERSION = 1  # raised when the same settings would give other figures


@dataclass(frozen=True)
class Learnt:
    """How a policy comes about.

    Attributes:
        preset: of its learner.
        updates: how many.
        means: in a few words, for the table.
        changes: of the preset's settings.
        reversed: whether it learns to lose what the log earned.
    """

    preset: str
    updates: int
    means: str
    changes: tuple[tuple[str, Any], ...] = ()
    reversed: bool = False


SMALL = (("hidden_sizes", (32, 32)), ("batch_size", 128))
VALUED = (*SMALL, ("discount", 0.95))
UNHELD = (*VALUED, ("actor_penalty", 0.0), ("critic_penalty", 0.0))
POLICIES: dict[str, Learnt] = {
    "rebrac": Learnt("rebrac", 8_000, "ReBRAC, 8,000 updates", VALUED),
    "cloned": Learnt("behaviour-cloning", 2_000, "imitates the operators", SMALL),
    "undertrained": Learnt("rebrac", 200, "ReBRAC, 200 updates", VALUED),
    "half-trained": Learnt("rebrac", 1_000, "ReBRAC, 1,000 updates", VALUED),
    "unheld": Learnt("rebrac", 8_000, "the same as ReBRAC without either penalty", UNHELD),
    "contrary": Learnt("rebrac", 2_000, "unheld, on profits with the sign reversed", UNHELD, reversed=True),
}
"""By name, in the order of the table."""


@dataclass(frozen=True)
class Judging(Work):
    """One log and its policies.

    Attributes:
        seed: of the log, of the split and of the trainings.
        shifts: in the log; half are set aside.
        episodes: played for a true value.
        policies: names in `POLICIES`.
        updates: at most, of a training; None as `POLICIES` has it.
        settings: of the estimates, other than the defaults: smaller networks, enough for five columns.
    """

    seed: int
    shifts: int = 200
    episodes: int = 50
    policies: tuple[str, ...] = tuple(POLICIES)
    updates: int | None = None
    settings: tuple[tuple[str, Any], ...] = (
        ("hidden_sizes", (64, 64)),
        ("steps", 8_000),
        ("members", 6),
        ("learning_rate", 1e-3),
    )

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"log": (f"seed-{self.seed}",)}

    def guess(self) -> float:
        return 150.0

    def identity(self) -> dict[str, Any]:
        from odaf.training.files import plain

        chosen = {name: dataclasses.asdict(POLICIES[name]) for name in self.policies}
        own = dataclasses.asdict(self) | {"settings": dict(self.settings), "policies": chosen}
        return plain({"version": VERSION, **own})

    def said(self, record: Record) -> str:
        found = [f"{name} {each['verdict']}" for name, each in record["policies"].items()]
        return ", ".join(found)

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.assessment.verdict import verdict_of
        from odaf.environments.two_tanks import TwoTanks
        from odaf.estimation import estimate_many
        from odaf.evaluation.rollouts import rollout

        begun = time.monotonic()
        learned, aside = self.logs(place)
        policies = {name: self.trained(name, learned, place, progress) for name in self.policies}
        progress.start(f"verdicts on log {self.seed}", 1)
        valuations = estimate_many(list(policies.values()), aside, **dict(self.settings))
        report = aside.check()
        found = {}
        for (name, policy), (valuation,) in zip(policies.items(), valuations, strict=True):
            played = rollout(policy, TwoTanks, self.episodes)
            verdict, reasons = verdict_of(valuation[DECIDES], (), report)
            found[name] = {
                "verdict": verdict,
                "reasons": reasons,
                "true_value": float(played.returns.mean()),
                "true_error": float(played.returns.std() / self.episodes**0.5),
                "trips": float(played.flags["tripped"].mean()) if "tripped" in played.flags else None,
                "value": valuation.to_dict(),
            }
        progress.close()
        return {
            "seed": self.seed,
            "identity": self.identity(),
            "operators": dataclasses.asdict(valuations[0][0].behaviour),
            "policies": found,
            "seconds": time.monotonic() - begun,
        }

    def logs(self, place: Path) -> "tuple[Dataset, Dataset]":
        """To learn from, and set aside."""
        from odaf.environments.two_tanks import read_log, write_log

        place.mkdir(parents=True, exist_ok=True)
        path = place / f"plant-{self.shifts}-{self.seed}.csv"
        write_log(path, self.shifts, self.seed)
        return read_log(path).split(holdout=0.5, seed=self.seed)

    def trained(self, name: str, log: "Dataset", place: Path, progress: "ProgressReport") -> "Policy":
        """The policy of that name; its run is gone on with, or taken as it is, if it lies there."""
        from odaf.runs import presets
        from odaf.runs.fit import fit

        how = POLICIES[name]
        learner = presets.load(how.preset, dict(how.changes))
        updates = how.updates if self.updates is None else min(how.updates, self.updates)
        run = fit(
            learner,
            dataclasses.replace(log, rewards=-log.rewards) if how.reversed else log,
            steps=updates,
            seeds=[self.seed],
            directory=place / f"plant-{self.shifts}-{self.seed}-{name}-{updates}",
            preset=how.preset,
            progress=progress,
        )
        return run.policy(self.seed)


def plan() -> list[Phase]:
    """The log that rules were settled on, then those that judge them."""
    jobs = {seed: Job(f"seed-{seed}", Judging(seed)) for seed in SEEDS}
    others = tuple(job for seed, job in jobs.items() if seed != TUNING)
    return [Phase("the log of tuning", (jobs[TUNING],)), Phase("logs that judge", others)]


# ---- what records say -----------------------------------------------------------------------------------------------


def difference(record: Record, each: Mapping[str, Any]) -> float:
    """What the policy truly earns a shift beside what the shifts set aside did."""
    return each["true_value"] - record["operators"]["value"]


def wrong(record: Record, each: Mapping[str, Any]) -> bool:
    """Whether the verdict claims what is not so."""
    above = difference(record, each)
    return (each["verdict"] == "better" and above <= 0.0) or (each["verdict"] == "worse" and above >= 0.0)


def covered(record: Record, each: Mapping[str, Any]) -> bool:
    """Whether the interval of the estimate holds the truth."""
    interval = estimate_in(each)["difference"]
    return interval["low"] <= difference(record, each) <= interval["high"]


def estimate_in(each: Mapping[str, Any], method: str = DECIDES) -> Mapping[str, Any]:
    """What one estimator says."""
    return next(found for found in each["value"]["estimates"] if found["method"] == method)


def summary(records: Sequence[Record]) -> str:
    """JSON: by log and policy the verdict beside the truth.

    And, on the logs that judge, of each verdict how many policies got it, how often it was wrong, and of how many the
    interval holds the truth.
    """
    logs = {
        str(record["seed"]): {
            name: {
                "true_difference": difference(record, each),
                "difference": estimate_in(each)["difference"],
                "unlike_actions": each["value"]["unlike"],
                "unlike_states": each["value"]["unlike_states"],
                "verdict": each["verdict"],
                "wrong": wrong(record, each),
                "covered": covered(record, each),
            }
            for name, each in record["policies"].items()
        }
        for record in records
    }
    judging = [each for seed, found in logs.items() if int(seed) != TUNING for each in found.values()]
    counts = {
        verdict: {
            "policies": sum(each["verdict"] == verdict for each in judging),
            **{
                fact: sum(each["verdict"] == verdict and each[fact] for each in judging)
                for fact in ("wrong", "covered")
            },
        }
        for verdict in VERDICTS
    }
    return json.dumps({"judging": counts, "logs": logs}, indent=1) + "\n"


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each policy of each log."""
    lines = [
        "Policies for two tanks, judged from 100 shifts set aside, beside what they are worth in the simulator (mean",
        "of 50 shifts). Values are of a shift, less what the operators earned. Unlike are actions that are rare in the",
        f"log, and predicted states that lie far from it. Rules were settled on log {TUNING}. Made by",
        "`odaf reproduce plant` from the records in this folder.",
        "",
        "| log | policy | true value | estimate (blend) | unlike actions | unlike states | verdict |",
        "|---|---|---|---|---|---|---|",
    ]
    for record in records:
        operators = record["operators"]
        own = _interval(operators)
        lines.append(f"| {record['seed']} | operators | 0 | they earned {own} | - | - | - |")
        for name, each in record["policies"].items():
            found, value = estimate_in(each), each["value"]
            states = "-" if value["unlike_states"] is None else f"{value['unlike_states']:.0%}"
            verdict = f"**{each['verdict']}**" + (", wrongly" if wrong(record, each) else "")
            lines.append(
                f"| {record['seed']} | `{name}` | {difference(record, each):+,.0f} | {_interval(found['difference'])} "
                f"| {value['unlike']:.0%} | {states} | {verdict} |"
            )
    said = [f"`{name}`: {how.means}" for name, how in POLICIES.items()]
    return "\n".join([*lines, "", "; ".join(said) + "."]) + "\n"


def _interval(found: Mapping[str, float]) -> str:
    return f"{found['value']:+,.0f} ({found['low']:+,.0f} to {found['high']:+,.0f})"


STUDY = Study(
    "plant",
    "which policies may run two tanks, told from operators' logs, beside what they are worth in the simulator",
    plan,
    {"table.md": table, "summary.json": summary},
)
