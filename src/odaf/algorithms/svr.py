"""SVR: TD3 whose critics are pressed to the lowest value where the log has no actions (Mao et al. 2023).

    y    = r + discount (1 - d) min_k Q'_k(s', mu'(s')),                              without noise on the action
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2 + support_weight R
    R    = mean_{B, k} max( -1e4, ( Q_k(s, u) - Q_min )^2 - w ( Q_k(s, a) - Q_min )^2 )
    u    = clip( mu(s) + noise, -1, 1 ),                                              noise ~ N(0, support_noise^2)
    w    = max( weight_floor, exp( ( |mu_b(s) - a|^2 - |mu(s) - a|^2 ) / (2 support_noise^2) ) )
    L_pi = - 2.5 mean_B min_k Q_k(s, mu(s)) / sg[ mean_B |min_k Q_k(s, mu(s))| ]

|.|^2 is a mean over action dimensions, not a sum. w weighs the logged action by how likely the policy takes it,
against mu_b, a clone of the log with the same spread: where the log covers what the policy does, both parts of R cancel
in expectation, and elsewhere the first alone is left. u and w are constants. R is a mean over critics beside a sum, so
each critic has support_weight / K of it. The critics step first, against the actor before its step. Every
`actor_delay`-th update the actor steps against the new critics, and all slow copies move then and only then. The
actor's step size falls along half a cosine. mu_b is fitted beforehand and frozen.

Differs from the paper: biases of hidden layers start at 0 instead of uniform. Some episodes are kept out of the clone's
training to measure it. Q_min is that of the log unless it is given; the paper's are those of each robot's worst log.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.ranges import require_positive
from odaf.algorithms.twin_delayed import TwinDelayedState, TwinDelayedWithModel
from odaf.components.behaviour_models import BehaviourConfig, fit_clone
from odaf.components.critics import CriticEnsemble, over_members
from odaf.components.losses import td_loss
from odaf.components.numbers import Number
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.targets import value_range
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions

PENALTY_FLOOR = -1e4  # of what R averages
VALUE_WEIGHT = 2.5  # of the actor's only loss
LARGEST_EXPONENT = 80.0  # of w: such rows are at the floor, and a w that is not finite would make their slope NaN


class SVRModels(eqx.Module):
    """What stays as it is while SVR trains."""

    behaviour: DeterministicActor  # mu_b
    lowest_value: Float[Array, ""]  # Q_min


def support_weights(
    actions: Float[Array, "rows act_dim"],
    cloned: Float[Array, "rows act_dim"],
    logged: Float[Array, "rows act_dim"],
    deviation: Number,
    floor: Number,
) -> Float[Array, " rows"]:
    """w of the policy's actions, the clone's and the logged ones, a constant."""
    policy, clone = (jnp.mean(jnp.square(of - logged), axis=-1) for of in (actions, cloned))
    exponent = (clone - policy) / (2.0 * deviation * deviation)
    return jax.lax.stop_gradient(jnp.maximum(floor, jnp.exp(jnp.minimum(exponent, LARGEST_EXPONENT))))


def critic_gradient(
    critics: CriticEnsemble,
    batch: Transitions,
    target: Float[Array, " rows"],
    beside: Float[Array, "rows act_dim"],
    weights: Float[Array, " rows"],
    lowest: Number,
    support_weight: Number,
) -> tuple[CriticEnsemble, Float[Array, "critics rows"], Metrics]:
    """Gradient of L_Q, member by member, with the values of the logged actions; `beside` is u."""
    states = jnp.concatenate([batch.observations, batch.observations])
    inputs = jnp.concatenate([states, jnp.concatenate([batch.actions, beside])], axis=-1)
    share = support_weight / critics.networks.biases[0].shape[0]

    def member(critic: CriticEnsemble) -> tuple[CriticEnsemble, tuple[Array, Array, Array]]:
        def loss(critic: CriticEnsemble) -> tuple[Float[Array, ""], tuple[Array, Array, Array]]:
            logged, others = jnp.split(critic.value(inputs), 2)
            gaps = jnp.square(others - lowest) - weights * jnp.square(logged - lowest)
            gaps = jnp.maximum(PENALTY_FLOOR, gaps)
            error = td_loss(logged, target)
            return error + share * jnp.mean(gaps), (logged, error, gaps)

        return jax.grad(loss, has_aux=True)(critic)

    gradient, (values, errors, gaps) = over_members(member, critics)
    metrics = {
        "critic/loss": jnp.sum(errors),
        "critic/support": jnp.mean(gaps),
        "critic/support/floored": jnp.mean((gaps <= PENALTY_FLOOR).astype(gaps.dtype)),
    }
    return gradient, values, metrics


def actor_loss(
    actor: DeterministicActor, critics: CriticEnsemble, batch: Transitions
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi; gradients reach the actor only."""
    values = jnp.min(critics.as_constants(batch.observations, actor.mode(batch.observations)), axis=0)
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
    loss = -VALUE_WEIGHT * jnp.mean(values) / size
    return loss, {"actor/loss": loss, "actor/value": jnp.mean(values)}


