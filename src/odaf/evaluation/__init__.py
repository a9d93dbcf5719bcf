"""How good a policy is, and how sure that is."""

from odaf.evaluation.rollouts import Episodes, RolloutEvaluator, Rollouts, rollout
from odaf.evaluation.runs import Run
from odaf.evaluation.scores import Scores
from odaf.evaluation.statistics import (
    Difference,
    Estimate,
    Improvement,
    bootstrap_interval,
    difference,
    improvement,
    paired_difference,
    t_interval,
)
from odaf.training.policy import Policy

__all__ = [
    "Difference",
    "Episodes",
    "Estimate",
    "Improvement",
    "Policy",
    "RolloutEvaluator",
    "Rollouts",
    "Run",
    "Scores",
    "bootstrap_interval",
    "difference",
    "improvement",
    "paired_difference",
    "rollout",
    "t_interval",
]
