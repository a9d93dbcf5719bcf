"""What an experiment on the theory is: a statement as it can be proved, as the paper prints it, and checks of both."""

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

Verdict = Literal["held", "not held", "says nothing"]
"""`says nothing`: the check was far from failing, so that passing it is no evidence."""


@dataclass(frozen=True)
class Check:
    """One figure and what it decides.

    Attributes:
        of: which form of the statement it is about.
        what: what was measured.
        figure: the number.
        criterion: what it was held against.
        verdict: what follows for the statement.
    """

    of: Literal["corrected", "printed"]
    what: str
    figure: float
    criterion: str
    verdict: Verdict


@dataclass(frozen=True)
class Findings:
    """What an experiment found.

    Attributes:
        checks: of the corrected statement first.
        repetitions: how many problems, logs and so on the figures are over.
        details: further figures, as JSON types.
    """

    checks: tuple[Check, ...]
    repetitions: Mapping[str, int]
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether the corrected statement held: none of its checks failed, and one at least could have."""
        verdicts = [check.verdict for check in self.checks if check.of == "corrected"]
        return "held" in verdicts and "not held" not in verdicts


class Experiment(abc.ABC):
    """A statement put to the test. Concrete ones are frozen dataclasses whose fields decide every figure."""

    label: ClassVar[str]
    """As on the page: E1 to E6."""
    name: ClassVar[str]
    """Of its record."""
    corrected: ClassVar[str]
    """The statement as it can be proved, in a sentence."""
    printed: ClassVar[str]
    """What the paper prints in its place, and what is wrong with that."""

    @abc.abstractmethod
    def measure(self) -> Findings:
        """Runs it; equal settings give equal findings."""


def verdict(holds: bool, closest: float = 1.0) -> Verdict:
    """What follows from a check.

    Args:
        holds: whether the figure meets its criterion.
        closest: of a bound, the largest share of it that was reached. A bound of which less than a fifth was reached
            would hold at a fifth of its size too, and in many wrong forms: that says nothing.
    """
    if not holds:
        return "not held"
    return "held" if closest >= 0.2 else "says nothing"
