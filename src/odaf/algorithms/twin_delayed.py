"""The core of TD3 (Fujimoto et al. 2018), which its offline relatives share: twin critics and a delayed actor.

    a' = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)

The critics step first. Every `actor_delay`-th update the actor steps against the new critics, and all slow copies move
then and only then.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.algorithms.base import LearnerState, Metrics
from odaf.components.critics import CriticEnsemble
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP
from odaf.components.numbers import Number
from odaf.components.policies import DeterministicActor
from odaf.components.targets import polyak
from odaf.components.trained import Trained
from odaf.data.transitions import Transitions

ActorLoss = Callable[[DeterministicActor, CriticEnsemble], tuple[Float[Array, ""], Metrics]]


class TwinDelayedState(LearnerState):
    """State of TD3 and its relatives."""

    step: Int[Array, ""]
    actor: Trained[DeterministicActor]
    critics: Trained[MLP]
    actor_metrics: dict[str, Float[Array, ""]]  # of the last actor step, so that means do not count the steps without

    @classmethod
    def begin(cls, actor: DeterministicActor, critics: MLP, metrics: tuple[str, ...]) -> "TwinDelayedState":
        """Slow copies equal to the networks, fresh optimisers, the actor's metrics 0 until its first step."""
        none_yet = {name: jnp.zeros(()) for name in metrics}
        return cls(jnp.asarray(0), Trained.begin(actor), Trained.begin(critics), none_yet)

    def next_step(
        self, key: PRNGKeyArray, batch: Transitions, target_noise: Number, noise_clip: Number
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, " rows"]]:
        """a' of the slow actor and min_k Q'_k(s', a')."""
        assert self.actor.slow is not None and self.critics.slow is not None
        noise = jnp.clip(target_noise * jr.normal(key, batch.actions.shape), -noise_clip, noise_clip)
        actions = jnp.clip(self.actor.slow.mode(batch.next_observations) + noise, -1.0, 1.0)
        return actions, jnp.min(CriticEnsemble(self.critics.slow)(batch.next_observations, actions), axis=0)

    def updated(
        self,
        batch: Transitions,
        target: Float[Array, " rows"],
        actor_loss: ActorLoss,
        *,
        actor_delay: int,
        actor_rate: Number,
        critic_rate: Number,
        target_rate: Number,
    ) -> tuple["TwinDelayedState", Metrics]:
        """A step of the critics towards the target; at every `actor_delay`-th one of the actor and the slow copies.

        Args:
            batch: rows of the log.
            target: y, the same for both critics.
            actor_loss: of an actor against critics, whose gradient reaches the actor only, with its metrics.
            actor_delay: updates of the critics for each of the actor.
            actor_rate: the actor's step size.
            critic_rate: the critics' step size.
            target_rate: share of the networks that enters their slow copies at each actor step.
        """
        online = CriticEnsemble(self.critics.now)
        gradient, loss, values = ensemble_td_gradient(online, batch.observations, batch.actions, target)
        state = dataclasses.replace(self, critics=self.critics.stepped(gradient.networks, critic_rate))

        def actor_step(state: TwinDelayedState) -> TwinDelayedState:
            critics = CriticEnsemble(state.critics.now)
            gradient, metrics = jax.grad(actor_loss, has_aux=True)(state.actor.now, critics)
            slow = polyak(state.critics.slow, state.critics.now, target_rate)
            return dataclasses.replace(
                state,
                actor=state.actor.stepped(gradient, actor_rate, target_rate),
                critics=dataclasses.replace(state.critics, slow=slow),
                actor_metrics=metrics,
            )

        is_due = (state.step + 1) % actor_delay == 0
        state = jax.lax.cond(is_due, actor_step, lambda state: state, state)
        metrics = {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(target),
        }
        return dataclasses.replace(state, step=state.step + 1), metrics | state.actor_metrics
