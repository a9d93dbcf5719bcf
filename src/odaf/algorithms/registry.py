"""Learners by the name that configuration files use."""

from odaf.algorithms.base import Algorithm
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC

ALGORITHMS: dict[str, type[Algorithm]] = {algorithm.kind: algorithm for algorithm in (EnsembleSAC, BehaviourCloning)}
