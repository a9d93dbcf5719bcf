"""SCAS: TD3 whose actor is led back to logged next states of high value (Mao et al. 2024).

    a'   = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)
    y    = r + discount (1 - d) min_k Q'_k(s', a')                     or the mean over k
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = - (1 - correction) mean_B min_k Q_k(s, mu(s)) / sg[ mean_B |min_k Q_k(s, mu(s))| ]
           + correction mean_{B, dims} w ( f(s + e, mu(s)) - s' )^2,   e ~ N(0, state_noise^2)
    w    = sg[ min( cap, exp( beta ( V(s') - V(s) ) ) ) ],             V(s) = mean_k Q_k(s, mu(s))

f predicts the next state and is fitted beforehand and frozen. The state beside s is shown to f alone: mu acts at s. So
the actor is asked for the action that leads from near s to where the log went, the more so the better it is there. The
critics step first. Every `actor_delay`-th update the actor steps against the new critics, and all slow copies move then
and only then. The actor's step size falls along half a cosine. Rows whose next state is a placeholder, at true ends
without one, are left out of the second mean.

Differs from the paper: biases of the actor's and critics' hidden layers start at 0 instead of uniform, those of f at
0.1. Some episodes are kept out of f's training to measure it. Observations are normalised in large ant mazes too.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.ranges import require_positive, require_unit_interval
from odaf.algorithms.twin_delayed import TwinDelayedState, TwinDelayedWithModel
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics import DynamicsConfig, DynamicsModel, fit_dynamics, untrained
from odaf.components.numbers import Number
from odaf.components.policies import DeterministicActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View

ACTOR_METRICS = ("actor/loss", "actor/value", "actor/miss", "actor/weight", "actor/capped")


def actor_loss(
    actor: DeterministicActor,
    critics: CriticEnsemble,
    batch: Transitions,
    dynamics: DynamicsModel,
    offsets: Float[Array, "rows obs_dim"],
    correction: Number,
    inverse_temperature: Number,
    cap: Number,
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi for given e; gradients reach the actor only."""
    actions = actor.mode(batch.observations)
    members = critics.as_constants(batch.observations, actions)
    values = jnp.min(members, axis=0)
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))

    later = critics(batch.next_observations, actor.mode(batch.next_observations))
    gain = jnp.mean(later, axis=0) - jnp.mean(members, axis=0)
    weights = jax.lax.stop_gradient(jnp.minimum(cap, jnp.exp(inverse_temperature * gain)))

    reached = dynamics.expected(batch.observations + offsets, actions)
    misses = weights * jnp.mean(jnp.square(reached - batch.next_observations), axis=-1)
    known = batch.extras["successor_known"]
    miss = jnp.sum(known * misses) / jnp.maximum(jnp.sum(known), 1.0)
    loss = correction * miss - (1.0 - correction) * jnp.mean(values) / size
    return loss, {
        "actor/loss": loss,
        "actor/value": jnp.mean(values),
        "actor/miss": miss,
        "actor/weight": jnp.mean(weights),
        "actor/capped": jnp.mean((weights >= cap).astype(weights.dtype)),
    }


@dataclasses.dataclass(frozen=True)
class SCAS(TwinDelayedWithModel):
    """Delayed critics, and an actor whose predicted outcomes are drawn to logged ones of high value."""

    kind: ClassVar[str] = "scas"
    not_negative: ClassVar[tuple[str, ...]] = ("state_noise", "inverse_temperature")

    num_critics: int = 4
    """K, the number of Q-functions."""
    actor_learning_rate: float = 2e-4
    """Step size of Adam for the actor."""
    actor_decay_updates: int = 1_000_000
    """Updates in which the actor's step size falls to 0 along half a cosine; 0 keeps it."""
    target: Literal["min", "mean"] = "min"
    """Of the slow critics' values in the target: their lowest, or their mean (as published for ant mazes)."""
    correction: float = 0.25
    """lambda in [0, 1], share of the correction in the actor's loss; the value has the rest."""
    state_noise: float = 3e-3
    """Standard deviation of e, in standard deviations of the log."""
    inverse_temperature: float = 5.0
    """beta: how steeply the weight of a logged next state rises with its value; 0 weighs all alike."""
    weight_cap: float = 50.0
    """Largest w."""
    dynamics: DynamicsConfig = dataclasses.field(
        default_factory=lambda: DynamicsConfig(
            hidden_sizes=(256, 256, 256, 256), residual=False, steps=500_000, schedule="constant"
        )
    )
    """f, the model of the next state."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_unit_interval(self, "correction", "the value has the rest")
        require_positive(self, ["weight_cap"])

    def citations(self) -> tuple[citations.Citation, ...]:
        """SCAS."""
        return (citations.SCAS,)

    def view(self) -> View:
        """Single rows, with whether the next state was recorded."""
        return dataclasses.replace(super().view(), extras=("successor_known",))

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> DynamicsModel:
        """f before training."""
        return untrained(self.dynamics, key, spec.obs_dim, spec.act_dim)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[DynamicsModel, dict[str, Any]]:
        """Fit f to the logged next states."""
        model, findings = fit_dynamics(
            self.dynamics,
            dataset,
            normaliser,
            key,
            lambda done, steps: progress("dynamics model", done, steps),
            use="the actor is led to states the system would not reach",
            remedy="take a learner that predicts no states, such as td3-bc",
        )
        return model, {"warnings": findings.pop("warnings"), "dynamics": findings}

    def pretraining(self) -> Hashable:
        """f's settings."""
        return self.dynamics

    def init(self, key: PRNGKeyArray, spec: Spec, models: DynamicsModel) -> TwinDelayedState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        return self.begin(key, spec, ACTOR_METRICS, models)

    def targets(self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for all critics."""
        _, next_values = self.next_step(state, batch, key)
        reduce = jnp.min if self.target == "min" else jnp.mean
        return self.backed_up(batch, reduce(next_values, axis=0))

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        key_target, key_beside = jr.split(key)
        offsets = self.state_noise * jr.normal(key_beside, batch.observations.shape)
        return self.updated(
            state,
            batch,
            self.targets(state, batch, key_target),
            lambda actor, critics: actor_loss(
                actor,
                critics,
                batch,
                state.models,
                offsets,
                self.correction,
                self.inverse_temperature,
                self.weight_cap,
            ),
            actor_rate=self.actor_rate(state.step),
            critic_rate=self.critic_learning_rate,
        )
