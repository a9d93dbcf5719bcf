"""E6: the corollary, that covering the optimal policy's states makes the fixed point the optimal values."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.candidates import leak, outcome_supported
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import random_mdp, state_distribution
from odaf.theory.operator import fixed_point, greedy, state_values


@dataclass(frozen=True)
class Coverage(Experiment):
    """The data are the states that the optimal policy visits from a start, and half of the others.

    Transitions are sparser than elsewhere, so that the policy does not visit every state.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        others: share of the other states that are in the data too.
        concentration: of the Dirichlet transitions.
        smallest: probability that is not set to 0.
        discount: gamma.
    """

    seed: int = 9
    problems: int = 200
    others: float = 0.5
    concentration: float = 0.01
    smallest: float = 0.1
    discount: float = 0.9

    label: ClassVar[str] = "E6"
    name: ClassVar[str] = "coverage"
    corrected: ClassVar[str] = (
        "If the data have every state that an optimal policy visits from the start, V_outcome = V* in these states; "
        "elsewhere V_outcome <= V*."
    )
    printed: ClassVar[str] = (
        "That coverage is said to put the optimal policy into Pi and to make the fixed point Q*. Pi asks its outcomes "
        "to be in the data from every state of the data, also from those that it never visits."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        on_path, above, within, everywhere, shares = [], [], [], [], []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount, concentration=self.concentration, smallest=self.smallest)
            states, actions = mdp.rewards.shape
            every = np.ones((states, actions), bool)
            optimal = fixed_point(mdp, every)
            policy = greedy(optimal, every)
            visits = state_distribution(mdp, np.eye(actions)[policy], np.eye(states)[0])
            visited = visits > 1e-12
            shares.append(visited.mean())
            support = visited | (rng.uniform(size=states) < self.others)
            allowed = outcome_supported(mdp.transitions, support)
            best, found = optimal.max(-1), state_values(fixed_point(mdp, allowed), allowed)
            on_path.append(np.abs(found - best)[visited].max())
            above.append((found - best).max())
            within.append((leak(mdp.transitions, support)[np.arange(states), policy] == 0.0)[support].all())
            everywhere.append(np.abs(found - best)[support].max() < 1e-6)
        apart, most = float(max(on_path)), float(max(above))
        inside, same = float(np.mean(within)), float(np.mean(everywhere))
        return Findings(
            (
                Check(
                    "corrected",
                    "largest |V_outcome - V*| where the optimal policy goes",
                    apart,
                    "< 1e-8",
                    verdict(apart < 1e-8),
                ),
                Check("corrected", "largest V_outcome - V* anywhere", most, "<= 1e-8", verdict(most <= 1e-8)),
                Check(
                    "printed",
                    "share of problems in which the optimal policy is in Pi",
                    inside,
                    "1",
                    verdict(inside == 1.0),
                ),
                Check(
                    "printed",
                    "share of problems with V_outcome = V* in all states of the data",
                    same,
                    "1",
                    verdict(same == 1.0),
                ),
            ),
            {"problems": self.problems},
            {"mean_share_of_states_visited": float(np.mean(shares))},
        )
