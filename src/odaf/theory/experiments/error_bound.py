"""E2: how far the values learned from a log are from the exact ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from odaf.theory.bound import error_bound, iteration_error, l1_radius, local_errors, printed_bound
from odaf.theory.candidates import outcome_supported
from odaf.theory.empirical import draw_logs
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.mdp import TabularMDP, random_mdp, random_support, state_distribution, uniform_policy
from odaf.theory.operator import fixed_point, iterate


@dataclass(frozen=True)
class ErrorBound(Experiment):
    """Logs of a uniform behaviour, of 1,000 rows and up; the candidate set is that of the true problem.

    Attributes:
        seed: of everything drawn.
        problems: random problems.
        draws: logs of each size from each problem.
        sizes: N, rows of a log.
        k: iterations of the learned operator, from zeros.
        delta: the share of logs for which the bound may fail.
        share: of states in the data.
        discount: gamma.
    """

    seed: int = 2
    problems: int = 10
    draws: int = 20
    sizes: tuple[int, ...] = (10**3, 10**4, 10**5, 10**6, 10**7, 10**8)
    k: int = 200
    delta: float = 0.1
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E2"
    name: ClassVar[str] = "error-bound"
    corrected: ClassVar[str] = (
        "With probability 1 - delta, |Q_hat^k - Q*|_inf <= gamma V_max / (1 - gamma) max_(s,a) min(2, sqrt(2/n(s,a) "
        "log(|S| |A| 2^|S| / delta))) + gamma^k |Q_hat^0 - Q_hat*|_inf; the error falls as N^-1/2."
    )
    printed: ClassVar[str] = (
        "R_max stands where values reach V_max = R_max / (1 - gamma), an expected count where a count belongs, and "
        "the bound is claimed for each pair by itself; it is too loose here for that to show."
    )

    def measure(self) -> Findings:
        rng = np.random.default_rng(self.seed)
        found: dict[int, list[dict[str, Any]]] = {rows: [] for rows in self.sizes}
        beyond = []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            support = random_support(rng, len(mdp.rewards), self.share)
            allowed = outcome_supported(mdp.transitions, support)
            exact = fixed_point(mdp, allowed)
            beyond.append(exact.max() / mdp.rewards.max())
            for rows in self.sizes:
                found[rows].append(self._logs(rng, mdp, allowed, exact, rows))
        by_size = {rows: self._of_size(problems) for rows, problems in found.items()}
        return self._findings(by_size, float(max(beyond)))

    def _logs(
        self, rng: np.random.Generator, mdp: TabularMDP, allowed: np.ndarray, exact: np.ndarray, rows: int
    ) -> dict[str, Any]:
        """Errors and bounds of all logs of one size from one problem."""
        policy, states = uniform_policy(mdp), len(exact)
        pairs = state_distribution(mdp, policy, np.full(states, 1.0 / states))[:, None] * policy
        logs = draw_logs(rng, mdp, pairs, rows, self.draws)
        start = np.zeros((self.draws, *exact.shape))
        second = iteration_error(self.k, start, fixed_point(logs.mdp, allowed), self.discount)
        errors = np.abs(iterate(start, logs.mdp, allowed, self.k) - exact)
        largest = errors.max((1, 2))
        step = local_errors(exact, mdp, logs.mdp, allowed).max((1, 2)) / (1.0 - self.discount) + second
        apart = np.abs(logs.mdp.transitions - mdp.transitions).sum(-1)
        radius = l1_radius(logs.counts, states, exact.size, self.delta)
        bound = error_bound(logs.counts, mdp, self.delta) + second
        # The printed second term asks for what cannot be; with the corrected one the first is judged alone.
        printed = printed_bound(rows, pairs, mdp, self.delta) + second[:, None, None]
        return {
            "error": largest,
            "bound": bound,
            "error_of_bound": largest / bound,
            "error_of_printed_bound": (errors / printed).max((1, 2)),
            "error_of_first_step": largest / step,
            "distance_of_radius": (apart / radius).max((1, 2)),
            "printed_bound": printed.max((1, 2)),
        }

    def _of_size(self, problems: list[dict[str, Any]]) -> dict[str, float]:
        """Means and largest figures over all logs of one size, and the shares in which a bound was exceeded."""
        columns = {name: np.concatenate([each[name] for each in problems]) for name in problems[0]}
        means = {f"mean_{name}": float(columns[name].mean()) for name in ("error", "bound", "printed_bound")}
        ratios = [name for name in columns if "_of_" in name]
        return {
            **means,
            "mean_slack": float((columns["bound"] / columns["error"]).mean()),
            "mean_printed_slack": float((columns["printed_bound"] / columns["error"]).mean()),
            **{f"largest_{name}": float(columns[name].max()) for name in ratios},
            **{f"share_with_{name}_above_1": float((columns[name] > 1.0 + 1e-6).mean()) for name in ratios},
        }

    def _findings(self, by_size: Mapping[int, Mapping[str, float]], beyond: float) -> Findings:
        logarithms = [np.log(by_size[rows]["mean_error"]) for rows in self.sizes]
        slope = float(np.polyfit(np.log(self.sizes), logarithms, 1)[0])
        step = max(each["largest_error_of_first_step"] for each in by_size.values())

        def share(of: Literal["corrected", "printed"], what: str, ratio: str) -> Check:
            """The largest share of logs, of any size, in which a bound that may fail with delta was exceeded."""
            closest = max(each[f"largest_{ratio}"] for each in by_size.values())
            most = max(each[f"share_with_{ratio}_above_1"] for each in by_size.values())
            said = verdict(most <= self.delta, closest)
            return Check(of, f"{what}; at most {closest:.2g} of it is reached", most, f"<= {self.delta:g}", said)

        return Findings(
            (
                Check(
                    "corrected",
                    "largest error over |T_hat Q* - T Q*| / (1 - gamma), the proof's first step",
                    step,
                    "<= 1",
                    verdict(step <= 1.0 + 1e-6, step),
                ),
                share("corrected", "share of logs with a |P_hat - P|_1 above e(n)", "distance_of_radius"),
                Check(
                    "corrected",
                    "slope of the logarithm of the mean error over that of N",
                    slope,
                    "-0.65 to -0.35",
                    verdict(-0.65 <= slope <= -0.35),
                ),
                share("corrected", "share of logs that violate the bound", "error_of_bound"),
                share("printed", "share of logs with a pair that violates the first term", "error_of_printed_bound"),
                Check("printed", "largest value over R_max", beyond, "<= 1", verdict(beyond <= 1.0)),
            ),
            {"problems": self.problems, "logs": self.problems * self.draws * len(self.sizes)},
            {"slope": slope, "by_size": {str(rows): dict(each) for rows, each in by_size.items()}},
        )
