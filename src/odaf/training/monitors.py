"""Watching a run for the ways in which offline training fails, and naming the option that helps."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from odaf.components.targets import value_range
from odaf.data.spec import Spec


@dataclass(frozen=True)
class TrainingWarning:
    """One finding, made once a seed.

    Attributes:
        kind: `not-finite`, `above-range`, `below-range` or `temperature`.
        step: the update at which it was seen first.
        message: what was seen, the likely cause, and the option that helps.
    """

    kind: str
    step: int
    message: str

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `TrainingWarning(**fields)` restores it."""
        return {"kind": self.kind, "step": self.step, "message": self.message}


def value_bounds(spec: Spec, discount: float, reward_shift: float = 0.0) -> tuple[float, float]:
    """The range of values that the logged rewards allow, widened to hold 0, where fresh critics start.

    Args:
        spec: the task.
        discount: the learner's.
        reward_shift: what the learner adds to every logged reward.
    """
    shifted = dataclasses.replace(
        spec, reward_min=spec.reward_min + reward_shift, reward_max=spec.reward_max + reward_shift
    )
    low, high = map(float, value_range(shifted, discount))
    return min(low, 0.0), max(high, 0.0)


@dataclass
class DivergenceMonitor:
    """Compares the metrics of each stretch with what the rewards allow.

    Attributes:
        spec: the task; its rewards bound every right value.
        discount: the learner's; None for one that has no use for later rewards and so claims no values.
        settings: the learner's resolved config, so that only options which are not yet in use are recommended.
        slack: how far outside the range a critic may go, as a share of the range's width, before it is reported. The
            entropy bonus and the error of a critic in training move values a little past the bounds without harm.
        temperature_limit: entropy temperature above which it is reported; it starts at 1 and normally falls.
        seen: kinds already reported.
    """

    spec: Spec
    discount: float | None
    settings: Mapping[str, Any]
    slack: float = 0.1
    temperature_limit: float = 10.0
    seen: set[str] = field(default_factory=set)

    def observe(self, step: int, metrics: Mapping[str, float]) -> list[TrainingWarning]:
        """Warnings that the stretch ending at `step` gives for the first time."""
        found = [
            TrainingWarning(kind, step, message)
            for kind, message in self._findings(step, metrics)
            if kind not in self.seen
        ]
        self.seen.update(warning.kind for warning in found)
        return found

    def _bounds(self, discount: float) -> tuple[float, float]:
        return value_bounds(self.spec, discount, float(self.settings.get("reward_shift", 0.0)))

    def _findings(self, step: int, metrics: Mapping[str, float]) -> list[tuple[str, str]]:
        broken = sorted(name for name, value in metrics.items() if not math.isfinite(value))
        if broken:
            message = (
                f"update {step:,}: {', '.join(broken)} is not a finite number. The parameters are lost from here on. "
                "Likely cause: values grew without bound, or steps are too large. "
                + self._advice(lower_learning_rate=True)
            )
            return [("not-finite", message)]

        findings = []
        low, high = (-math.inf, math.inf) if self.discount is None else self._bounds(self.discount)
        slack = self.slack * (high - low)
        allowed = f"the logged rewards allow values from {low:,.4g} to {high:,.4g}"
        highest, lowest = metrics.get("critic/max"), metrics.get("critic/min")
        if highest is not None and highest > high + slack:
            message = (
                f"update {step:,}: critic/max is {highest:,.4g}, but {allowed}. Likely cause: the critics trust "
                "actions that the log does not hold, and their targets feed on it. "
            )
            findings.append(("above-range", message + self._advice(entropy=True, pessimism=True)))
        if lowest is not None and lowest < low - slack:
            message = (
                f"update {step:,}: critic/min is {lowest:,.4g}, but {allowed}. Likely cause: pessimism that feeds on "
                "itself, such as an unbounded pessimistic target or a high entropy temperature. "
            )
            findings.append(("below-range", message + self._advice(entropy=True, less_pessimism=True)))
        temperature = metrics.get("temperature/value")
        if temperature is not None and temperature > self.temperature_limit:
            message = (
                f"update {step:,}: temperature/value is {temperature:,.4g}, above {self.temperature_limit:g}. Likely "
                "cause: the actor's entropy stays below its target because the critics' slopes are too steep for it. "
            )
            findings.append(("temperature", message + self._advice(entropy=True)))
        return findings

    def _advice(
        self,
        *,
        entropy: bool = False,
        pessimism: bool = False,
        less_pessimism: bool = False,
        lower_learning_rate: bool = False,
    ) -> str:
        # Only what this learner has and does not use yet.
        options = [
            f'{name}="{helpful}"' if isinstance(helpful, str) else f"{name}={helpful}"
            for name, helpful in (("critic_norm", "layer"), ("value_range", "auto"), ("entropy_in_backup", False))
            if _setting(self.settings, name) not in (None, helpful) and (entropy or name != "entropy_in_backup")
        ]
        if pessimism and "terms" in self.settings:
            options.append(
                "a term that lowers values of actions outside the log (OODPessimism), or a larger weight of it"
            )
        if less_pessimism:
            options.append("a smaller weight of the pessimistic term, if there is one")
        if lower_learning_rate or not options:
            options.append("a smaller learning rate")
        return "What helps: " + "; ".join(options) + "."


def _setting(settings: Any, name: str) -> Any:
    # The learner decides where in its config an option lives; the outermost one of this name counts.
    if not isinstance(settings, Mapping):
        return None
    if name in settings:
        return settings[name]
    for value in settings.values():
        found = _setting(value, name)
        if found is not None:
            return found
    return None