@dataclasses.dataclass(frozen=True)
class SVR(TwinDelayedWithModel):
    """Delayed critics that are lowered where the log has no actions, and an actor that only climbs them."""

    kind: ClassVar[str] = "svr"
    not_negative: ClassVar[tuple[str, ...]] = ("support_weight", "weight_floor")

    num_critics: int = 4
    """K, the number of Q-functions."""
    target_noise: float = 0.0
    """Standard deviation of the noise on the target's action."""
    actor_decay_updates: int = 1_000_000
    """Updates in which the actor's step size falls to 0 along half a cosine; 0 keeps it."""
    support_weight: float = 1e-3
    """alpha, weight of R."""
    lowest_value: Literal["log"] | float = "log"
    """Q_min, what values outside the log are pressed to; "log" is the lowest that the logged rewards allow."""
    support_noise: float = 0.2
    """Standard deviation of u around the policy's action, and of both densities in w."""
    weight_floor: float = 0.1
    """Least w."""
    behaviour: BehaviourConfig = dataclasses.field(default_factory=BehaviourConfig)
    """mu_b, the clone of the log."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, ["support_noise"])

    def citations(self) -> tuple[citations.Citation, ...]:
        """SVR."""
        return (citations.SVR,)

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> DeterministicActor:
        """The clone before training."""
        return init_deterministic_actor(key, spec.obs_dim, spec.act_dim, self.behaviour.hidden_sizes)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[DeterministicActor, dict[str, Any]]:
        """Fit the clone to the logged actions."""
        model, findings = fit_clone(
            self.behaviour, dataset, normaliser, key, lambda done, steps: progress("behaviour model", done, steps)
        )
        return model, {"warnings": findings.pop("warnings"), "behaviour": findings}

    def pretraining(self) -> Hashable:
        """The clone's settings."""
        return self.behaviour

    def init(self, key: PRNGKeyArray, spec: Spec, models: DeterministicActor) -> TwinDelayedState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        lowest = self.lowest_value
        if isinstance(lowest, str):
            low, high = spec.reward_min + self.reward_shift, spec.reward_max + self.reward_shift
            lowest, _ = value_range(dataclasses.replace(spec, reward_min=low, reward_max=high), self.discount)
        kept = SVRModels(models, jnp.asarray(lowest, jnp.float32))
        return self.begin(key, spec, ("actor/loss", "actor/value"), kept)

    def target(self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for all critics."""
        _, next_values = self.next_step(state, batch, key)
        return self.backed_up(batch, jnp.min(next_values, axis=0))

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        key_target, key_beside = jr.split(key)
        models: SVRModels = state.models
        actions, cloned = state.actor.now.mode(batch.observations), models.behaviour.mode(batch.observations)
        beside = jnp.clip(actions + self.support_noise * jr.normal(key_beside, actions.shape), -1.0, 1.0)
        weights = support_weights(actions, cloned, batch.actions, self.support_noise, self.weight_floor)
        return self.updated(
            state,
            batch,
            self.target(state, batch, key_target),
            lambda actor, critics: actor_loss(actor, critics, batch),
            actor_rate=self.actor_rate(state.step),
            critic_rate=self.critic_learning_rate,
            critic_gradient=lambda critics, batch, target: critic_gradient(
                critics, batch, target, beside, weights, models.lowest_value, self.support_weight
            ),
        )
