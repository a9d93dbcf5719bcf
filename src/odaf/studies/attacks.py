"""The attacks study: what policies earn while what they see is moved by up to some standard deviations.

Victims are the paper's form in its attack setting, its rivals, and our form with its base. A victim that earns less
than its log without an attack has nothing to lose: it decides nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies import attacks_table
from odaf.studies.job import Phase, Record, Study
from odaf.studies.of_policy import OfPolicy, phase_of
from odaf.studies.robots import ROBOTS, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run
    from odaf.training.progress import ProgressReport

STEPS, SEEDS, COSTLY_STEPS = 50_000, 4, 10_000
EVALUATION = Evaluation(every=10_000, episodes=10)
BUDGETS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
ASKED = ("action-diff", "min-q")
SAMPLED = ("random", "min-q-std")
CLIMBED = tuple(f"{name}-{order}-order" for order in ("first", "mixed") for name in (*ASKED, "min-q-std"))

Victim = tuple[str, str | None]  # preset, and the setting of the task

OURS: tuple[Victim, ...] = (("odaf-locomotion", None), ("odaf-locomotion-without-outcome", None))
PLAIN: tuple[Victim, ...] = (("sac-n", None), ("edac", None))
SET_FOR_ATTACKS: tuple[Victim, ...] = (("odaf-paper", "attack"), ("rorl", "attack"))
USUAL: tuple[Victim, ...] = (("odaf-paper", None), ("rorl", None))


@dataclass(frozen=True)
class Attacking(OfPolicy):
    """The curve of a policy's scores over the budgets of an attack by its own critics.

    Attributes:
        attack: name in `odaf.evaluation.attacks.ATTACKS`.
        budgets: largest offsets in standard deviations of the log, ascending.
        episodes: at each.
    """

    attack: str = "action-diff"
    budgets: tuple[float, ...] = BUDGETS
    episodes: int = 10

    measure_name = "attacked"

    @property
    def name(self) -> str:
        return f"{super().name}-{self.attack}"

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return super().labels | {"attack": (self.attack,)}

    def settings(self) -> dict[str, Any]:
        return {"attack": self.attack, "budgets": list(self.budgets), "episodes": self.episodes, "rule": "pgd"}

    def guess(self) -> float:
        return 600.0 if self.attack.endswith("-order") else 180.0

    def said(self, record: Record) -> str:
        if record["found"] is None:
            return "the policy diverged"
        return f"{record['found']['scores'][0]:.1f} to {record['found']['scores'][-1]:.1f}"

    def measure(self, run: "Run", place: Path, progress: "ProgressReport") -> Mapping[str, Any]:
        from odaf.runs.evaluate_attacks import attack_curve

        progress.start(f"attack {self.attack}", 0)
        curve = attack_curve(run.directory, self.attack, budgets=self.budgets, episodes=self.episodes)
        progress.close()
        scores, area = curve.normalised, curve.normalised_area()
        assert scores is not None and area is not None
        return {
            "attack": self.attack,
            "budgets": list(curve.budgets),
            "scores": [each.mean for each in scores],
            "returns": [each.mean for each in curve.returns],
            "area": area.mean,
            "environment_steps": curve.environment_steps,
        }


def plan(data: Path | None = None) -> list[Phase]:
    """What walks after few updates first, by the two attacks that the claim is about."""

    def works(victims: Sequence[Victim], robots: Sequence[str], attacks: Sequence[str]) -> list[Attacking]:
        return [
            Attacking(_training(victim, robot, seed, data), attack)
            for seed in range(SEEDS)
            for robot in robots
            for victim in victims
            for attack in attacks
        ]

    every = (*OURS, *PLAIN, *SET_FOR_ATTACKS, *USUAL)
    phases: list[Phase] = []
    for title, some in (
        ("Hopper: our form and its base", works(OURS, ROBOTS[:1], ASKED)),
        ("the other robots: our form and its base", works(OURS, ROBOTS[1:], ASKED)),
        ("three robots: SAC-N and EDAC", works(PLAIN, ROBOTS, ASKED)),
        ("the paper's attack settings: its form, RORL", works(SET_FOR_ATTACKS, ROBOTS, ASKED)),
        ("their usual settings", works(USUAL, ROBOTS, ASKED)),
        ("other attacks by sampling", works(every, ROBOTS, SAMPLED)),
        ("attacks that climb", works(every, ROBOTS, CLIMBED)),
    ):
        phases.append(phase_of(title, some, phases))
    return phases


def _training(victim: Victim, robot: str, seed: int, data: Path | None) -> Training:
    (preset, setting), task = victim, robot_task(robot, "medium", EVALUATION, data=data)
    # Fifty critics on Hopper would cost five times as much as all else; ten are what the others have.
    changes = (("num_critics", 10),) if preset == "edac" else ()
    steps = COSTLY_STEPS if preset == "rorl" else STEPS
    return Training(preset, task, seed, steps, changes, setting=setting)


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "attacks",
        "what policies earn while what they see is moved against them",
        partial(plan, data),
        {"table.md": attacks_table.table, "summary.json": attacks_table.summary},
        {"figure.png": attacks_table.figure},
        attacks_table.CLAIM,
        on_files=study,
    )


STUDY = study()
