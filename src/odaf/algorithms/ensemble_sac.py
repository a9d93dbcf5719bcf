"""Soft actor-critic with an ensemble of critics, plus a tuple of terms: SAC-N, ODAF and their relatives.

Without terms this is SAC-N (An et al. 2021): the target is the minimum over K critics,

    y    = r + discount (1 - d) ( min_k Q'_k(s', a') - alpha log pi(a'|s') ),   a' ~ pi(s')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                      a~ ~ pi(s)

and every term adds its own loss to L_pi, to L_Q or to both. All losses of one update are taken at the parameters from
before it (the order of the EDAC, RORL and ODAF codes); then the slow copies move.

Options of the base: with `target="member"` each member has a target of its own, its slow copy less `target_deviations`
times the slow copies' disagreement (PBRL). With `return_steps` n above 1, r is the discounted sum of the next n logged
rewards, s' the state n steps on, and the discount of the target its n-th power. `reward_scale` multiplies all rewards;
`warm_start` fits the networks to the log before the first update.

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
import numpy as np
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.terms.base import Context, Term
from odaf.algorithms.warm_start import fit_to_log, returns_to_go
from odaf.components.adam import adam_step, first_moments
from odaf.components.critics import CriticEnsemble, disagreement, init_critics
from odaf.components.losses import ensemble_td_gradient, soft_actor_loss, temperature_loss
from odaf.components.networks import Products
from odaf.components.policies import GaussianActor, init_gaussian_actor
from odaf.components.targets import bellman_target, copy_of, polyak, value_range
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError

LARGEST_SCALED_VALUE = 10.0  # of `reward_scale="auto"`


class EnsembleState(LearnerState):
    """State of the ensemble soft actor-critic."""

    step: Int[Array, ""]
    actor: GaussianActor
    slow_actor: GaussianActor  # pi'
    critics: CriticEnsemble
    target_critics: CriticEnsemble  # Q'
    log_temperature: Float[Array, ""]
    target_entropy: Float[Array, ""]  # H, in nats
    actor_optimiser: optax.OptState
    critic_optimiser: optax.OptState
    temperature_optimiser: optax.OptState
    reward_scale: Float[Array, ""]
    value_bounds: Float[Array, "2"]  # of scaled rewards
    side: tuple[PyTree, ...]  # one entry a term, frozen
    memory: tuple[PyTree, ...]  # one entry a term, what it carries from update to update


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
    prior_scale: float = 0.0
    """Factor of a fixed random network added to each critic and to its slow copy (PBRL-Prior 1.0); 0 adds none."""
    products: Products = "float32"
    """Format that the critics' hidden layers round the factors of their products to; sums, parameters and optimiser
    stay in float32. "bfloat16" is faster on processors with instructions for it, see docs/speed.md."""
    target: Literal["min", "member"] = "min"
    """Values in the critics' targets: the lowest slow critic for all members, or each member's own slow copy."""
    target_deviations: float = 0.0
    """Standard deviations over the slow critics that are taken off those values (PBRL 0.01)."""
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
    reward_scale: Literal["auto"] | float = 1.0
    """Factor on all rewards. "auto" makes the largest value that the logged rewards allow 10, a size that an optimiser
    reaches soon. Weights of terms and the entropy bonus stand beside scaled values; metrics are in the log's units."""
    warm_start: Literal["none", "returns"] = "none"
    """"returns" first fits the critics to the logged discounted returns and the actor to the logged actions."""
    warm_start_steps: int = 4000
    """Updates of that fit."""
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
    target_entropy: Literal["log"] | float | None = None
    """Entropy in nats that alpha steers to; None gives minus the number of action dimensions, "log" the entropy of the
    actor that the warm start fits to the logged actions."""
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
        if self.target_entropy == "log" and self.warm_start == "none":
            raise ConfigError(
                "target_entropy='log' is measured by the warm start; set warm_start='returns' or a number"
            )
        if self.reward_scale != "auto" and not 0.0 < self.reward_scale < math.inf:
            raise ConfigError(f"reward_scale={self.reward_scale} must be positive, or 'auto'")
        for field in ("prior_scale", "target_deviations"):
            if getattr(self, field) < 0.0:
                raise ConfigError(f"{field}={getattr(self, field)} must not be negative")
        for field in ("batch_size", "return_steps", "warm_start_steps"):
            if getattr(self, field) < 1:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least 1")
        if any(width < 1 for width in self.hidden_sizes):
            raise ConfigError(f"hidden_sizes={self.hidden_sizes} must hold widths of at least 1")
        for term in self.active_terms:
            if term.needs_next_state and self.return_steps > 1:
                raise ConfigError(
                    f"return_steps={self.return_steps}: the term {term.name} reads the state after one step; set 1"
                )
        names = [term.name for term in self.terms]
        if len(set(names)) < len(names):
            raise ConfigError(f"terms {names} contain one term twice")

    @property
    def active_terms(self) -> tuple[Term, ...]:
        """Terms whose weight is not 0."""
        return tuple(term for term in self.terms if term.weight != 0.0)

    # ---- before training ----------------------------------------------------------------------------------------

    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> tuple[PyTree, ...]:
        """The active terms' side networks, untrained; with a warm start, what it fits behind them."""
        sides = tuple(term.untrained_side(_key_for(term, key), spec) for term in self.active_terms)
        return sides if self.warm_start == "none" else (*sides, (*self._networks(key, spec), jnp.zeros(())))

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[tuple[PyTree, ...], dict[str, Any]]:
        """Train each active term's side network, then the warm start; the report has an entry for each."""
        sides: list[PyTree] = []
        report: dict[str, Any] = {"warnings": []}
        for term in self.active_terms:
            side, findings = term.pretrain(dataset, normaliser, _key_for(term, key), progress)
            sides.append(side)
            report["warnings"] += findings.pop("warnings")
            if findings:
                report[term.name] = findings
        if self.warm_start == "returns":
            spec, key_fit = dataset.spec(), jr.fold_in(key, zlib.crc32(b"warm start"))
            low, high = np.asarray(self._value_bounds(spec))
            actor, critics, findings = fit_to_log(
                *self._networks(key, spec),
                dataset,
                normaliser,
                np.clip(self._scale(spec) * returns_to_go(dataset, self.discount), low, high),
                key_fit,
                steps=self.warm_start_steps,
                batch_size=self.batch_size,
                learning_rate=self.critic_learning_rate,
                progress=lambda done, steps: progress("warm start", done, steps),
            )
            sides.append((actor, critics, jnp.asarray(-findings["action_log_density"], dtype=jnp.float32)))
            report["warm_start"] = findings
        return tuple(sides), report

    def init(self, key: PRNGKeyArray, spec: Spec, side: tuple[PyTree, ...]) -> EnsembleState:
        """Random networks or those of the warm start, slow copies equal to them, fresh optimisers."""
        if self.warm_start == "none":
            actor, critics = self._networks(key, spec)
            logged_entropy = jnp.nan
        else:
            side, (actor, critics, logged_entropy) = side[:-1], side[-1]
        target_entropy = -spec.act_dim if self.target_entropy is None else self.target_entropy
        log_temperature = jnp.asarray(math.log(self.initial_temperature), dtype=jnp.float32)
        return EnsembleState(
            step=jnp.asarray(0),
            actor=actor,
            slow_actor=copy_of(actor),
            critics=critics,
            target_critics=copy_of(critics),
            log_temperature=log_temperature,
            target_entropy=jnp.asarray(logged_entropy if target_entropy == "log" else target_entropy, jnp.float32),
            actor_optimiser=first_moments(actor),
            critic_optimiser=first_moments(critics),
            temperature_optimiser=first_moments(log_temperature),
            reward_scale=jnp.asarray(self._scale(spec), dtype=jnp.float32),
            value_bounds=self._value_bounds(spec),
            side=side,
            memory=tuple(term.first_memory() for term in self.active_terms),
        )

    def _networks(self, key: PRNGKeyArray, spec: Spec) -> tuple[GaussianActor, CriticEnsemble]:
        key_actor, key_critics = jr.split(key)
        critics = init_critics(
            key_critics,
            spec.obs_dim,
            spec.act_dim,
            self.hidden_sizes,
            self.num_critics,
            self.critic_norm,
            self.critic_output_bound,
            self.prior_scale,
            self.products,
        )
        return init_gaussian_actor(key_actor, spec.obs_dim, spec.act_dim, self.hidden_sizes), critics

    def _scale(self, spec: Spec) -> float:
        if self.reward_scale != "auto":
            return self.reward_scale
        return LARGEST_SCALED_VALUE / (max(map(abs, value_range(spec, self.discount))) or LARGEST_SCALED_VALUE)

    def _value_bounds(self, spec: Spec) -> Float[Array, "2"]:
        bounds = value_range(spec, self.discount) if self.value_range == "auto" else (-math.inf, math.inf)
        return jnp.asarray(bounds, dtype=jnp.float32) * self._scale(spec)

    # ---- losses -------------------------------------------------------------------------------------------------

    def targets(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, "*critics rows"]:
        """y, clipped to the value range: one for all members, or with `target="member"` one for each."""
        noise = jr.normal(key, batch.actions.shape)
        next_actions, log_density = state.actor.sample(batch.next_observations, noise)
        members = state.target_critics(batch.next_observations, next_actions)
        next_values = jnp.min(members, axis=0) if self.target == "min" else members

        def beside(column: Float[Array, " rows"]) -> Float[Array, "*one rows"]:
            return column if self.target == "min" else column[None, :]

        if self.target_deviations != 0.0:
            next_values = next_values - self.target_deviations * beside(disagreement(members, ddof=1))
        if self.entropy_in_backup:
            next_values = next_values - jnp.exp(state.log_temperature) * beside(log_density)
        rewards, terminated = beside(state.reward_scale * batch.rewards), beside(batch.terminated)
        y = bellman_target(rewards, terminated, next_values, self.discount**self.return_steps)
        return jnp.clip(y, state.value_bounds[0], state.value_bounds[1])

    def critic_gradient(
        self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[CriticEnsemble, Metrics]:
        """Gradient of L_Q plus the terms' additions with respect to the critics."""
        y = self.targets(state, batch, jr.fold_in(key, 0))
        gradient, loss, values = ensemble_td_gradient(state.critics, batch.observations, batch.actions, y)
        metrics = {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values) / state.reward_scale,
            "critic/min": jnp.min(values) / state.reward_scale,
            "critic/max": jnp.max(values) / state.reward_scale,
            "target/mean": jnp.mean(y) / state.reward_scale,
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
        for term, side, memory in zip(self.active_terms, state.side, state.memory, strict=True):
            if term.acts_on_critics:
                context = dataclasses.replace(context, memory=memory)
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
        value = jnp.mean(values) / state.reward_scale
        metrics = {"actor/loss": loss, "actor/value": value, "actor/entropy": -jnp.mean(log_density)}
        context = self._context(state, batch, actor=actor)
        for term, side, memory in zip(self.active_terms, state.side, state.memory, strict=True):
            if term.acts_on_actor:
                context = dataclasses.replace(context, memory=memory)
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
        temperature_gradient = jax.grad(temperature_loss)(state.log_temperature, log_density, state.target_entropy)

        actor, actor_optimiser = adam_step(self.actor_learning_rate, actor_gradient, state.actor_optimiser, state.actor)
        critics, critic_optimiser = adam_step(
            self.critic_learning_rate, critic_gradient, state.critic_optimiser, state.critics
        )
        log_temperature, temperature_optimiser = adam_step(
            self.temperature_learning_rate, temperature_gradient, state.temperature_optimiser, state.log_temperature
        )
        metrics = actor_metrics | critic_metrics | {"temperature/value": jnp.exp(log_temperature)}
        target_networks = polyak(state.target_critics.networks, critics.networks, self.target_rate)
        new_state = dataclasses.replace(
            state,
            step=state.step + 1,
            actor=actor,
            slow_actor=polyak(state.slow_actor, actor, self.slow_actor_rate),
            critics=critics,
            target_critics=dataclasses.replace(state.target_critics, networks=target_networks),
            log_temperature=log_temperature,
            actor_optimiser=actor_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
            memory=tuple(
                term.next_memory(memory, state.step + 1, metrics)
                for term, memory in zip(self.active_terms, state.memory, strict=True)
            ),
        )
        return new_state, metrics

    def actor(self, state: EnsembleState) -> GaussianActor:
        """The deployed one of pi and pi'."""
        return state.actor if self.deployed_actor == "current" else state.slow_actor

    def values(self, state: EnsembleState) -> CriticEnsemble:
        """The online critics, of scaled rewards."""
        return state.critics

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


def _key_for(term: Term, key: PRNGKeyArray) -> PRNGKeyArray:
    """A key that depends on the term's name, so that adding one term does not change another's noise."""
    return jr.fold_in(key, zlib.crc32(term.name.encode()))
