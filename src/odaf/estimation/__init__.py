"""What a policy is worth, told from a log that it did not learn from, without a simulator."""

from odaf.estimation.estimate import ESTIMATORS, Method, estimate, estimate_many
from odaf.estimation.halving import Halving, Rung, train_halving
from odaf.estimation.select import Candidate, RunWorth, Selection, select
from odaf.estimation.settings import Acting, EstimateSettings
from odaf.estimation.valuation import Interval, Valuation, ValueEstimate

__all__ = [
    "ESTIMATORS",
    "Acting",
    "Candidate",
    "EstimateSettings",
    "Halving",
    "Interval",
    "Method",
    "RunWorth",
    "Rung",
    "Selection",
    "Valuation",
    "ValueEstimate",
    "estimate",
    "estimate_many",
    "select",
    "train_halving",
]
