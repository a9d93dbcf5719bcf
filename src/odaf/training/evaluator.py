"""What the training loop asks of whoever measures its policies; the loop itself knows no environments."""

from concurrent.futures import Future
from dataclasses import dataclass, field
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
        warnings: what the user must know about it, a sentence a kind; a run says each kind once.
    """

    metrics: dict[str, float | int]
    summary: dict[str, Any]
    headline: float
    warnings: dict[str, str] = field(default_factory=dict)


@runtime_checkable
class Evaluator(Protocol):
    """Measures a policy between two stretches of training.

    Must not keep the policy after the call, and must give the same result whenever it is called with the same policy,
    because a resumed run repeats evaluations that came after its checkpoint.
    """

    @property
    def every(self) -> int:
        """Updates between two evaluations; the last update is always followed by one."""
        ...

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        """Evaluates `policy`, trained for `step` updates; may write its details below `directory`."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Its settings as plain JSON types, for `config.json`."""
        ...


@runtime_checkable
class EvaluatorBeside(Evaluator, Protocol):
    """Measures policies in other processes, while training goes on."""

    def submit(self, policy: Policy, directory: Path, step: int) -> "Future[Evaluation]":
        """Begins what a call would do; the policy is not needed any more when this returns."""
        ...
