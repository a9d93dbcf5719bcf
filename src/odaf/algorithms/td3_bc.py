"""TD3+BC: twin critics, a deterministic actor, and cloning beside the value it climbs (Fujimoto and Gu 2021).

    a'   = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)
    y    = r + discount (1 - d) min_k Q'_k(s', a')
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
from odaf.algorithms.base import Algorithm, Metrics
from odaf.algorithms.twin_delayed import TwinDelayedState
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.targets import bellman_target
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError


def actor_loss(
    actor: DeterministicActor, critics: CriticEnsemble, batch: Transitions, value_weight: float | Float[Array, ""]
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi; gradients reach the actor only."""
    actions = actor.mode(batch.observations)
    first = CriticEnsemble(jax.tree.map(lambda leaf: leaf[:1], critics.networks))
    values = first.as_constants(batch.observations, actions)[0]
    cloning = jnp.mean(jnp.square(actions - batch.actions))
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
    loss = cloning - value_weight / size * jnp.mean(values)
    return loss, {"actor/loss": loss, "actor/cloning": cloning, "actor/value": jnp.mean(values)}


@dataclasses.dataclass(frozen=True)
class TD3BC(Algorithm[TwinDelayedState]):
    """Twin delayed critics with a cloning loss beside the actor's."""

    kind: ClassVar[str] = "td3-bc"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    value_weight: float = 2.5
    """alpha, the weight of the value against cloning, in units of the mean size of the values."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action."""
    noise_clip: float = 0.5
    """c, the largest size of that noise."""
    actor_delay: int = 2
    """Updates of the critics for each of the actor and of the slow copies."""
    target_rate: float = 5e-3
    """Share of the networks that enters their slow copies at each actor step."""
    learning_rate: float = 3e-4
    """Step size of Adam for actor and critics."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.discount < 1.0:
            raise ConfigError(f"discount={self.discount} must lie in [0, 1)")
        if not 0.0 < self.target_rate <= 1.0:
            raise ConfigError(f"target_rate={self.target_rate} must lie in (0, 1]: the share that moves each time")
        for field in ("actor_delay", "batch_size"):
            if getattr(self, field) < 1:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least 1")
        for field in ("value_weight", "target_noise", "noise_clip", "normaliser_epsilon"):
            if getattr(self, field) < 0.0:
                raise ConfigError(f"{field}={getattr(self, field)} must not be negative")

    def citations(self) -> tuple[citations.Citation, ...]:
        """TD3+BC."""
        return (citations.TD3_BC,)

    def view(self) -> View:
        """Single rows; papers add 1e-3 to the spreads."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

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
        _, next_values = state.next_step(key, batch, self.target_noise, self.noise_clip)
        return bellman_target(batch.rewards, batch.terminated, next_values, self.discount)

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        return state.updated(
            batch,
            self.target(state, batch, key),
            lambda actor, critics: actor_loss(actor, critics, batch, self.value_weight),
            actor_delay=self.actor_delay,
            actor_rate=self.learning_rate,
            critic_rate=self.learning_rate,
            target_rate=self.target_rate,
        )

    def actor(self, state: TwinDelayedState) -> DeterministicActor:
        """mu."""
        return state.actor.now

    def values(self, state: TwinDelayedState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
