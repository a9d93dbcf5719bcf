"""The experiments on the theory, in the order of the page that lays their figures beside the statements."""

from odaf.theory.experiments.contraction import Contraction
from odaf.theory.experiments.coverage import Coverage
from odaf.theory.experiments.equivalence import Equivalence
from odaf.theory.experiments.error_bound import ErrorBound
from odaf.theory.experiments.experiment import Check, Experiment, Findings
from odaf.theory.experiments.flexibility import Flexibility
from odaf.theory.experiments.impossible_ratio import ImpossibleRatio
from odaf.theory.experiments.lower_bound import LowerBound
from odaf.theory.experiments.many_steps import ManySteps
from odaf.theory.experiments.rare_action import RareAction
from odaf.theory.experiments.trap import Trap

__all__ = [
    "EXPERIMENTS",
    "Check",
    "Contraction",
    "Coverage",
    "Equivalence",
    "ErrorBound",
    "Experiment",
    "Findings",
    "Flexibility",
    "ImpossibleRatio",
    "LowerBound",
    "ManySteps",
    "RareAction",
    "Trap",
]

EXPERIMENTS: tuple[Experiment, ...] = (
    Contraction(),
    ErrorBound(),
    RareAction(),
    ImpossibleRatio(),
    ManySteps(),
    Equivalence(),
    Flexibility(),
    Trap(),
    LowerBound(),
    Coverage(),
)
"""All of them, with the settings of the study."""
