"""Terms that turn the plain ensemble soft actor-critic into its relatives. Each file holds one term's maths."""

from odaf.algorithms.terms.base import Context as Context
from odaf.algorithms.terms.base import Term as Term
from odaf.algorithms.terms.behaviour_distance import BehaviourDistance as BehaviourDistance
from odaf.algorithms.terms.conservative import Conservative as Conservative
from odaf.algorithms.terms.gradient_diversity import GradientDiversity as GradientDiversity
from odaf.algorithms.terms.inverse_dynamics_alignment import InverseDynamicsAlignment as InverseDynamicsAlignment
from odaf.algorithms.terms.inverse_dynamics_values import InverseDynamicsValues as InverseDynamicsValues
from odaf.algorithms.terms.ood_pessimism import OODPessimism as OODPessimism
from odaf.algorithms.terms.outcome_penalty import OutcomePenalty as OutcomePenalty
from odaf.algorithms.terms.policy_smoothing import PolicySmoothing as PolicySmoothing
from odaf.algorithms.terms.state_deviation import StateDeviation as StateDeviation
from odaf.algorithms.terms.value_smoothing import ValueSmoothing as ValueSmoothing

BUILT_IN: tuple[type[Term], ...] = (
    OutcomePenalty,
    OODPessimism,
    GradientDiversity,
    PolicySmoothing,
    ValueSmoothing,
    InverseDynamicsAlignment,
    InverseDynamicsValues,
    Conservative,
    StateDeviation,
    BehaviourDistance,
)
