"""What the ensemble soft actor-critic carries from update to update, and what it is built around."""

import equinox as eqx
from jaxtyping import Array, Float, Int, PyTree

from odaf.algorithms.base import LearnerState
from odaf.components.critics import CriticEnsemble
from odaf.components.networks import MLP
from odaf.components.policies import GaussianActor
from odaf.components.priors import Priors
from odaf.components.trained import Trained


class WarmStart(eqx.Module):
    """Networks fitted to the log before the first update, see `odaf.algorithms.warm_start`."""

    actor: GaussianActor
    critics: CriticEnsemble
    log_entropy: Float[Array, ""]  # of the fitted actor at the logged actions, in nats


class Models(eqx.Module):
    """What is trained before the first update."""

    terms: tuple[PyTree, ...] = ()  # one entry an active term, () for one without a model
    warm_start: WarmStart | None = None


class EnsembleState(LearnerState):
    """State of the ensemble soft actor-critic."""

    step: Int[Array, ""]
    actor: Trained[GaussianActor]  # pi, and its slow copy pi'
    critics: Trained[MLP]  # Q_1..Q_K without their priors, and their slow copies Q'
    priors: Priors | None  # never trained, the same for the critics and their slow copies
    log_temperature: Trained[Float[Array, ""]]  # log alpha; no slow copy
    target_entropy: Float[Array, ""]  # H, in nats
    reward_scale: Float[Array, ""]
    value_bounds: Float[Array, "2"]  # of scaled rewards
    terms: tuple[PyTree, ...]  # one entry an active term: its frozen model, or what it remembers

    @property
    def online_critics(self) -> CriticEnsemble:
        """Q_1..Q_K."""
        return CriticEnsemble(self.critics.now, self.priors)

    @property
    def target_critics(self) -> CriticEnsemble:
        """Q'_1..Q'_K, the slow copies."""
        assert self.critics.slow is not None
        return CriticEnsemble(self.critics.slow, self.priors)

    @property
    def slow_actor(self) -> GaussianActor:
        """pi', the slow copy of the actor."""
        assert self.actor.slow is not None
        return self.actor.slow
