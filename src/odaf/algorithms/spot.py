"""SPOT: TD3 whose actor pays for actions of low density in the log, by a behaviour auto-encoder (Wu et al. 2022).

    a'   = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)
    y    = r + discount (1 - d) min_k Q'_k(s', a')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = mean_B ( support_weight l(s, mu(s)) - Q_1(s, mu(s)) / sg[ mean_B |Q_1(s, mu(s))| ] )

l(s, a) stands for - log pi_b(a|s): the loss of a conditional auto-encoder of the logged actions, with one draw of its
latent variable (`odaf.components.behaviour_models`). The auto-encoder is fitted beforehand and frozen; the gradient in
mu(s) passes through its encoder's input and through the residual. While training, mu and mu' drop hidden units, in both
formulas above; the actor that acts drops none. The critics step first. Every `actor_delay`-th update the actor steps
against the new critics, and all slow copies move then and only then.

Differs from the paper: biases of hidden layers start at 0 instead of uniform. Some episodes are kept out of the
auto-encoder's training to measure it. Observations are normalised in ant mazes too.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.numbers import is_off
from odaf.algorithms.twin_delayed import TwinDelayedState, TwinDelayedWithModel
from odaf.components.behaviour_models import (
    BehaviourConfig,
    BehaviourCVAE,
    fit_behaviour_cvae,
    init_behaviour_cvae,
)
from odaf.components.critics import OUTPUT_BOUND, CriticEnsemble
from odaf.components.networks import Factors, dropout_factors
from odaf.components.numbers import Number
from odaf.components.policies import HEAD_BOUND, DeterministicActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


def actor_loss(
    actor: DeterministicActor,
    critics: CriticEnsemble,
    batch: Transitions,
    behaviour: BehaviourCVAE,
    weight: Number,
    factors: Factors,
    noise: Float[Array, "rows latent_dim"],
) -> tuple[Float[Array, ""], Metrics]:
    """L_pi for given factors of the hidden units and noise of the latent variable; gradients reach the actor only."""
    actions = actor.with_dropout(batch.observations, factors)
    values = critics.first().as_constants(batch.observations, actions)[0]
    size = jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
    misfit = jnp.mean(behaviour.misfit(batch.observations, actions, noise))
    loss = weight * misfit - jnp.mean(values) / size
    return loss, {"actor/loss": loss, "actor/misfit": misfit, "actor/value": jnp.mean(values)}


@dataclasses.dataclass(frozen=True)
class SPOT(TwinDelayedWithModel):
    """Twin delayed critics, and an actor that is held to the support of the log by a density."""

    kind: ClassVar[str] = "spot"
    not_negative: ClassVar[tuple[str, ...]] = ("support_weight",)

    support_weight: float = 0.1
    """lambda, weight of l against the value in units of its mean size."""
    dropout: float = 0.1
    """Share of the actor's hidden units that are dropped at each row while training, in [0, 1)."""
    small_outputs: bool = False
    """Draw the first weights of the last layers from plus or minus 1e-3 (actor) and 3e-3 (critics), as published for
    ant mazes, instead of like hidden layers."""
    behaviour: BehaviourConfig = dataclasses.field(default_factory=lambda: BehaviourConfig(hidden_sizes=(750, 750)))
    """The auto-encoder of the logged actions."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.dropout < 1.0:
            raise ConfigError(f"dropout={self.dropout} must lie in [0, 1): the share of hidden units that are dropped")

    def citations(self) -> tuple[citations.Citation, ...]:
        """SPOT."""
        return (citations.SPOT,)

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> BehaviourCVAE:
        """The auto-encoder before training."""
        return init_behaviour_cvae(key, spec.obs_dim, spec.act_dim, self.behaviour.hidden_sizes)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[BehaviourCVAE, dict[str, Any]]:
        """Fit the auto-encoder to the logged actions."""
        model, findings = fit_behaviour_cvae(
            self.behaviour, dataset, normaliser, key, lambda done, steps: progress("behaviour model", done, steps)
        )
        return model, {"warnings": findings.pop("warnings"), "behaviour": findings}

    def pretraining(self) -> Hashable:
        """The auto-encoder's settings."""
        return self.behaviour

    def init(self, key: PRNGKeyArray, spec: Spec, models: BehaviourCVAE) -> TwinDelayedState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        bounds = (HEAD_BOUND, OUTPUT_BOUND) if self.small_outputs else (None, None)
        return self.begin(key, spec, ("actor/loss", "actor/misfit", "actor/value"), models, bounds)

    def factors(self, key: PRNGKeyArray, rows: int) -> Factors:
        """Of the actor's hidden units in one pass while training; none without dropout."""
        return () if is_off(self.dropout) else dropout_factors(key, self.dropout, rows, self.hidden_sizes)

    def target(self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for all critics."""
        key_noise, key_dropout = jr.split(key)
        factors = self.factors(key_dropout, batch.observations.shape[0])
        _, next_values = self.next_step(
            state, batch, key_noise, lambda actor, observations: actor.with_dropout(observations, factors)
        )
        return self.backed_up(batch, jnp.min(next_values, axis=0))

    def update(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics; at every `actor_delay`-th one of the actor and the slow copies against them."""
        key_target, key_dropout, key_latent = jr.split(key, 3)
        behaviour: BehaviourCVAE = state.models
        rows = batch.observations.shape[0]
        factors, noise = self.factors(key_dropout, rows), behaviour.draw_noise(key_latent, rows)
        return self.updated(
            state,
            batch,
            self.target(state, batch, key_target),
            lambda actor, critics: actor_loss(actor, critics, batch, behaviour, self.support_weight, factors, noise),
            actor_rate=self.actor_rate(state.step),
            critic_rate=self.critic_learning_rate,
        )
