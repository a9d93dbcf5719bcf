"""The validation study: does the outcome's score tell safe actions from unsafe ones?

A policy with an ensemble of ten critics learns from a robot's log; then its critics score actions by their outcomes,
known from the simulator or from a model. Beside these stand scores that do not look at outcomes, or not at critics.
On a log of random actions nothing is expected: it is the negative control.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies import safe_and_unsafe as parts
from odaf.studies import validation_table
from odaf.studies.job import Phase, Record, Study
from odaf.studies.of_policy import OfPolicy, phase_of
from odaf.studies.robots import ROBOTS, Method, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.components.fitting import Progress
    from odaf.evaluation.runs import Run
    from odaf.training.progress import ProgressReport

STEPS, SEEDS = 20_000, 4
EVALUATION = Evaluation(every=10_000, episodes=10)
# Both have ten critics: the term on its stabilised base, and the paper's own base.
METHODS: tuple[Method, ...] = (("odaf", ()), ("sac-n", ()))


@dataclass(frozen=True)
class Validating(OfPolicy):
    """Scores of safe and unsafe actions by the critics of one policy.

    Attributes:
        states: drawn from the log; those without a similar state in another episode are left out.
        model_steps: gradient steps of each model that is fitted to the log.
        hidden: widths of their hidden layers.
    """

    states: int = 2_000
    model_steps: int = 10_000
    hidden: tuple[int, ...] = (256, 256)

    measure_name = "outcomes"

    def settings(self) -> dict[str, Any]:
        return {"states": self.states, "model_steps": self.model_steps, "hidden": list(self.hidden)}

    def guess(self) -> float:
        return 240.0

    def said(self, record: Record) -> str:
        if record["found"] is None:
            return "the policy diverged"
        areas = (f"{kind} {each['auroc']:.2f}" for kind, each in record["found"]["dynamics"].items())
        return f"AUROC {', '.join(areas)}"

    def measure(self, run: "Run", place: Path, progress: "ProgressReport") -> Mapping[str, Any]:
        from odaf.data.dataset import Dataset
        from odaf.evaluation.outcome_score import area_under_curve, rank_correlation
        from odaf.evaluation.recovery import KnownGround

        dataset, normaliser, seed = Dataset.load(self.log.present(place)), run.files.normaliser, self.training.seed
        fit = {"steps": self.model_steps, "hidden": self.hidden, "seed": seed}
        drawn = parts.draw_actions(
            dataset, normaliser, self.states, progress=_shown(progress, "inverse map", self.model_steps), **fit
        )
        states = normaliser.normalise(dataset.observations[drawn.rows])
        outcomes = parts.Outcomes(dataset, self.log.name.split("-")[0], drawn.rows)
        truth = {name: outcomes.true(actions) for name, actions in drawn.sides.items()}
        logged, recorded = outcomes.true(dataset.actions[drawn.rows]), dataset.next_observations[drawn.rows]
        scores = {"simulator": {
            name: parts.scores_of(run.files, seed, normaliser.normalise(each)[None]) for name, each in truth.items()
        }}  # fmt: skip
        models = {}
        for kind in parts.MODELS:
            shown = _shown(progress, f"{kind} model", self.model_steps)
            model, models[kind] = parts.fitted_model(kind, dataset, normaliser, progress=shown, **fit)
            draws = parts.DRAWS if kind == "cvae" else 1
            scores[kind] = {
                name: parts.scores_of(run.files, seed, outcomes.modelled(model, normaliser, actions, draws, seed))
                for name, actions in drawn.sides.items()
            }
        ground = KnownGround.of(dataset, normaliser, seed=seed)
        distance = {name: ground.distances(each) for name, each in truth.items()}
        clone = _shown(progress, "clone", self.model_steps)
        others = {
            "disagreement at the action": parts.without_outcomes(run.files, seed, states, drawn.sides),
            "distance of the outcome to the log": distance,
            "improbable for a clone": parts.improbable(dataset, normaliser, states, drawn.sides, progress=clone, **fit),
        }
        progress.close()
        unseen = distance["unsafe"] > ground.threshold
        both = {kind: np.concatenate([each["safe"], each["unsafe"]]) for kind, each in scores.items()}
        true = scores["simulator"]
        return {
            "pairs": len(drawn.rows),
            "near": drawn.near,
            "inverse_r_squared": drawn.inverse_r_squared,
            "simulator_error": float(np.sqrt(np.mean(np.square((logged - recorded) / normaliser.std)))),
            "models": models,
            "dynamics": {kind: parts.told_apart(each, seed) for kind, each in scores.items()},
            "others": {name: area_under_curve(each["safe"], each["unsafe"]) for name, each in others.items()},
            "unseen": {
                "share": float(unseen.mean()),
                "auroc": area_under_curve(true["safe"], true["unsafe"][unseen]) if unseen.any() else None,
            },
            "rank_correlation": {kind: rank_correlation(both["simulator"], both[kind]) for kind in models},
        }


def _shown(progress: "ProgressReport", stage: str, steps: int) -> "Progress":
    progress.start(stage, steps)
    return lambda done, total: progress.advance(done)


def plan(data: Path | None = None) -> list[Phase]:
    """Hopper's medium log first; the negative control with it, for what it says of the test itself."""

    def works(robots: tuple[str, ...], kinds: tuple[str, ...], methods: tuple[Method, ...]) -> list[Validating]:
        return [
            Validating(Training(preset, robot_task(robot, kind, EVALUATION, data=data), seed, STEPS, changes))
            for seed in range(SEEDS)
            for kind in kinds
            for robot in robots
            for preset, changes in methods
        ]

    ours, base = METHODS[:1], METHODS[1:]
    phases: list[Phase] = []
    for title, some in (
        (
            "Hopper, medium, and random as the control: the term's policy",
            works(("hopper",), ("medium", "random"), ours),
        ),
        ("the other robots", works(ROBOTS[1:], ("medium", "random"), ours)),
        ("the paper's base, SAC-N", works(ROBOTS, ("medium", "random"), base)),
        ("medium-expert logs", works(ROBOTS, ("medium-expert",), METHODS)),
    ):
        phases.append(phase_of(title, some, phases))
    return phases


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "validation",
        "whether the critics' disagreement where an action leads tells safe actions from unsafe ones",
        partial(plan, data),
        {"table.md": validation_table.table, "summary.json": validation_table.summary},
        {"figure.png": validation_table.figure},
        validation_table.CLAIM,
        on_files=study,
    )


STUDY = study()
