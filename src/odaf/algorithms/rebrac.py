"""ReBRAC: TD3 with a penalty for leaving the log in the actor's loss and another in the target (Tarasov et al. 2023).

    a~'  = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),              noise ~ N(0, target_noise^2)
    y    = r + discount (1 - d) ( min_k Q'_k(s', a~') - critic_penalty f ||a~' - a'||^2 )
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = mean_B ( actor_penalty ||mu(s) - a||^2 - min_k Q_k(s, mu(s)) / sg[ mean_B |min_k Q_k(s, mu(s))| ] )

a' is the action logged at s', and f is 1 where there is one, 0 at an episode's last row; squared distances are summed
over action dimensions. The critics, whose layers are normalised, step first. Every `actor_delay`-th update the actor
steps against the new critics, and all slow copies move then and only then.

Differs from the paper: observations are normalised. Layers of the critics are normalised before the activation, the
authors' code does so after it. There the slow actor moves towards the actor as it was before the step.
"""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.ranges import require_counts
from odaf.algorithms.twin_delayed import TwinDelayed, TwinDelayedState
from odaf.components.critics import OUTPUT_BOUND, CriticEnsemble, init_critics
from odaf.components.losses import squared_distance
from odaf.components.networks import init_mlp
from odaf.components.numbers import Number
from odaf.components.policies import HEAD_BOUND, DeterministicActor
from odaf.components.targets import bellman_target
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError


def actor_loss(
    actor: DeterministicActor, critics: CriticEnsemble, batch: Transitions, penalty: Number
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi; gradients reach the actor only."""
    actions = actor.mode(batch.observations)
    distance = jnp.mean(squared_distance(actions, batch.actions))
    values = jnp.min(critics.as_constants(batch.observations, actions), axis=0)
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
    loss = penalty * distance - jnp.mean(values) / size
    return loss, {"actor/loss": loss, "actor/distance": distance, "actor/value": jnp.mean(values)}


@dataclasses.dataclass(frozen=True)
class ReBRAC(TwinDelayed):
    """Twin delayed critics, with a behaviour penalty of its own for the actor and for the critics."""

    kind: ClassVar[str] = "rebrac"
    not_negative: ClassVar[tuple[str, ...]] = ("actor_penalty", "critic_penalty")
    draws_apart: ClassVar[bool] = True

    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of the hidden layers of actor and critics."""
    num_critics: int = 2
    """K, the number of Q-functions; two as published."""
    actor_penalty: float = 0.01
    """Weight of the actor's squared distance from the logged action, in units of the mean size of the values."""
    critic_penalty: float = 0.01
    """Weight of the next action's squared distance from the logged one, taken off the target, in scaled rewards."""
    reward_scale: float = 1.0
    """Factor on all rewards."""
    actor_learning_rate: float = 1e-3
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 1e-3
    """Step size of Adam for the critics."""
    batch_size: int = 1024
    """Transitions a gradient step."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_counts(self, ["num_critics"])
        if not 0.0 < self.reward_scale < math.inf:
            raise ConfigError(f"reward_scale={self.reward_scale} must be positive")

    def can_be_padded(self) -> bool:
        """Yes: what it averages and draws is of own dimensions."""
        return type(self) is ReBRAC

    def citations(self) -> tuple[citations.Citation, ...]:
        """ReBRAC."""
        return (citations.REBRAC,)

    def view(self) -> View:
        """Single rows, with the action logged at the successor and whether there is one."""
        extras = ("next_actions", "followed")
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon, extras=extras)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> TwinDelayedState:
        """Random networks, the critics' layers normalised; slow copies equal to them, fresh optimisers."""
        del models
        key_actor, key_critics = jr.split(key)
        sizes = (spec.obs_dim, *self.hidden_sizes, spec.act_dim)
        actor = DeterministicActor(init_mlp(key_actor, sizes, output_bound=HEAD_BOUND))
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, self.num_critics, "layer", OUTPUT_BOUND
        )
        return TwinDelayedState.begin(actor, critics, ("actor/loss", "actor/distance", "actor/value"))

    def target(self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for all critics."""
        actions, members = self.next_step(state, batch, key)
        distance = batch.extras["followed"] * squared_distance(actions, batch.extras["next_actions"])
        next_values = jnp.min(members, axis=0) - self.critic_penalty * distance
        return bellman_target(self.reward_scale * batch.rewards, batch.terminated, next_values, self.discount)

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        state, metrics = self.updated(
            state,
            batch,
            self.target(state, batch, key),
            lambda actor, critics: actor_loss(actor, critics, batch.for_actor, self.actor_penalty),
            actor_rate=self.actor_learning_rate,
            critic_rate=self.critic_learning_rate,
        )
        of_values = ("critic/mean", "critic/min", "critic/max", "target/mean", "actor/value")
        return state, metrics | {name: metrics[name] / self.reward_scale for name in of_values}
