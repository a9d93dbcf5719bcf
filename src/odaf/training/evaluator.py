"""What the training loop asks of whoever measures its policies; the loop itself knows no environments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from odaf.training.policy import Policy


@dataclass(frozen=True)
class Evaluation:
    """What one evaluation found.

    Attributes:
        metrics: numbers for the line in `metrics.jsonl`, named `evaluation/...`.
        summary: JSON-able record for `summary.json`, without the step.
        headline: one number for the progress bar.
    """

    metrics: dict[str, float | int]
    summary: dict[str, Any]
    headline: float


@runtime_checkable
class Evaluator(Protocol):
    """Measures a policy between two stretches of training.

    Must not keep the policy after the call, and must give the same result whenever it is called with the same policy,
    because a resumed run repeats evaluations that came after its checkpoint.
    """

    every: int  # updates between two evaluations; the last step is always evaluated

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        """Evaluates `policy`, trained for `step` updates; may write its details below `directory`."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Its settings as plain JSON types, for `config.json`."""
        ...
