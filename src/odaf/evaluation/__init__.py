"""How good a policy is, and how sure that is."""

from odaf.evaluation.rollouts import Episodes, RolloutEvaluator, Rollouts, rollout
from odaf.evaluation.runs import Run
from odaf.evaluation.scores import Scores
from odaf.evaluation.statistics import Estimate, bootstrap_interval, paired_difference, t_interval
from odaf.training.policy import Policy

__all__ = [
    "Episodes",
    "Estimate",
    "Policy",
    "RolloutEvaluator",
    "Rollouts",
    "Run",
    "Scores",
    "bootstrap_interval",
    "paired_difference",
    "rollout",
    "t_interval",
]
