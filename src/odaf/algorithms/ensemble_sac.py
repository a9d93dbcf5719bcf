"""Soft actor-critic with an ensemble of critics, plus a tuple of terms: SAC-N, ODAF and their relatives.

Without terms this is SAC-N (An et al. 2021): the target is the minimum over K critics,

    y    = r + discount (1 - d) ( min_k Q'_k(s', a') - alpha log pi(a'|s') ),   a' ~ pi(s')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                      a~ ~ pi(s)

and every term adds its own loss to L_pi, to L_Q or to both. All losses of one update are taken at the parameters from
before it (the order of the EDAC, RORL and ODAF codes); then the slow copies move.

With `return_steps` n above 1, r is the discounted sum of the next n logged rewards, s' the state n steps on, and the
discount of the target its n-th power.

Differs from SAC-N by default: layer-normalised critics, targets clipped to the range that the rewards allow, and no
entropy in the target. Each is a field. docs/algorithms/odaf.md shows what each of them does.
"""

import dataclasses
import math
import zlib
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.terms.base import Context, Term
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.losses import ensemble_td_gradient, soft_actor_loss, temperature_loss
from odaf.components.policies import GaussianActor, init_gaussian_actor
from odaf.components.targets import bellman_target, copy_of, polyak, value_range
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


class EnsembleState(LearnerState):
    """State of the ensemble soft actor-critic."""

    step: Int[Array, ""]
    actor: GaussianActor
    slow_actor: GaussianActor  # pi'
    critics: CriticEnsemble
    target_critics: CriticEnsemble  # Q'
    log_temperature: Float[Array, ""]
    actor_optimiser: optax.OptState
    critic_optimiser: optax.OptState
    temperature_optimiser: optax.OptState
    value_bounds: Float[Array, "2"]
    side: tuple[PyTree, ...]  # one entry a term, frozen


