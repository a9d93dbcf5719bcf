"""What the policies of a run earn while their observations are attacked, over a range of budgets."""

import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.random as jr
import numpy as np

from odaf.environments.contact_margins import ContactMargins
from odaf.environments.reference_returns import reference_of
from odaf.errors import ConfigError
from odaf.evaluation.attacks import ATTACKS, AttackedPolicy, Judge, StepRule, threat_model
from odaf.evaluation.rollouts import rollout_in
from odaf.evaluation.scores import Scores
from odaf.evaluation.statistics import Estimate, t_interval
from odaf.runs.trial import Trial
from odaf.training.run_directory import RunDirectory

BUDGETS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)


@dataclass(frozen=True)
class AttackCurve:
    """Return against budget.

    Attributes:
        attack: name of the attack.
        rule: how its gradient steps move, if it takes any.
        budgets: sizes of the box in standard deviations, in ascending order.
        scores: one for each budget, over the same seeds and starts.
        environment_steps: played in all.
        seconds: that this took, compilation included.
        attacker: the run whose critics were asked; None where each policy's own were, or none.
    """

    attack: str
    rule: StepRule
    budgets: tuple[float, ...]
    scores: tuple[Scores, ...]
    environment_steps: int
    seconds: float
    attacker: str | None = None

    @property
    def environment(self) -> str | None:
        """Gymnasium's name of where it was played, if it has one."""
        return self.scores[0].environment

    @property
    def returns(self) -> tuple[Estimate, ...]:
        """Mean return at each budget with its 95 % interval over seeds."""
        return tuple(scores.estimate() for scores in self.scores)

    @property
    def normalised(self) -> tuple[Estimate, ...] | None:
        """The same as normalised scores; None where the environment has no reference returns."""
        reference = None if self.environment is None else reference_of(self.environment)
        return (
            None
            if reference is None
            else tuple(estimate.rescaled(reference.random, reference.expert) for estimate in self.returns)
        )

    def area(self) -> Estimate | None:
        """Area under the curve divided by its width: the mean return over the budgets, one area a seed.

        By the trapezoid rule. None where there is one budget only.
        """
        if len(self.budgets) < 2:
            return None
        by_seed = np.array([[score.mean_return for score in scores.by_seed] for scores in self.scores])
        width = self.budgets[-1] - self.budgets[0]
        return t_interval(np.trapezoid(by_seed, self.budgets, axis=0) / width)

    def normalised_area(self) -> Estimate | None:
        """The same as a normalised score; None where the environment has no reference returns."""
        area, reference = self.area(), None if self.environment is None else reference_of(self.environment)
        return None if area is None or reference is None else area.rescaled(reference.random, reference.expert)

    def to_dict(self) -> dict[str, Any]:
        """JSON types: every budget with its scores, the area, and how fast it was played."""
        entries = []
        for place, (budget, scores) in enumerate(zip(self.budgets, self.scores, strict=True)):
            entry: dict[str, Any] = {"eps": budget, **scores.to_dict()}
            if self.normalised is not None:
                entry["normalised"]["interval"] = [self.normalised[place].low, self.normalised[place].high]
            entries.append(entry)
        areas = {"area": self.area(), "normalised_area": self.normalised_area()}
        return {
            "attack": self.attack,
            "attack_steps": self.rule,
            "attacker": self.attacker,
            "budgets": entries,
            **{name: _plain(area) for name, area in areas.items() if area is not None},
            "environment_steps": self.environment_steps,
            "environment_steps_per_second": self.environment_steps / self.seconds,
        }


def attack_curve(
    directory: str | os.PathLike[str],
    attack: str,
    *,
    budgets: Sequence[float] = BUDGETS,
    rule: StepRule = "pgd",
    episodes: int = 10,
    seed: int = 0,
    step: int | None = None,
    environment: str | None = None,
    attacker: str | os.PathLike[str] | None = None,
    contact_margins: ContactMargins | None = None,
) -> AttackCurve:
    """Play episodes with every seed of a run at every budget; nothing in its directory changes.

    All episodes of a budget are attacked together, in one compiled call a step. Budgets and seeds share the starts and
    the random draws, scaled to the box, so that a curve shows the budget's effect and not luck's.

    Args:
        directory: a run's directory.
        attack: a name in `odaf.evaluation.attacks.ATTACKS`.
        budgets: sizes of the box in standard deviations of the logged observations; 0 is the plain evaluation.
        rule: how gradient steps move, see `odaf.evaluation.attacks.climb`.
        episodes: episodes for each seed and budget.
        seed: chooses the starts and the draws.
        step: the checkpoint after so many updates; None takes each seed's last.
        environment: a gymnasium id; None takes the run's own.
        contact_margins: as in `odaf.evaluate`.
        attacker: directory of the run whose critics are asked, at the last checkpoint of its first seed; None asks each
            policy's own.

    Raises:
        CheckpointError: as `odaf.evaluate`.
        ConfigError: as `odaf.evaluate`; or there is no such attack, it does not work on this learner or with this
            attacker, or a budget is negative, given twice or no number.
    """
    if attack not in ATTACKS:
        raise ConfigError(f"attack '{attack}' is not known; known are {', '.join(ATTACKS)}")
    chosen = ATTACKS[attack]
    ascending = tuple(sorted(float(budget) for budget in budgets))
    if not ascending or not all(0.0 <= budget < math.inf for budget in ascending):
        raise ConfigError(f"eps: must be one or more numbers from 0, got {list(budgets)}; for instance 0 0.1 0.2")
    if len(set(ascending)) < len(ascending):
        raise ConfigError(f"eps: {list(budgets)} holds a budget twice; give each once")
    trial = Trial.of(
        directory, episodes=episodes, seed=seed, step=step, environment=environment, contact_margins=contact_margins
    )
    policies = dict(trial.policies())
    judges: dict[int, Judge | None] = dict.fromkeys(policies)
    if attacker is not None:
        judges = dict.fromkeys(policies, _first_judge(attacker))
    for policy_seed, policy in policies.items():  # refused before any environment is built
        if chosen.asks_critics and attacker is None:
            judges[policy_seed] = Judge.of(trial.run, policy_seed, trial.step)
        threat_model(policy, chosen, judges[policy_seed])
    make_env, limit = trial.examined.make_env, trial.rollouts.max_steps
    environments = [make_env() for _ in range(episodes)]
    played, scores, began = 0, [], time.perf_counter()
    try:
        for budget in ascending:
            found = {}
            for policy_seed, policy in policies.items():
                # An empty box leaves nothing to look for; an attack on it gives the same bits.
                judge = judges[policy_seed]
                shown = AttackedPolicy(policy, chosen, budget, jr.key(seed), rule, judge) if budget else policy
                found[policy_seed] = rollout_in(shown, environments, seed, limit)
            played += sum(int(episodes.lengths.sum()) for episodes in found.values())
            scores.append(trial.scores(found))
    finally:
        for environment_ in environments:
            environment_.close()
    asked = None if attacker is None else str(attacker)
    return AttackCurve(attack, rule, ascending, tuple(scores), played, time.perf_counter() - began, asked)


def _first_judge(directory: str | os.PathLike[str]) -> Judge:
    run = RunDirectory(Path(directory))
    return Judge.of(run, run.seeds[0])


def _plain(estimate: Estimate) -> dict[str, Any]:
    return {"mean": estimate.mean, "std": estimate.std, "interval": [estimate.low, estimate.high]}
