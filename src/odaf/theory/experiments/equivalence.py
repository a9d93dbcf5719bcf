"""E3: minimising the outcome penalty, and minimising the mass of unseen outcomes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.equivalence import penalty, unseen_mass
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict


@dataclass(frozen=True)
class Equivalence(Experiment):
    """Problems of one decision: which of some policies, each with outcomes of its own.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        states: outcomes that there are.
        seen: of them in the data.
        policies: to choose from.
        actions: in each outcome.
        least: U_min, the smallest uncertainty of an unseen pair; others have between 0 and 1, unseen ones 1 more than
            `least` at most.
    """

    seed: int = 6
    problems: int = 500
    states: int = 8
    seen: int = 5
    policies: int = 5
    actions: int = 3
    least: float = 0.5

    label: ClassVar[str] = "E3"
    name: ClassVar[str] = "equivalence"
    corrected: ClassVar[str] = (
        "U_min M(pi) <= J(pi), so that the policy of least penalty J has unseen mass M <= min J / U_min. It has the "
        "least mass where U is 0 on seen pairs and constant on others; U >= 0 on seen pairs is all that is needed."
    )
    printed: ClassVar[str] = (
        "The two minimisations are called equivalent. What is shown is a bound, whose minimiser is another one; and "
        "U > 0 on seen pairs is said to follow from an assumption about unseen ones."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        outcomes = rng.dirichlet(np.ones(self.states), size=(self.problems, self.policies))
        policies = rng.dirichlet(np.ones(self.actions), size=(self.problems, self.policies, self.states))
        support = rng.permuted(np.tile(np.arange(self.states) < self.seen, (self.problems, 1)), axis=1)
        drawn = rng.uniform(size=(self.problems, self.states, self.actions))
        uncertainty = np.where(support[..., None], drawn, self.least + drawn)
        flat = np.where(support[..., None], 0.0, self.least) * np.ones(self.actions)

        mass = unseen_mass(outcomes, support)
        generic, special = penalty(outcomes, policies, uncertainty), penalty(outcomes, policies, flat)
        broken = float((self.least * mass > generic + 1e-12).any(1).mean())
        chosen = generic.argmin(1)
        of_chosen = mass[np.arange(self.problems), chosen]
        too_much = float((of_chosen > generic.min(1) / self.least + 1e-12).mean())
        same = float((special.argmin(1) == mass.argmin(1)).mean())
        other = float((chosen != mass.argmin(1)).mean())
        return Findings(
            (
                Check("corrected", "share of problems with U_min M > J", broken, "0", verdict(broken == 0.0)),
                Check(
                    "corrected",
                    "share of problems in which the chosen policy has M > min J / U_min",
                    too_much,
                    "0",
                    verdict(too_much == 0.0),
                ),
                Check(
                    "corrected",
                    "share of problems with one minimiser where U is 0 on seen pairs and constant on others",
                    same,
                    "1",
                    verdict(same == 1.0),
                ),
                Check(
                    "printed",
                    "share of problems with another minimiser where U is generic",
                    other,
                    "0",
                    verdict(other == 0.0),
                ),
            ),
            {"problems": self.problems},
            {"mean_mass_chosen": float(of_chosen.mean()), "mean_mass_least": float(mass.min(1).mean())},
        )