@dataclasses.dataclass(frozen=True)
class EnsembleSAC(Algorithm[EnsembleState]):
    """Ensemble soft actor-critic plus terms."""

    kind: ClassVar[str] = "ensemble-sac"

    num_critics: int = 10
    """K, the number of Q-functions."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    critic_norm: Literal["layer", "none"] = "layer"
    """Layer normalisation inside the critics; "none" is the published form, which can diverge."""
    critic_output_bound: float = 3e-3
    """Initial weights of the critics' last layer are uniform in plus or minus this. More than the published 3e-3 makes
    the members differ where the log does not hold them together, so that their minimum is more cautious there."""
    value_range: Literal["auto", "none"] = "auto"
    """Clip the critics' targets to what the logged rewards allow at this discount, or do not."""
    entropy_in_backup: bool = False
    """Subtract alpha log pi from the next state's value in the target."""
    actor_critic: Literal["online", "target"] = "online"
    """Critics that the actor climbs: the online ones, or the slow ones (as printed in the ODAF paper)."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    return_steps: int = 1
    """n: targets sum the next n logged rewards before they bootstrap. More carries values back in fewer updates and
    piles up less pessimism on the way, at the price of trusting the logged actions for n steps."""
    target_rate: float = 5e-3
    """Share of the online critics that enters the target critics at each update."""
    slow_actor_rate: float = 5e-3
    """Share of the actor that enters its slow copy pi' at each update."""
    deployed_actor: Literal["current", "slow"] = "current"
    """Which actor the trained policy is: pi, or pi', an average over the last updates that does not swing with each."""
    batch_size: int = 256
    """Transitions a gradient step."""
    actor_learning_rate: float = 3e-4
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics."""
    temperature_learning_rate: float = 3e-4
    """Step size of Adam for log alpha; 0 keeps alpha at its initial value."""
    initial_temperature: float = 1.0
    """alpha at step 0."""
    target_entropy: float | None = None
    """Entropy in nats that alpha steers to; None gives minus the number of action dimensions."""
    terms: tuple[Term, ...] = ()
    """Additions to the losses."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.discount < 1.0:
            raise ConfigError(f"discount={self.discount} must lie in [0, 1)")
        if self.num_critics < 2:
            raise ConfigError(f"num_critics={self.num_critics}: an ensemble needs at least 2")
        if self.initial_temperature <= 0.0:
            raise ConfigError(f"initial_temperature={self.initial_temperature} must be positive")
        for field in ("target_rate", "slow_actor_rate"):
            if not 0.0 < getattr(self, field) <= 1.0:
                raise ConfigError(
                    f"{field}={getattr(self, field)} must lie in (0, 1]: the share that moves each update"
                )
        for field in ("batch_size", "return_steps"):
            if getattr(self, field) < 1:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least 1")
        if any(width < 1 for width in self.hidden_sizes):
            raise ConfigError(f"hidden_sizes={self.hidden_sizes} must hold widths of at least 1")
        names = [term.name for term in self.terms]
        if len(set(names)) < len(names):
            raise ConfigError(f"terms {names} contain one term twice")

    @property
    def active_terms(self) -> tuple[Term, ...]:
        """Terms whose weight is not 0."""
        return tuple(term for term in self.terms if term.weight != 0.0)

    # ---- before training ----------------------------------------------------------------------------------------

    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> tuple[PyTree, ...]:
        """The active terms' side networks, untrained."""
        return tuple(term.untrained_side(_key_for(term, key), spec) for term in self.active_terms)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[tuple[PyTree, ...], dict[str, Any]]:
        """Train each active term's side network; the report has an entry a term."""
        sides: list[PyTree] = []
        report: dict[str, Any] = {"warnings": []}
        for term in self.active_terms:
            side, findings = term.pretrain(dataset, normaliser, _key_for(term, key), progress)
            sides.append(side)
            report["warnings"] += findings.pop("warnings")
            if findings:
                report[term.name] = findings
        return tuple(sides), report

    def init(self, key: PRNGKeyArray, spec: Spec, side: tuple[PyTree, ...]) -> EnsembleState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        key_actor, key_critics = jr.split(key)
        actor = init_gaussian_actor(key_actor, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(
            key_critics,
            spec.obs_dim,
            spec.act_dim,
            self.hidden_sizes,
            self.num_critics,
            self.critic_norm,
            self.critic_output_bound,
        )
        bounds = value_range(spec, self.discount) if self.value_range == "auto" else (-math.inf, math.inf)
        log_temperature = jnp.asarray(math.log(self.initial_temperature), dtype=jnp.float32)
        return EnsembleState(
            step=jnp.asarray(0),
            actor=actor,
            slow_actor=copy_of(actor),
            critics=critics,
            target_critics=copy_of(critics),
            log_temperature=log_temperature,
            actor_optimiser=_moments(self.actor_learning_rate, actor),
            critic_optimiser=_moments(self.critic_learning_rate, critics),
            temperature_optimiser=_moments(self.temperature_learning_rate, log_temperature),
            value_bounds=jnp.asarray(bounds, dtype=jnp.float32),
            side=side,
        )

    # ---- losses -------------------------------------------------------------------------------------------------

    def target(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, clipped to the value range."""
        noise = jr.normal(key, batch.actions.shape)
        next_actions, log_density = state.actor.sample(batch.next_observations, noise)
        next_values = jnp.min(state.target_critics(batch.next_observations, next_actions), axis=0)
        if self.entropy_in_backup:
            next_values = next_values - jnp.exp(state.log_temperature) * log_density
        y = bellman_target(batch.rewards, batch.terminated, next_values, self.discount**self.return_steps)
        return jnp.clip(y, state.value_bounds[0], state.value_bounds[1])

    def critic_gradient(
        self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[CriticEnsemble, Metrics]:
        """Gradient of L_Q plus the terms' additions with respect to the critics."""
        y = self.target(state, batch, jr.fold_in(key, 0))
        gradient, loss, values = ensemble_td_gradient(state.critics, batch.observations, batch.actions, y)
        metrics = {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
        }
        if any(term.acts_on_critics for term in self.active_terms):
            additions = eqx.filter_grad(self.critic_additions, has_aux=True)
            addition, more = additions(state.critics, state, batch, key)
            gradient, metrics = jax.tree.map(jnp.add, gradient, addition), metrics | more
        return gradient, metrics

    def critic_additions(
        self, critics: CriticEnsemble, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """What the terms add to L_Q, as a function of the critics."""
        loss, metrics = jnp.zeros(()), {}
        context = self._context(state, batch, critics=critics)
        for term, side in zip(self.active_terms, state.side, strict=True):
            if term.acts_on_critics:
                addition, more = term.critic_loss(context, side, _key_for(term, key))
                loss, metrics = loss + addition, metrics | more
        return loss, metrics

    def actor_loss(
        self, actor: GaussianActor, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], tuple[Float[Array, " rows"], Metrics]]:
        """L_pi and the terms' additions, as a function of the actor; also log pi(a~|s) for the temperature."""
        noise = jr.normal(jr.fold_in(key, 0), batch.actions.shape)
        actions, log_density = actor.sample(batch.observations, noise)
        critics = state.critics if self.actor_critic == "online" else state.target_critics
        values = jnp.min(critics.as_constants(batch.observations, actions), axis=0)
        loss = soft_actor_loss(log_density, values, jnp.exp(state.log_temperature))
        metrics = {"actor/loss": loss, "actor/value": jnp.mean(values), "actor/entropy": -jnp.mean(log_density)}
        context = self._context(state, batch, actor=actor)
        for term, side in zip(self.active_terms, state.side, strict=True):
            if term.acts_on_actor:
                addition, more = term.actor_loss(context, side, _key_for(term, key))
                loss, metrics = loss + addition, metrics | more
        return loss, (log_density, metrics)

    # ---- training -----------------------------------------------------------------------------------------------

    def update(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> tuple[EnsembleState, Metrics]:
        """Actor, temperature and critics step from the same old parameters; then the slow copies move."""
        key_actor, key_critic = jr.split(key)
        actor_gradient, (log_density, actor_metrics) = eqx.filter_grad(self.actor_loss, has_aux=True)(
            state.actor, state, batch, key_actor
        )
        critic_gradient, critic_metrics = self.critic_gradient(state, batch, key_critic)
        target_entropy = float(-batch.actions.shape[1]) if self.target_entropy is None else self.target_entropy
        temperature_gradient = jax.grad(temperature_loss)(state.log_temperature, log_density, target_entropy)

        actor, actor_optimiser = _adam(self.actor_learning_rate, actor_gradient, state.actor_optimiser, state.actor)
        critics, critic_optimiser = _adam(
            self.critic_learning_rate, critic_gradient, state.critic_optimiser, state.critics
        )
        log_temperature, temperature_optimiser = _adam(
            self.temperature_learning_rate, temperature_gradient, state.temperature_optimiser, state.log_temperature
        )
        new_state = EnsembleState(
            step=state.step + 1,
            actor=actor,
            slow_actor=polyak(state.slow_actor, actor, self.slow_actor_rate),
            critics=critics,
            target_critics=polyak(state.target_critics, critics, self.target_rate),
            log_temperature=log_temperature,
            actor_optimiser=actor_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
            value_bounds=state.value_bounds,
            side=state.side,
        )
        return new_state, actor_metrics | critic_metrics | {"temperature/value": jnp.exp(log_temperature)}

    def act(self, state: EnsembleState, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
        """tanh of the deployed actor's mean."""
        actor = state.actor if self.deployed_actor == "current" else state.slow_actor
        return actor.mode(observations)

    def _context(
        self,
        state: EnsembleState,
        batch: Transitions,
        *,
        actor: GaussianActor | None = None,
        critics: CriticEnsemble | None = None,
    ) -> Context:
        return Context(
            batch=batch,
            actor=state.actor if actor is None else actor,
            slow_actor=state.slow_actor,
            critics=state.critics if critics is None else critics,
            target_critics=state.target_critics,
            value_bounds=state.value_bounds,
            step=state.step,
        )


def _moments(rate: float, parameters: PyTree) -> optax.OptState:
    return optax.adam(rate).init(parameters)


def _adam(rate: float, gradient: PyTree, moments: optax.OptState, parameters: PyTree) -> tuple[PyTree, optax.OptState]:
    updates, moments = optax.adam(rate).update(gradient, moments, parameters)
    return optax.apply_updates(parameters, updates), moments


def _key_for(term: Term, key: PRNGKeyArray) -> PRNGKeyArray:
    """A key that depends on the term's name, so that adding one term does not change another's noise."""
    return jr.fold_in(key, zlib.crc32(term.name.encode()))
