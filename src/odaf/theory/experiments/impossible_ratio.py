"""E2b: the assumption of the main theorem, a ratio of densities below 1, cannot hold; nor can the term that uses it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.bound import iteration_error
from odaf.theory.candidates import outcome_supported
from odaf.theory.concentrability import smallest_supremum
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import random_mdp, random_support, state_distribution, uniform_policy
from odaf.theory.operator import fixed_point, iterate


@dataclass(frozen=True)
class ImpossibleRatio(Experiment):
    """In each state of random problems the policy is sought, among all, whose outcomes have the smallest ratio.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        k: iterations.
        shift: of the first values above the fixed point.
        share: of states in the data.
        discount: gamma.
    """

    seed: int = 4
    problems: int = 20
    k: int = 20
    shift: float = 1.0
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E2b"
    name: ClassVar[str] = "impossible-ratio"
    corrected: ClassVar[str] = (
        "sup_s' P(s'|s,pi) / d(s') >= 1 for every policy, as both sum to 1; |Q^k - Q*| <= gamma^k |Q^0 - Q*| in sup "
        "norm needs no such assumption, and a constant shift attains it."
    )
    printed: ClassVar[str] = (
        "sup_s' P(s'|s,pi) / d(s') <= eps < 1 is assumed, and the second term is gamma^k eps max(Q^0 - Q*): below "
        "what a constant shift leaves, and without the absolute value negative where Q^0 starts below."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        smallest, behaviour, kept, below, excess = [], [], [], [], []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            states, policy = len(mdp.rewards), uniform_policy(mdp)
            distribution = state_distribution(mdp, policy, np.full(states, 1.0 / states))
            smallest += [smallest_supremum(outcomes, distribution) for outcomes in mdp.transitions]
            behaviour.append((np.einsum("sa,saz->sz", policy, mdp.transitions) / distribution).max())

            allowed = outcome_supported(mdp.transitions, random_support(rng, states, self.share))
            limit = fixed_point(mdp, allowed)
            starts = np.stack([limit + self.shift, np.zeros_like(limit), 10.0 * rng.normal(size=limit.shape)])
            errors = np.abs(iterate(starts, mdp, allowed, self.k) - limit).max((1, 2))
            most = iteration_error(self.k, starts, limit, self.discount)
            excess.append((errors - most).max())
            kept.append((errors / most)[0])
            below.append(np.where(allowed, -limit, -np.inf).max() <= 0.0)
        least, above, factor, signed = float(min(smallest)), float(max(excess)), float(min(kept)), float(np.mean(below))
        return Findings(
            (
                Check(
                    "corrected",
                    "smallest supremum of the ratio, over all policies in each state (linear programme)",
                    least,
                    ">= 1",
                    verdict(least >= 1.0 - 1e-9),
                ),
                Check(
                    "corrected",
                    f"largest excess of |Q^{self.k} - Q*| over gamma^{self.k} |Q^0 - Q*|",
                    above,
                    "<= 1e-8",
                    verdict(above <= 1e-8),
                ),
                Check("printed", "the same supremum: an eps that would do", least, "< 1", verdict(least < 1.0 - 1e-9)),
                Check(
                    "printed",
                    "smallest eps with |Q^k - Q*| <= gamma^k eps |Delta_0| after a constant shift",
                    factor,
                    "< 1",
                    verdict(factor < 1.0 - 1e-6),
                ),
                Check(
                    "printed",
                    "share of problems in which max(Q^0 - Q*) from Q^0 = 0 is not positive: a distance below 0",
                    signed,
                    "0",
                    verdict(signed == 0.0),
                ),
            ),
            {"problems": self.problems, "states": len(smallest)},
            {"mean_supremum_of_the_behaviour": float(np.mean(behaviour))},
        )
