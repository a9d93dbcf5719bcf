"""E2, pair by pair: a pair with many rows whose successor has an action with hardly any."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.bound import error_bound, local_errors, printed_bound, propagated_errors
from odaf.theory.empirical import draw_logs
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import TabularMDP, state_distribution
from odaf.theory.operator import fixed_point

START, FORK, GOOD, BAD = range(4)


def fork(discount: float) -> TabularMDP:
    """START leads to FORK; there action 0 ends in BAD, action 1 in GOOD or BAD with equal odds. GOOD pays 1 a step."""
    transitions, rewards = np.zeros((4, 2, 4)), np.zeros((4, 2))
    transitions[START, :, FORK] = transitions[FORK, 0, BAD] = 1.0
    transitions[FORK, 1, [GOOD, BAD]] = 0.5
    transitions[GOOD, :, GOOD] = transitions[BAD, :, BAD] = 1.0
    rewards[GOOD] = 1.0
    return TabularMDP(transitions, rewards, discount)


@dataclass(frozen=True)
class RareAction(Experiment):
    """Every outcome is in the data, so every action is admissible; the best one is in two rows of a million.

    Attributes:
        seed: of everything drawn.
        draws: logs.
        rows: N, of a log.
        rare: expected rows of the rare action.
        delta: the share of logs for which a bound may fail.
        discount: gamma.
    """

    seed: int = 3
    draws: int = 1_000
    rows: int = 10**6
    rare: float = 2.0
    delta: float = 0.1
    discount: float = 0.9

    label: ClassVar[str] = "E2"
    name: ClassVar[str] = "rare-action"
    corrected: ClassVar[str] = (
        "The error of a pair is at most the value, in the learned problem, of the local errors of all that follows. A "
        "bound by counts therefore needs the rarest admissible pair, and says nothing where the log has no rows of it: "
        "of the very actions that the outcome-driven set adds to the logged ones."
    )
    printed: ClassVar[str] = (
        "A bound for (s,a) by the rows of (s,a) alone, though errors come in from all that follows; V_max in the place "
        "of R_max does not mend it."
    )

    def measure(self) -> Findings:
        rng, mdp = np.random.default_rng(self.seed), fork(self.discount)
        allowed, policy = np.ones((4, 2), bool), np.full((4, 2), 0.5)
        # A hundredth of the log begins in GOOD, so that this state is known and the rare action alone is not.
        start = 0.99 * np.eye(4)[START] + 0.01 * np.eye(4)[GOOD]
        visits = state_distribution(mdp, policy, start)[FORK]  # the same whatever is done there
        policy[FORK] = np.array([0.0, 1.0]) * self.rare / (self.rows * visits)
        policy[FORK, 0] = 1.0 - policy[FORK, 1]
        pairs = state_distribution(mdp, policy, start)[:, None] * policy
        logs, exact = draw_logs(rng, mdp, pairs, self.rows, self.draws), fixed_point(mdp, allowed)
        errors = np.abs(fixed_point(logs.mdp, allowed) - exact)

        local = local_errors(exact, mdp, logs.mdp, allowed)
        limits = propagated_errors(local, logs.mdp, allowed)
        above = float((errors - limits).max())
        bound = error_bound(logs.counts, mdp, self.delta)
        violated = float((errors.max((1, 2)) > bound).mean())
        printed, mended = (
            float(printed_bound(self.rows, pairs, mdp, self.delta, largest)[START, 0])
            for largest in (None, mdp.largest_value)
        )
        at_start = errors[:, START, 0]
        failed, failed_mended = float((at_start > printed).mean()), float((at_start > mended).mean())
        limit = f"<= {self.delta:g}"
        return Findings(
            (
                Check(
                    "corrected",
                    "largest excess of a pair's error over the value of the local errors",
                    above,
                    "<= 1e-8",
                    verdict(above <= 1e-8),
                ),
                Check(
                    "corrected",
                    "share of logs that violate the bound by the rarest pair",
                    violated,
                    limit,
                    verdict(violated <= self.delta, float((errors.max((1, 2)) / bound).max())),
                ),
                Check(
                    "printed",
                    "share of logs that violate the bound for the pair at the start",
                    failed,
                    limit,
                    verdict(failed <= self.delta),
                ),
                Check(
                    "printed",
                    "the same with V_max in the place of R_max",
                    failed_mended,
                    limit,
                    verdict(failed_mended <= self.delta),
                ),
            ),
            {"logs": self.draws},
            {
                "printed_bound": printed,
                "printed_bound_with_largest_value": mended,
                "mean_error_at_start": float(at_start.mean()),
                "mean_bound_by_the_rarest_pair": float(bound.mean()),
            },
        )
