"""Models of the next state, pre-trained on the log: s' ~ P(s, a), in normalised units."""

from odaf.components.dynamics.base import DynamicsConfig as DynamicsConfig
from odaf.components.dynamics.base import DynamicsModel as DynamicsModel
from odaf.components.dynamics.build import untrained as untrained
from odaf.components.dynamics.fit import fit_dynamics as fit_dynamics
