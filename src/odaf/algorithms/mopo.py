"""MOPO: soft actor-critic in a learnt model, whose rewards fall where the model is uncertain (Yu et al. 2020).

    u(s, a) = max_i || std_i(s, a) ||_2                                       of all members, elites or not
    r~      = r^ - penalty u(s, a),      (s', r^) ~ N( mu_e(s, a), std_e(s, a)^2 )           of an elite e a row
    y       = r + discount (1 - d) ( min_k Q'_k(s', a') - alpha log pi(a'|s') ),             a' ~ pi(s')
    L_Q     = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi    = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                              a~ ~ pi(s)

std_i is of the change of the state and of the reward together, in the log's units. Rows of rollouts have r~, rows of
the log the reward as logged (`odaf.algorithms.model_based` says how they are mixed). Critics step first, then the actor
against the new critics, then alpha; the slow critics follow.

Differs from the paper: it follows the published values and the code of a public collection for the second edition of
the benchmark, whose actor has a rate that falls and whose alpha is at most 1. Observations are normalised. Episodes,
not rows, are held out of the model's training.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.model_based import ModelBased, ModelBasedState
from odaf.algorithms.ranges import require_not_negative
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics.rollouts import Rolled
from odaf.components.dynamics.transition_ensemble import Uncertainty
from odaf.components.losses import ensemble_td_gradient
from odaf.data.transitions import Transitions


@dataclasses.dataclass(frozen=True)
class MOPO(ModelBased):
    """Model-based offline policy optimisation: rewards less a penalty on the model's uncertainty."""

    kind: ClassVar[str] = "mopo"

    penalty: float = 2.5
    """Weight of the uncertainty that is taken off each reward of a rollout."""
    uncertainty: Uncertainty = "deviation"
    """deviation: the largest member's standard deviation; disagreement: the largest distance of a member's mean from
    the members'; spread: the root mean square of the members' deviations from it."""
    real_fraction: float = 0.05
    """Share of a batch that comes from the log, the rest is of rollouts."""
    actor_decay_updates: int = 3_000_000
    """Updates within which the actor's step size falls to 0 along half a cosine; 0 keeps it as it is."""
    temperature_max: float | None = 1.0
    """Largest alpha that counts; None sets no bound."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_not_negative(self, ["penalty"])

    def citations(self) -> tuple[citations.Citation, ...]:
        """MOPO, and SAC that it stands on."""
        return (citations.MOPO, citations.SAC)

    def rolled(self, state: ModelBasedState, starts: Float[Array, "starts obs_dim"], key: PRNGKeyArray) -> Rolled:
        """Rollouts with r~ for rewards."""
        found = self.play(state, starts, key, self.uncertainty)
        penalised = found.rows.rewards - self.penalty * found.doubt
        return dataclasses.replace(found, rows=dataclasses.replace(found.rows, rewards=penalised))

    def update(self, state: ModelBasedState, batch: Transitions, key: PRNGKeyArray) -> tuple[ModelBasedState, Metrics]:
        """A step of the critics and their slow copies, of the actor against the new critics, and of alpha."""
        key_target, key_actor = jr.split(key)
        y = self.target(state.actor.now, state, batch, key_target, entropy=True)
        slope, loss, values = ensemble_td_gradient(
            CriticEnsemble(state.critics.now), batch.observations, batch.actions, y
        )
        critics = state.critics.stepped(slope.networks, self.critic_learning_rate, self.target_rate)
        after, metrics = self.actor_stepped(state, critics.now, batch, key_actor)
        metrics |= {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
            "rollouts/reward": jnp.mean(batch.rewards[self.real_rows :]),
            "rollouts/ended": jnp.mean(batch.terminated[self.real_rows :]),
        }
        return dataclasses.replace(after, step=state.step + 1, critics=critics), metrics
