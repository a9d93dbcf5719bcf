"""TD3+BC: twin critics, a deterministic actor, and cloning beside the value it climbs (Fujimoto and Gu 2021).

    a'   = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)
    y    = r + reward_shift + discount (1 - d) min_k Q'_k(s', a')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = - w mean_B Q_1(s, mu(s)) + mean_{B, dims} ( mu(s) - a )^2,  w = value_weight / sg[ mean_B |Q_1(s, mu(s))| ]

The critics step first. Every `actor_delay`-th update the actor steps against the new critics, and all slow copies move
then and only then.

Differs from the paper: biases of hidden layers start at 0 instead of uniform.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.twin_delayed import TwinDelayed, TwinDelayedState
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.targets import bellman_target
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions


def actor_loss(
    actor: DeterministicActor, critics: CriticEnsemble, batch: Transitions, value_weight: float | Float[Array, ""]
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi; gradients reach the actor only."""
    actions = actor.mode(batch.observations)
    values = critics.first().as_constants(batch.observations, actions)[0]
    cloning = batch.mean_over_actions(jnp.square(actions - batch.actions))
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
    loss = cloning - value_weight / size * jnp.mean(values)
    return loss, {"actor/loss": loss, "actor/cloning": cloning, "actor/value": jnp.mean(values)}


@dataclasses.dataclass(frozen=True)
class TD3BC(TwinDelayed):
    """Twin delayed critics with a cloning loss beside the actor's."""

    kind: ClassVar[str] = "td3-bc"
    not_negative: ClassVar[tuple[str, ...]] = ("value_weight",)
    draws_apart: ClassVar[bool] = True

    value_weight: float = 2.5
    """alpha, the weight of the value against cloning, in units of the mean size of the values."""
    learning_rate: float = 3e-4
    """Step size of Adam for actor and critics."""
    reward_shift: float = 0.0
    """Added to every reward, such as -1 in mazes whose reward is 1 at the goal."""

    def can_be_padded(self) -> bool:
        """Yes: what it averages and draws is of own dimensions."""
        return type(self) is TD3BC

    def citations(self) -> tuple[citations.Citation, ...]:
        """TD3+BC."""
        return (citations.TD3_BC,)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> TwinDelayedState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        del models
        key_actor, key_critics = jr.split(key)
        actor = init_deterministic_actor(key_actor, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        return TwinDelayedState.begin(actor, critics, ("actor/loss", "actor/cloning", "actor/value"))

    def target(self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        _, next_values = self.next_step(state, batch, key)
        rewards = batch.rewards + self.reward_shift
        return bellman_target(rewards, batch.terminated, jnp.min(next_values, axis=0), self.discount)

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        return self.updated(
            state,
            batch,
            self.target(state, batch, key),
            lambda actor, critics: actor_loss(actor, critics, batch.for_actor, self.value_weight),
            actor_rate=self.learning_rate,
            critic_rate=self.learning_rate,
        )
