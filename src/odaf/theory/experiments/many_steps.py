"""E2c: a constant by which outcomes are denser than the data holds after one step, and after any number of them."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.candidates import outcome_supported
from odaf.theory.concentrability import constant, iteration_error, outcomes_of_steps, random_policy
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import random_mdp, random_support, state_distribution, uniform_policy
from odaf.theory.operator import fixed_point, iterate


@dataclass(frozen=True)
class ManySteps(Experiment):
    """Random sequences of policies of the candidate set, and random first values, in random problems.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        sequences: of policies, in each problem; as many first values.
        steps: of each sequence; as many iterations.
        share: of states in the data.
        discount: gamma.
    """

    seed: int = 5
    problems: int = 5
    sequences: int = 50
    steps: int = 20
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E2c"
    name: ClassVar[str] = "many-steps"
    corrected: ClassVar[str] = (
        "With P(s'|s,a) <= C d(s') for all pairs, C >= 1, P(s_k|s,a) <= C d(s_k) for every k, and |Q^k - Q*|(s,a) <= "
        "gamma^k C sum_s d(s) max_{a in Pi(s)} |Q^0 - Q*|(s,a)."
    )
    printed: ClassVar[str] = (
        "The ratio is said to shrink as eps^k, and a sum of ratios over |S| states is bounded by the bound on one; it "
        "cannot fall below 1."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        ratios, last, errors, constants = [], [], [], []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            states, behaviour = len(mdp.rewards), uniform_policy(mdp)
            distribution = state_distribution(mdp, behaviour, np.full(states, 1.0 / states))
            allowed = outcome_supported(mdp.transitions, random_support(rng, states, self.share))
            c, limit = constant(mdp.transitions, distribution), fixed_point(mdp, allowed)
            constants.append(c)
            for _ in range(self.sequences):
                policies = [random_policy(rng, allowed) for _ in range(self.steps - 1)]
                each = [constant(outcomes, distribution) for outcomes in outcomes_of_steps(mdp, policies)]
                ratios.append(max(each[1:]) / c)
                last.append(each[-1])
                q = limit + 10.0 * rng.normal(size=limit.shape)
                first = q - limit
                for k in range(1, self.steps + 1):
                    q = iterate(q, mdp, allowed, 1)
                    most = iteration_error(k, first, allowed, distribution, c, self.discount)
                    errors.append(np.abs(q - limit).max() / most)
        largest, worst, least = float(max(ratios)), float(max(errors)), float(min(last))
        return Findings(
            (
                Check(
                    "corrected",
                    f"largest ratio after 2 to {self.steps} steps, over C",
                    largest,
                    "<= 1",
                    verdict(largest <= 1.0 + 1e-9),
                ),
                Check(
                    "corrected",
                    "largest |Q^k - Q*|(s,a) over gamma^k C E_d max |Q^0 - Q*|",
                    worst,
                    "<= 1",
                    verdict(worst <= 1.0 + 1e-9, worst),
                ),
                Check(
                    "printed",
                    f"smallest largest ratio after {self.steps} steps",
                    least,
                    "< 1, as eps^k",
                    verdict(least < 1.0),
                ),
            ),
            {"problems": self.problems, "sequences": self.problems * self.sequences},
            {"constants": constants},
        )
