"""What a run is worth: its last checkpoint, seed by seed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from odaf.environments.reference_returns import normalised_score
from odaf.errors import CheckpointError
from odaf.evaluation.statistics import Estimate, t_interval


@dataclass(frozen=True)
class SeedScore:
    """One seed's evaluation at its last checkpoint; never its best.

    Attributes:
        seed: the training seed.
        step: updates the policy had seen.
        mean_return: over the evaluation episodes.
        std_return: over the evaluation episodes, divisor N.
        rates: shares of episodes, by name, such as `success_rate`.
        returns: of each episode; NaN for one that broke off on a number that is not finite, which no mean counts.
        by_episode: for each fact that is kept of every episode, such as `lengths` or `success`: one entry an episode.
    """

    seed: int
    step: int
    mean_return: float
    std_return: float
    rates: dict[str, float]
    returns: tuple[float, ...]
    by_episode: Mapping[str, Sequence[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Scores:
    """Last-checkpoint scores of all seeds of a run.

    Attributes:
        by_seed: one entry a seed.
        environment: Gymnasium's name of where they were played, if it has one.
        simulator: what played them, as `odaf.environments.contact_margins.simulator_of` says; None where none is known.
        notes: what must be known beside the numbers: broken episodes, an environment that ignores its seed.
    """

    by_seed: tuple[SeedScore, ...]
    environment: str | None = None
    simulator: Mapping[str, Any] | None = None
    notes: tuple[str, ...] = ()

    def estimate(self, confidence: float = 0.95) -> Estimate:
        """Mean over seeds of their mean returns, spread over seeds, and Student's interval; all NaN where a seed has no
        sound episode."""
        means = [score.mean_return for score in self.by_seed]
        if not all(map(math.isfinite, means)):
            return Estimate(math.nan, math.nan, math.nan, math.nan, confidence, len(means))
        return t_interval(means, confidence)

    @property
    def mean(self) -> float:
        """Mean over seeds of their mean returns."""
        return self.estimate().mean

    @property
    def std(self) -> float:
        """Standard deviation over seeds (divisor n - 1) of their mean returns; NaN for one seed."""
        return self.estimate().std

    @property
    def normalised(self) -> dict[str, Any] | None:
        """Normalised score with its environment version and raw return; None without reference returns."""
        if self.environment is None:
            return None
        return normalised_score(self.environment, [score.mean_return for score in self.by_seed])

    def rate(self, name: str) -> float | None:
        """Mean over seeds of a rate such as `success_rate`; None if the environment does not report it."""
        rates = [score.rates.get(name) for score in self.by_seed]
        known = [rate for rate in rates if rate is not None]
        return sum(known) / len(known) if known and len(known) == len(rates) else None

    def to_dict(self) -> dict[str, Any]:
        """JSON types: the estimate, rates, and every seed."""
        estimate = self.estimate()
        names = sorted({name for score in self.by_seed for name in score.rates})
        normalised = self.normalised
        return {
            **({} if normalised is None else {"normalised": normalised}),
            **({} if self.simulator is None else {"simulator": dict(self.simulator)}),
            "mean_return": estimate.mean,
            "std_return": estimate.std,
            "interval": [estimate.low, estimate.high],
            "confidence": estimate.confidence,
            **{name: self.rate(name) for name in names},
            **({"notes": list(self.notes)} if self.notes else {}),
            "seeds": {
                str(score.seed): {
                    "step": score.step,
                    "mean_return": score.mean_return,
                    "std_return": score.std_return,
                    **score.rates,
                    "returns": list(score.returns),
                    **{name: list(values) for name, values in score.by_episode.items()},
                }
                for score in self.by_seed
            },
        }

    def __str__(self) -> str:
        without = [str(score.seed) for score in self.by_seed if not math.isfinite(score.mean_return)]
        if without:
            return (
                f"no mean return: every episode of seeds {', '.join(without)} broke off on a number that is not finite"
            )
        return f"return {self.estimate()} over {len(self.by_seed)} seeds"


def scores_from(summaries: Mapping[int, Mapping[str, Any]], where: str, environment: str | None = None) -> Scores:
    """Scores from each seed's `summary.json`.

    Raises:
        CheckpointError: a seed has not been evaluated yet.
    """
    missing = [seed for seed, summary in summaries.items() if not summary.get("evaluation")]
    if missing:
        raise CheckpointError(
            f"{where}: no evaluation of seeds {', '.join(map(str, missing))} yet; "
            "train with evaluation, go on with `odaf resume`, or measure checkpoints with `odaf evaluate`"
        )
    simulators = [summary["evaluation"].get("simulator") for summary in summaries.values()]
    alike = simulators[0] if all(simulator == simulators[0] for simulator in simulators) else None
    scores = tuple(_score(seed, summary["evaluation"]) for seed, summary in summaries.items())
    return Scores(scores, environment, alike)


def _score(seed: int, evaluation: Mapping[str, Any]) -> SeedScore:
    return SeedScore(
        seed=seed,
        step=evaluation["step"],
        mean_return=_number(evaluation["mean_return"]),
        std_return=_number(evaluation["std_return"]),
        rates={name: rate for name, rate in evaluation.items() if name.endswith("_rate")},
        returns=tuple(_number(value) for value in evaluation["returns"]),
        by_episode=evaluation.get("by_episode", {}),
    )


def _number(value: float | None) -> float:
    """A number as JSON keeps it, where one that is not finite is null."""
    return math.nan if value is None else value
