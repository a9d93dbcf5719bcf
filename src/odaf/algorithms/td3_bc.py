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
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.targets import bellman_target, polyak
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError


class TD3BCState(LearnerState):
    """State of TD3+BC."""

    step: Int[Array, ""]
    actor: Trained[DeterministicActor]
    critics: Trained[MLP]
    actor_metrics: dict[str, Float[Array, ""]]  # of the last actor step, so that means do not count the steps without


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
class TD3BC(Algorithm[TD3BCState]):
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

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> TD3BCState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        del models
        key_actor, key_critics = jr.split(key)
        actor = init_deterministic_actor(key_actor, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        none_yet = {name: jnp.zeros(()) for name in ("actor/loss", "actor/cloning", "actor/value")}
        return TD3BCState(jnp.asarray(0), Trained.begin(actor), Trained.begin(critics), none_yet)

    def target(self, state: TD3BCState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        assert state.actor.slow is not None and state.critics.slow is not None
        noise = self.target_noise * jr.normal(key, batch.actions.shape)
        noise = jnp.clip(noise, -self.noise_clip, self.noise_clip)
        next_actions = jnp.clip(state.actor.slow.mode(batch.next_observations) + noise, -1.0, 1.0)
        next_values = CriticEnsemble(state.critics.slow)(batch.next_observations, next_actions)
        return bellman_target(batch.rewards, batch.terminated, jnp.min(next_values, axis=0), self.discount)

    def update(self, state: TD3BCState, batch: Transitions, key: PRNGKeyArray) -> tuple[TD3BCState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        y = self.target(state, batch, key)
        gradient, loss, values = ensemble_td_gradient(
            CriticEnsemble(state.critics.now), batch.observations, batch.actions, y
        )
        state = dataclasses.replace(state, critics=state.critics.stepped(gradient.networks, self.learning_rate))
        is_due = (state.step + 1) % self.actor_delay == 0
        state = jax.lax.cond(is_due, lambda state: self._actor_step(state, batch), lambda state: state, state)
        metrics = {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
        }
        return dataclasses.replace(state, step=state.step + 1), metrics | state.actor_metrics

    def _actor_step(self, state: TD3BCState, batch: Transitions) -> TD3BCState:
        critics = CriticEnsemble(state.critics.now)
        gradient, metrics = jax.grad(actor_loss, has_aux=True)(state.actor.now, critics, batch, self.value_weight)
        slow = polyak(state.critics.slow, state.critics.now, self.target_rate)
        return dataclasses.replace(
            state,
            actor=state.actor.stepped(gradient, self.learning_rate, self.target_rate),
            critics=dataclasses.replace(state.critics, slow=slow),
            actor_metrics=metrics,
        )

    def actor(self, state: TD3BCState) -> DeterministicActor:
        """mu."""
        return state.actor.now

    def values(self, state: TD3BCState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
