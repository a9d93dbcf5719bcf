"""E1: the outcome-driven operator is a contraction, in sup norm."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.candidates import leak, outcome_supported
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import random_mdp, random_support
from odaf.theory.operator import backup, fixed_point


@dataclass(frozen=True)
class Contraction(Experiment):
    """Pairs Q, Q' of three scales in random problems with 80 % of the states in the data.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        pairs: of value functions, in each problem.
        scales: of their entries, in turn.
        starts: iterations that must meet in one fixed point.
        share: of states in the data.
        discount: gamma.
    """

    seed: int = 1
    problems: int = 20
    pairs: int = 100
    scales: tuple[float, ...] = (0.1, 1.0, 100.0)
    starts: int = 5
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E1"
    name: ClassVar[str] = "contraction"
    corrected: ClassVar[str] = (
        "In sup norm |T Q - T Q'| <= gamma |Q - Q'|, T is monotone, and its fixed point is unique, once every state "
        "has an admissible action (the least leaking one where there is no other)."
    )
    printed: ClassVar[str] = (
        "The candidate set may be empty at a state of the data, and the maximum over it undefined; the main proof "
        "then uses the contraction for a single pair (s,a), where there is none."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        ratios, shifts, single, apart, order, empty, admissible = [], [], [], [], [], [], []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            support = random_support(rng, len(mdp.rewards), self.share)
            allowed = outcome_supported(mdp.transitions, support)
            admissible.append(allowed.mean())
            empty.append(np.all(leak(mdp.transitions, support)[support] > 0.0, axis=-1).mean())

            scales = np.resize(self.scales, self.pairs)[:, None, None]
            q, other = scales * rng.normal(size=(2, self.pairs, *mdp.rewards.shape))
            before, after = np.abs(q - other), np.abs(backup(q, mdp, allowed) - backup(other, mdp, allowed))
            ratios.append((after.max((1, 2)) / before.max((1, 2))).max())
            single.append((after / before).max())
            shifted = backup(q + scales, mdp, allowed) - backup(q, mdp, allowed)
            shifts.append(np.abs(shifted / scales - self.discount).max())
            order.append((backup(np.minimum(q, other), mdp, allowed) - backup(q, mdp, allowed)).max())

            starts = 100.0 * rng.normal(size=(self.starts, *mdp.rewards.shape))
            apart.append(np.ptp(fixed_point(mdp, allowed, starts), axis=0).max())
        largest, sharp, split = float(max(ratios)), float(max(shifts)), float(max(apart))
        above, alone, none = float(max(order)), float(max(single)), float(np.mean(empty))
        limit = self.discount + 1e-9
        return Findings(
            (
                Check(
                    "corrected",
                    "largest ratio of sup norms",
                    largest,
                    f"<= {self.discount:g} + 1e-9",
                    verdict(largest <= limit),
                ),
                Check(
                    "corrected",
                    "largest distance of (T(Q + c) - T Q) / c from gamma: the factor is attained",
                    sharp,
                    "< 1e-9",
                    verdict(sharp < 1e-9),
                ),
                Check(
                    "corrected",
                    f"largest distance of fixed points from {self.starts} starts",
                    split,
                    "< 1e-6",
                    verdict(split < 1e-6),
                ),
                Check("corrected", "largest T Q - T Q' where Q <= Q'", above, "<= 1e-12", verdict(above <= 1e-12)),
                Check(
                    "printed",
                    "largest ratio for a single pair (s,a)",
                    alone,
                    f"<= {self.discount:g} + 1e-9",
                    verdict(alone <= limit),
                ),
                Check(
                    "printed", "share of states in the data without admissible action", none, "0", verdict(none == 0.0)
                ),
            ),
            {"problems": self.problems, "pairs": self.problems * self.pairs},
            {"admissible_share": float(np.mean(admissible))},
        )
