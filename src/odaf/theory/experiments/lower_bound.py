"""E5: what the learned policy is worth at least, told from the log."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from odaf.theory.bound import error_bound
from odaf.theory.candidates import outcome_supported
from odaf.theory.empirical import draw_logs
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import TabularMDP, policy_values, random_mdp, random_support, state_distribution, uniform_policy
from odaf.theory.operator import fixed_point, greedy, state_values


@dataclass(frozen=True)
class LowerBound(Experiment):
    """The greedy policy of the learned values, evaluated exactly in the true problem.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        draws: logs of each size from each problem.
        sizes: N, rows of a log.
        delta: the share of logs for which the bound may fail.
        share: of states in the data.
        discount: gamma.
    """

    seed: int = 8
    problems: int = 10
    draws: int = 20
    sizes: tuple[int, ...] = (10**3, 10**4, 10**5, 10**6, 10**7, 10**8)
    delta: float = 0.1
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E5"
    name: ClassVar[str] = "lower-bound"
    corrected: ClassVar[str] = (
        "With probability 1 - delta, V^pi(s) >= V_hat(s) - gamma V_max / (1 - gamma) max_(s,a) e(n(s,a)) in every "
        "state, for the greedy policy pi of Q_hat*."
    )
    printed: ClassVar[str] = (
        "The bound of the main theorem is called a lower bound of performance. It is one of values; and where "
        "it lies below 0, as for small logs, any policy earns more."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        found: dict[int, list[dict[str, Any]]] = {rows: [] for rows in self.sizes}
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            allowed = outcome_supported(mdp.transitions, random_support(rng, len(mdp.rewards), self.share))
            for rows in self.sizes:
                found[rows].append(self._logs(rng, mdp, allowed, rows))
        by_size = {
            rows: {name: np.concatenate([each[name] for each in problems]) for name in problems[0]}
            for rows, problems in found.items()
        }
        step = float(max(each["difference_of_step"].max() for each in by_size.values()))
        closest = float(max(each["difference_of_bound"].max() for each in by_size.values()))
        failed = float(max((each["difference_of_bound"] > 1.0 + 1e-6).mean() for each in by_size.values()))
        return Findings(
            (
                Check(
                    "corrected",
                    "largest |V_hat - V^pi| over |(P_hat - P) V_hat| gamma / (1 - gamma), the proof's first step",
                    step,
                    "<= 1",
                    verdict(step <= 1.0 + 1e-6, step),
                ),
                Check(
                    "corrected",
                    f"share of logs with a state worth less than promised; at most {closest:.2g} of it is reached",
                    failed,
                    f"<= {self.delta:g}",
                    verdict(failed <= self.delta, closest),
                ),
            ),
            {"problems": self.problems, "logs": self.problems * self.draws * len(self.sizes)},
            {
                "by_size": {
                    str(rows): {f"mean_{name}": float(each[name].mean()) for name in ("promise_above_0", "loss")}
                    for rows, each in by_size.items()
                }
            },
        )

    def _logs(self, rng: np.random.Generator, mdp: TabularMDP, allowed: np.ndarray, rows: int) -> dict[str, Any]:
        """What the greedy policies of all logs of one size from one problem are worth, beside what was promised."""
        states, behaviour = len(mdp.rewards), uniform_policy(mdp)
        pairs = state_distribution(mdp, behaviour, np.full(states, 1.0 / states))[:, None] * behaviour
        logs = draw_logs(rng, mdp, pairs, rows, self.draws)
        q = fixed_point(logs.mdp, allowed)
        estimated, policy = state_values(q, allowed), greedy(q, allowed)
        true, bound = policy_values(mdp, policy), error_bound(logs.counts, mdp, self.delta)
        best = state_values(fixed_point(mdp, allowed), allowed)
        wrong = (logs.mdp.transitions - mdp.transitions) @ estimated[:, None, :, None]
        followed = np.take_along_axis(wrong[..., 0], policy[..., None], -1)
        step = np.abs(followed).max((1, 2)) * self.discount / (1.0 - self.discount)
        return {
            "difference_of_step": np.abs(estimated - true).max(1) / (step + 1e-9),
            "difference_of_bound": (estimated - true).max(1) / bound,
            "promise_above_0": (estimated > bound[:, None]).mean(1),
            "loss": (best - true).max(1),
        }
