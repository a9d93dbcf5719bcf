"""COMBO: soft actor-critic on the log and a learnt model, whose critics are held down where both go (Yu et al. 2021).

    y       = r + discount (1 - d) min_k Q'_k(s', a'),                                       a' ~ pi(s')
    soft_k  = T log sum_i exp( ( Q_k(s, a_i) - log p_i ) / T )
    L_Q     = sum_k [ mean_B ( Q_k(s, a) - y )^2 + weight ( mean_{s in D} soft_k(s) - mean_{(s, a) in log} Q_k(s, a) ) ]
    L_pi    = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                              a~ ~ pi(s)

A batch B is half of the log and half of rollouts (`odaf.algorithms.model_based`), without a penalty on their rewards. D
is the whole batch, or its rollouts alone; pushed up are the log's rows and no others. The a_i are 3 n actions, n
uniform, n of pi(s') and n of pi(s), all valued at s, each with the density p_i it was drawn from; they are constants
(`odaf.components.conservative`). The actor steps first and alpha with it, then the critics by the new actor; the slow
critics follow.

Differs from the paper: it follows the code of a public collection, whose target has no entropy and whose actor has a
rate that falls; that code's sum runs over one action a source, which is a switch here. Observations are normalised.
Episodes, not rows, are held out of the model's training.
"""

import dataclasses
from typing import ClassVar, Literal

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.model_based import ModelBased, ModelBasedState
from odaf.algorithms.ranges import require_counts, require_not_negative, require_positive
from odaf.components.chunks import gradient_over_chunks
from odaf.components.conservative import Candidates, SoftMaximum, draw_candidates, values_and_gaps
from odaf.components.critics import CriticEnsemble, over_members
from odaf.components.dynamics.rollouts import Rolled
from odaf.components.losses import td_loss
from odaf.components.networks import MLP
from odaf.components.policies import GaussianActor
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class COMBO(ModelBased):
    """Conservative offline model-based policy optimisation: CQL's penalty where the model's rollouts go."""

    kind: ClassVar[str] = "combo"

    conservative_weight: float = 1.0
    """Weight of the penalty in each critic's loss."""
    push_down: Literal["mix", "model"] = "mix"
    """States whose soft maximum is pressed down: those of the whole batch, or of rollouts alone, as in the paper."""
    num_actions: int = 10
    """n, actions a state of each of the penalty's three sources."""
    penalty_temperature: float = 1.0
    """T: towards 0 the soft maximum is the largest value."""
    soft_maximum: SoftMaximum = "all"
    """What one soft maximum is taken over: "all" 3 n actions; or "threes", one action a source with the mean over n
    such, as in a public code, whose scores were made that way."""
    rollout_actions: Literal["policy", "uniform"] = "policy"
    """Actions of rollouts: draws of the current actor, or uniform ones."""
    horizon: int = 5
    """h, steps of a rollout at most."""
    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of the hidden layers of actor and critics."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_not_negative(self, ["conservative_weight"])
        require_positive(self, ["penalty_temperature"])
        require_counts(self, ["num_actions"])
        if self.real_rows < 1:
            raise ConfigError(
                f"real_fraction={self.real_fraction} must be above 0: the critics are pushed up at rows of the log"
            )

    def citations(self) -> tuple[citations.Citation, ...]:
        """COMBO, CQL whose penalty it takes, and SAC that it stands on."""
        return (citations.COMBO, citations.CQL, citations.SAC)

    def rolled(self, state: ModelBasedState, starts: Float[Array, "starts obs_dim"], key: PRNGKeyArray) -> Rolled:
        """Rollouts with the model's rewards."""
        return self.play(state, starts, key, actions=self.rollout_actions)

    def critic_gradient(
        self, actor: GaussianActor, state: ModelBasedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[MLP, Metrics]:
        """Gradient of L_Q in the critics, whose first `real_rows` rows are those of the log."""
        key_target, key_candidates = jr.split(key)
        y = self.target(actor, state, batch, key_target, entropy=False)
        candidates = draw_candidates(key_candidates, actor, batch, self.num_actions).in_chunks()
        rows, real = batch.actions.shape[0], self.real_rows
        is_real = jnp.arange(rows) < real
        # each row's weight in a mean over the batch, so that the mean runs over its part alone
        up = jnp.where(is_real, rows / real, 0.0).astype(y.dtype)
        down = jnp.ones_like(y)
        if self.push_down == "model":
            down = jnp.where(is_real, 0.0, rows / (rows - real)).astype(y.dtype)

        def loss(critic: CriticEnsemble, chunk: tuple[Candidates, tuple[Array, ...]]) -> tuple[Array, tuple]:
            candidates, (targets, up, down) = chunk
            values, gaps = values_and_gaps(critic, candidates, self.penalty_temperature, self.soft_maximum)
            error, penalty = td_loss(values, targets), jnp.mean(down * (values + gaps) - up * values)
            return error + self.conservative_weight * penalty, (error, penalty, values)

        def member(critic: CriticEnsemble) -> tuple[CriticEnsemble, tuple[Array, ...]]:
            shape = candidates.observations.shape[:2]
            weights = tuple(column.reshape(shape) for column in (y, up, down))
            return gradient_over_chunks(loss, critic, (candidates, weights))

        gradient, (errors, penalties, values) = over_members(member, CriticEnsemble(state.critics.now))
        metrics = {
            "critic/loss": jnp.sum(jnp.mean(errors, axis=1)),
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
            "conservative/gap": jnp.mean(penalties),
        }
        return gradient.networks, metrics

    def update(self, state: ModelBasedState, batch: Transitions, key: PRNGKeyArray) -> tuple[ModelBasedState, Metrics]:
        """A step of the actor and of alpha, then of the critics by the new actor; then the slow copies move."""
        key_actor, key_critic = jr.split(key)
        after, metrics = self.actor_stepped(state, state.critics.now, batch, key_actor)
        slope, critic_metrics = self.critic_gradient(after.actor.now, state, batch, key_critic)
        critics = state.critics.stepped(slope, self.critic_learning_rate, self.target_rate)
        metrics |= critic_metrics | {
            "rollouts/reward": jnp.mean(batch.rewards[self.real_rows :]),
            "rollouts/ended": jnp.mean(batch.terminated[self.real_rows :]),
        }
        return dataclasses.replace(after, step=state.step + 1, critics=critics), metrics
