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
`warm_start` fits the networks to the log before the first update. With `advantage_after`, what the actor is held to
changes in the middle: at first rows as they are drawn for it, by return for instance, then logged actions that the
critics put above its own, of whatever episode.

Differs from SAC-N by default: layer-normalised critics, targets clipped to the range that the rewards allow, and no
entropy in the target. Each is a field. docs/reference/algorithms/odaf.md shows what each of them does.
"""

import dataclasses
import math
import zlib
from collections.abc import Hashable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.ensemble_settings import EnsembleSettings
from odaf.algorithms.ensemble_state import EnsembleState, Models, WarmStart
from odaf.algorithms.numbers import is_off
from odaf.algorithms.terms.base import Context, Term
from odaf.algorithms.warm_start import fit_to_log
from odaf.components.critics import CriticEnsemble, disagreement, init_critics
from odaf.components.losses import ensemble_td_gradient, soft_actor_loss, temperature_loss
from odaf.components.networks import MLP
from odaf.components.policies import GaussianActor, init_gaussian_actor
from odaf.components.priors import init_priors
from odaf.components.targets import bellman_target, value_range
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.returns_to_go import returns_to_go
from odaf.data.row_choice import log_weights
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import Extra, View

LARGEST_SCALED_VALUE = 10.0  # of `reward_scale="auto"`
# What the warm start goes by.
_WARM_START = (
    "warm_start", "warm_start_steps", "warm_start_rows", "hidden_sizes", "num_critics", "critic_norm",
    "critic_output_bound", "prior_scale", "products", "discount", "value_range", "reward_scale", "batch_size",
    "critic_learning_rate",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class EnsembleSAC(EnsembleSettings):
    """Ensemble soft actor-critic plus terms."""

    kind: ClassVar[str] = "ensemble-sac"
    draws_apart: ClassVar[bool] = True

    def can_be_padded(self) -> bool:
        """Unless a term draws or averages in a way of its own."""
        return type(self) is EnsembleSAC and all(term.can_be_padded for term in self.active_terms)

    def citations(self) -> tuple[citations.Citation, ...]:
        """SAC-N, or SAC itself where there are two critics; randomised priors where there are any."""
        base = citations.ENSEMBLES if self.num_critics > 2 else citations.SAC
        return (base,) if self.prior_scale == 0.0 else (base, citations.PRIORS)

    def view(self) -> View:
        """Rows of `return_steps` steps, with what the terms read beside; rewards are scaled by the learner itself."""
        wanted: list[Extra] = [extra for term in self.active_terms for extra in term.extras()]
        extras = tuple(dict.fromkeys(wanted))
        return View(self.return_steps, self.discount, normaliser_epsilon=self.normaliser_epsilon, extras=extras)

    # ---- before training ----------------------------------------------------------------------------------------

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> Models:
        """The active terms' models, untrained; with a warm start, fresh networks in its place."""
        models = tuple(term.untrained(_key_for(term, key), spec) for term in self.active_terms)
        start = None if self.warm_start == "none" else WarmStart(*self._networks(key, spec), jnp.zeros(()))
        return Models(models, start)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[Models, dict[str, Any]]:
        """Train each active term's model, then the warm start; the report has an entry for each."""
        models = []
        report: dict[str, Any] = {"warnings": []}
        for term in self.active_terms:
            model, findings = term.pretrain(dataset, normaliser, _key_for(term, key), progress)
            models.append(model)
            report["warnings"] += findings.pop("warnings")
            if findings:
                report[term.name] = findings
        start = None
        if self.warm_start == "returns":
            start, report["warm_start"] = self._warm_start(dataset, normaliser, key, progress)
        return Models(tuple(models), start), report

    def _warm_start(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[WarmStart, dict[str, Any]]:
        spec = dataset.spec()
        low, high = np.asarray(self._value_bounds(spec))
        actor, critics, findings = fit_to_log(
            *self._networks(key, spec),
            dataset,
            normaliser,
            np.clip(float(self._scale(spec)) * returns_to_go(dataset, self.discount), low, high),
            jr.fold_in(key, zlib.crc32(b"warm start")),
            steps=self.warm_start_steps,
            batch_size=self.batch_size,
            learning_rate=self.critic_learning_rate,
            rows=self._warm_start_rows(dataset, key),
            progress=lambda done, steps: progress("warm start", done, steps),
        )
        entropy = jnp.asarray(-findings["action_log_density"], dtype=jnp.float32)
        return WarmStart(actor, critics, entropy), findings

    def _warm_start_rows(self, dataset: Dataset, key: PRNGKeyArray) -> np.ndarray | None:
        """As many rows as the log has, drawn as often as the settings say; None is every row once."""
        if self.warm_start_rows == "all" or self.sampling == "uniform":
            return None
        weights = log_weights(dataset, self.row_choice())
        seed = jr.bits(jr.fold_in(key, zlib.crc32(b"warm start rows")), (4,))
        return np.random.default_rng(np.asarray(seed)).choice(len(dataset), len(dataset), p=weights / weights.sum())

    def pretraining(self) -> Hashable:
        """What decides the terms' models, and the settings that the warm start goes by."""
        models = tuple((term.name, term.pretraining()) for term in self.active_terms)
        if self.warm_start == "none":
            return models
        return models, self.row_choice(), tuple(getattr(self, name) for name in _WARM_START)

    def init(self, key: PRNGKeyArray, spec: Spec, models: Models) -> EnsembleState:
        """Random networks or those of the warm start, slow copies equal to them, fresh optimisers."""
        start = models.warm_start
        actor, critics = self._networks(key, spec) if start is None else (start.actor, start.critics)
        target_entropy = -spec.act_dim if self.target_entropy is None else self.target_entropy
        if isinstance(target_entropy, str):
            assert start is not None  # the settings insist on a warm start
            target_entropy = start.log_entropy
        return EnsembleState(
            step=jnp.asarray(0),
            actor=Trained.begin(actor),
            critics=Trained.begin(critics.networks),
            priors=critics.priors,
            log_temperature=Trained.begin(jnp.log(jnp.asarray(self.initial_temperature, jnp.float32)), slow=False),
            target_entropy=jnp.asarray(target_entropy, jnp.float32),
            reward_scale=self._scale(spec),
            value_bounds=self._value_bounds(spec),
            terms=tuple(term.init(model) for term, model in zip(self.active_terms, models.terms, strict=True)),
        )

    def _networks(self, key: PRNGKeyArray, spec: Spec) -> tuple[GaussianActor, CriticEnsemble]:
        key_actor, key_critics = jr.split(key)
        shape = (spec.obs_dim, spec.act_dim, self.hidden_sizes)
        networks = init_critics(
            key_critics, *shape, self.num_critics, self.critic_norm, self.critic_output_bound, self.products
        )
        priors = init_priors(key_critics, *shape, self.num_critics, self.prior_scale, self.products)
        return init_gaussian_actor(key_actor, *shape), CriticEnsemble(networks, priors)

    def _scale(self, spec: Spec) -> Float[Array, ""]:
        if not isinstance(self.reward_scale, str):
            return jnp.asarray(self.reward_scale, jnp.float32)
        if self.reward_scale == "unit":
            largest = max(abs(spec.reward_min), abs(spec.reward_max))
            exponent = math.ceil(math.log2(largest)) if largest > 0.0 else 0
            return jnp.asarray(2.0**-exponent, jnp.float32)
        low, high = value_range(spec, self.discount)
        largest = jnp.maximum(jnp.abs(low), jnp.abs(high))
        return jnp.where(largest > 0.0, LARGEST_SCALED_VALUE / largest, 1.0).astype(jnp.float32)

    def _value_bounds(self, spec: Spec) -> Float[Array, "2"]:
        if self.value_range == "none":
            return jnp.asarray((-jnp.inf, jnp.inf), jnp.float32)
        low, high = value_range(spec, self.discount)
        return self._scale(spec) * jnp.stack([jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32)])

    # ---- losses -------------------------------------------------------------------------------------------------

    def targets(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, "*critics rows"]:
        """y, clipped to the value range: one for all members, or with `target="member"` one for each."""
        noise = batch.action_noise(key)
        next_actions, log_density = state.actor.now.sample(batch.next_observations, noise, batch.own_actions)
        members = state.target_critics(batch.next_observations, next_actions)
        next_values = jnp.min(members, axis=0) if self.target == "min" else members

        def beside(column: Float[Array, " rows"]) -> Float[Array, "*one rows"]:
            return column if self.target == "min" else column[None, :]

        if not is_off(self.target_deviations):
            next_values = next_values - self.target_deviations * beside(disagreement(members, ddof=1))
        if self.entropy_in_backup:
            next_values = next_values - jnp.exp(state.log_temperature.now) * beside(log_density)
        context = self._context(state, batch)
        for term, own in zip(self.active_terms, state.terms, strict=True):
            if term.acts_on_target:
                penalty = term.target_penalty(context, own, next_actions, log_density, _key_for(term, key))
                next_values = next_values - beside(penalty)
        rewards, terminated = beside(state.reward_scale * batch.rewards), beside(batch.terminated)
        y = bellman_target(rewards, terminated, next_values, self.discount**self.return_steps)
        return jnp.clip(y, state.value_bounds[0], state.value_bounds[1])

    def critic_gradient(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> tuple[MLP, Metrics]:
        """Gradient of L_Q plus the terms' additions with respect to the critics' networks."""
        y = self.targets(state, batch, jr.fold_in(key, 0))
        critics = state.online_critics
        gradient, loss, values = ensemble_td_gradient(critics, batch.observations, batch.actions, y)
        metrics = {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values) / state.reward_scale,
            "critic/min": jnp.min(values) / state.reward_scale,
            "critic/max": jnp.max(values) / state.reward_scale,
            "target/mean": jnp.mean(y) / state.reward_scale,
        }
        if any(term.acts_on_critics for term in self.active_terms):
            additions = eqx.filter_grad(self.critic_additions, has_aux=True)
            addition, more = additions(critics, state, batch, key)
            gradient, metrics = jax.tree.map(jnp.add, gradient, addition), metrics | more
        return gradient.networks, metrics

    def critic_additions(
        self, critics: CriticEnsemble, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """What the terms add to L_Q, as a function of the critics."""
        loss, metrics = jnp.zeros(()), {}
        context = self._context(state, batch, critics=critics)
        for term, own in zip(self.active_terms, state.terms, strict=True):
            if term.acts_on_critics:
                addition, more = term.critic_loss(context, own, _key_for(term, key))
                loss, metrics = loss + addition, metrics | more
        return loss, metrics

    def actor_loss(
        self, actor: GaussianActor, state: EnsembleState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], tuple[Float[Array, " rows"], Metrics]]:
        """L_pi and the terms' additions, as a function of the actor; also log pi(a~|s) for the temperature."""
        noise = batch.action_noise(jr.fold_in(key, 0))
        actions, log_density = actor.sample(batch.observations, noise, batch.own_actions)
        critics = state.online_critics if self.actor_critic == "online" else state.target_critics
        values = jnp.min(critics.as_constants(batch.observations, actions), axis=0)
        loss = soft_actor_loss(log_density, values, jnp.exp(state.log_temperature.now))
        value = jnp.mean(values) / state.reward_scale
        metrics = {"actor/loss": loss, "actor/value": value, "actor/entropy": -jnp.mean(log_density)}
        context = self._context(state, batch, actor=actor, values=values)
        if self.advantage_after:
            logged = jnp.min(critics(batch.observations, batch.actions), axis=0)
            counted = jnp.logical_or(self._is_early(state), logged > values).astype(values.dtype)
            context = dataclasses.replace(context, counted=jax.lax.stop_gradient(counted))
            metrics["behaviour/counted"] = jnp.mean(counted)
        for term, own in zip(self.active_terms, state.terms, strict=True):
            if term.acts_on_actor:
                addition, more = term.actor_loss(context, own, _key_for(term, key))
                loss, metrics = loss + addition, metrics | more
        return loss, (log_density, metrics)

    # ---- training -----------------------------------------------------------------------------------------------

    def update(self, state: EnsembleState, batch: Transitions, key: PRNGKeyArray) -> tuple[EnsembleState, Metrics]:
        """Actor, temperature and critics step from the same old parameters; then the slow copies move."""
        key_actor, key_critic = jr.split(key)
        actor_gradient, (log_density, actor_metrics) = eqx.filter_grad(self.actor_loss, has_aux=True)(
            state.actor.now, state, self._actor_rows(state, batch), key_actor
        )
        critic_gradient, critic_metrics = self.critic_gradient(state, batch, key_critic)
        temperature_gradient = jax.grad(temperature_loss)(state.log_temperature.now, log_density, state.target_entropy)

        log_temperature = state.log_temperature.stepped(temperature_gradient, self.temperature_learning_rate)
        metrics = actor_metrics | critic_metrics | {"temperature/value": jnp.exp(log_temperature.now)}
        new_state = dataclasses.replace(
            state,
            step=state.step + 1,
            actor=state.actor.stepped(actor_gradient, self.actor_learning_rate, self.slow_actor_rate),
            critics=state.critics.stepped(critic_gradient, self.critic_learning_rate, self.target_rate),
            log_temperature=log_temperature,
            terms=tuple(
                term.next_state(own, state.step + 1, metrics)
                for term, own in zip(self.active_terms, state.terms, strict=True)
            ),
        )
        return new_state, metrics

    def _actor_rows(self, state: EnsembleState, batch: Transitions) -> Transitions:
        """Those drawn for it; after `advantage_after` updates those of the critics."""
        if not self.advantage_after or batch.actor is None:
            return batch.for_actor
        early = self._is_early(state)
        later = dataclasses.replace(batch, actor=None)
        return jax.tree.map(lambda drawn, shared: jnp.where(early, drawn, shared), batch.actor, later)

    def _is_early(self, state: EnsembleState) -> Bool[Array, ""]:
        return state.step < self.advantage_after

    def actor(self, state: EnsembleState) -> GaussianActor:
        """The deployed one of pi and pi'."""
        return state.actor.now if self.deployed_actor == "current" else state.slow_actor

    def values(self, state: EnsembleState) -> CriticEnsemble:
        """The online critics, of scaled rewards."""
        return state.online_critics

    def _context(
        self,
        state: EnsembleState,
        batch: Transitions,
        *,
        actor: GaussianActor | None = None,
        critics: CriticEnsemble | None = None,
        values: Float[Array, " rows"] | None = None,
    ) -> Context:
        return Context(
            batch=batch,
            actor=state.actor.now if actor is None else actor,
            slow_actor=state.slow_actor,
            critics=state.online_critics if critics is None else critics,
            target_critics=state.target_critics,
            value_bounds=state.value_bounds,
            step=state.step,
            values=values,
        )


def _key_for(term: Term, key: PRNGKeyArray) -> PRNGKeyArray:
    """A key that depends on the term's name, so that adding one term does not change another's noise."""
    return jr.fold_in(key, zlib.crc32(term.name.encode()))
