"""Models of the next state, pre-trained on the log: s' ~ P(s, a), in normalised units."""

from odaf.components.dynamics.base import DynamicsConfig as DynamicsConfig
from odaf.components.dynamics.base import DynamicsModel as DynamicsModel
from odaf.components.dynamics.build import untrained as untrained
from odaf.components.dynamics.fit import fit_dynamics as fit_dynamics
from odaf.components.dynamics.transition_ensemble import TransitionEnsemble as TransitionEnsemble
from odaf.components.dynamics.transition_fit import EnsembleConfig as EnsembleConfig
from odaf.components.dynamics.transition_fit import fit_transitions as fit_transitions
