"""ODAF's term: penalise actions whose outcome, in the worst case around the state, is one that the critics disagree on.

    L_odaf = weight * mean_s max_{|s^ - s| <= radius} U( P(s^, a^) ),   a^ ~ pi(s^)
    U(s')  = std_k Q_k(s', a'),                                       a' ~ pi'(s')

P is a dynamics model fitted to the log beforehand, pi' a slowly moving copy of pi. Steps 2 to 6 of the paper's
Algorithm 1 stand in `outcome_uncertainty` and `worst_case` below. Beyond the paper, with a `target_weight` the critics'
target falls by target_weight U( P(s', a') ), a' ~ pi(s'), with the slow critics and without a box, so that values
themselves do not climb where the policy's outcomes are unknown. The page docs/reference/algorithms/odaf.md lists the
misprints of the paper and how each is read here.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.numbers import is_off
from odaf.algorithms.terms.base import Context, Term
from odaf.components.critics import CriticEnsemble, disagreement
from odaf.components.dynamics import DynamicsConfig, DynamicsModel, fit_dynamics
from odaf.components.dynamics import untrained as untrained_dynamics
from odaf.components.perturbations import draw_offsets, signed_ascent
from odaf.components.targets import frozen
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.errors import ConfigError

DRAWS_A_STEP = 4  # written out in one step of the compiled loop: a sixth faster than one, for a second of compilation
Noise = tuple[Float[Array, "rows act_dim"], PyTree[Array], Float[Array, "rows act_dim"]]


@dataclasses.dataclass(frozen=True)
class OutcomePenalty(Term):
    """Worst-case disagreement of the critics at the predicted next state."""

    name: ClassVar[str] = "outcome"
    acts_on_actor: ClassVar[bool] = True
    acts_on_target: ClassVar[bool] = True

    weight: float = 0.3
    """beta_odaf, the penalty's weight in the actor's loss; 0 leaves the term out."""
    target_weight: float = 0.0
    """Weight of the next action's outcome's uncertainty, taken off the value of the next state in the critics' target;
    0 (the paper) leaves the target as it is."""
    radius: float = 0.01
    """epsilon_odaf, half the edge of the box around a state, in standard deviations of the log."""
    solver: Literal["gradient", "sample"] = "gradient"
    """How the worst case is found: signed gradient ascent, or the best of num_draws uniform draws (the paper)."""
    ascent_steps: int = 1
    """Projected steps of the gradient solver."""
    num_draws: int = 20
    """Draws a state of the sample solver."""
    reduce: Literal["max", "mean"] = "max"
    """Worst case over the draws, or their mean (sample solver only)."""
    num_states: int | None = None
    """States of the batch that the penalty is averaged over, the first so many; None takes all. Fewer cost less."""
    include_centre: bool = False
    """Make the state itself one of the draws."""
    common_noise: bool = False
    """Every draw of the sample solver judges one noise of action and model, as the gradient solver does, so that only
    the box is searched; False (the paper) draws it anew, and the worst case is one over that noise too."""
    shared_draws: bool = False
    """One set of offsets for the whole batch instead of one a state."""
    next_policy: Literal["slow", "current"] = "slow"
    """Policy that acts at the predicted state: the slow copy pi', or pi itself (its parameters frozen)."""
    next_action: Literal["sample", "mode"] = "sample"
    """Draw that action, or take the policy's deterministic one."""
    next_action_at: Literal["outcome", "perturbed"] = "outcome"
    """State at which that action is chosen: the predicted one, or the perturbed current one (the released code)."""
    detach_next_action: bool = False
    """Stop the gradient from U to the predicted state at the action a', leaving the direct path."""
    std_ddof: Literal[0, 1] = 0
    """0 divides the variance by K (the paper), 1 by K - 1 (the released code)."""
    dynamics: DynamicsConfig = dataclasses.field(default_factory=DynamicsConfig)
    """The model of the next state."""

    @property
    def can_be_padded(self) -> bool:
        """With a model without draws: those of the others are for a state of all widths. The gradient solver stays at 0
        along a column that no network sees."""
        return self.dynamics.kind == "deterministic"

    def citations(self) -> tuple[citations.Citation, ...]:
        """ODAF."""
        return (citations.ODAF,)

    def __post_init__(self) -> None:
        if self.reduce == "mean" and self.solver != "sample":
            raise ConfigError(
                "outcome.reduce='mean' averages over draws, but outcome.solver='gradient' draws none; "
                "set outcome.solver='sample' or outcome.reduce='max'"
            )
        counts = {"num_draws": self.num_draws, "ascent_steps": self.ascent_steps, "num_states": self.num_states}
        for field, count in counts.items():
            if count is not None and count < 1:
                raise ConfigError(f"outcome.{field}={count} must be at least 1")
        amounts = {"weight": self.weight, "target_weight": self.target_weight, "radius": self.radius}
        for field, amount in amounts.items():
            if amount < 0:
                raise ConfigError(f"outcome.{field}={amount} must not be negative")

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> DynamicsModel:
        """The dynamics model before training."""
        return untrained_dynamics(self.dynamics, key, spec.obs_dim, spec.act_dim)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[DynamicsModel, dict[str, Any]]:
        """Fit the dynamics model on the log."""
        return fit_dynamics(
            self.dynamics, dataset, normaliser, key, lambda done, steps: progress("dynamics model", done, steps)
        )

    def pretraining(self) -> Hashable:
        """The model's settings."""
        return self.dynamics

    def actor_loss(self, context: Context, state: DynamicsModel, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean_s of the worst case of U; its gradient reaches the actor only."""
        uncertainty = self.worst_case(context, state, key)
        mean = jnp.mean(uncertainty)
        return self.weight * mean, {"outcome/uncertainty": mean, "outcome/uncertainty/max": jnp.max(uncertainty)}

    def target_penalty(
        self,
        context: Context,
        state: DynamicsModel,
        next_actions: Float[Array, "rows act_dim"],
        log_density: Float[Array, " rows"],
        key: PRNGKeyArray,
    ) -> Float[Array, " rows"]:
        """target_weight U( P(s', a') )."""
        del log_density
        if is_off(self.target_weight):
            return jnp.zeros(next_actions.shape[0])
        noise = self._draw_noise(context, state, next_actions.shape[0], key)
        at = context.batch.next_observations
        return self.target_weight * self._after(context, context.target_critics, state, at, next_actions, noise)

    def worst_case(self, context: Context, dynamics: DynamicsModel, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """Worst U (or, with reduce="mean", mean U) over the box around each state of the batch.

        The maximiser is chosen without gradients and only its value is differentiated, with the same noise. By the
        envelope theorem this is the gradient of the maximum itself.
        """
        context = self._without_gradients(context)
        dynamics = frozen(dynamics)
        states = context.batch.observations[: self.num_states]
        rows, obs_dim = states.shape
        key_noise, key_offsets = jr.split(key)

        if self.solver == "gradient":
            noise = self._draw_noise(context, dynamics, rows, key_noise)
            fixed_actor = frozen(context.actor)

            def at(offsets: Float[Array, "rows obs_dim"]) -> Float[Array, " rows"]:
                return self.outcome_uncertainty(context, fixed_actor, dynamics, states + offsets, noise)

            offsets = signed_ascent(at, jnp.zeros_like(states), self.radius, self.ascent_steps)
            return self.outcome_uncertainty(context, context.actor, dynamics, states + offsets, noise)

        offsets = draw_offsets(
            key_offsets,
            self.num_draws,
            rows,
            obs_dim,
            self.radius,
            shared=self.shared_draws,
            include_centre=self.include_centre,
            padding=context.batch.padding,
        )
        if self.common_noise:
            common = self._draw_noise(context, dynamics, rows, key_noise)
            noises = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[None], (self.num_draws, *leaf.shape)), common)
        else:
            keys = jr.split(key_noise, self.num_draws)
            noises = jax.vmap(lambda k: self._draw_noise(context, dynamics, rows, k))(keys)
        # without gradients where only the winner is differentiated
        judging_actor = context.actor if self.reduce == "mean" else frozen(context.actor)

        def judge(_: None, draw: tuple[Float[Array, "rows obs_dim"], Noise]) -> tuple[None, Float[Array, " rows"]]:
            return None, self.outcome_uncertainty(context, judging_actor, dynamics, states + draw[0], draw[1])

        # one draw after another, so that the activations of a pass stay in the cache
        _, scores = jax.lax.scan(judge, None, (offsets, noises), unroll=DRAWS_A_STEP)
        if self.reduce == "mean":
            return jnp.mean(scores, axis=0)
        best = jnp.argmax(jax.lax.stop_gradient(scores), axis=0)
        offset, noise = jax.tree.map(lambda draws: draws[best, jnp.arange(rows)], (offsets, noises))
        return self.outcome_uncertainty(context, context.actor, dynamics, states + offset, noise)

    def outcome_uncertainty(
        self,
        context: Context,
        actor: Any,
        dynamics: DynamicsModel,
        perturbed: Float[Array, "rows obs_dim"],
        noise: Noise,
    ) -> Float[Array, " rows"]:
        """U(P(s^, a^)) for one perturbed state s^ a row; differentiable in `actor` and `perturbed`."""
        action, _ = actor.sample(perturbed, noise[0], context.batch.own_actions)  # a^ ~ pi(s^)
        return self._after(context, context.critics, dynamics, perturbed, action, noise)

    def _after(
        self,
        context: Context,
        critics: CriticEnsemble,
        dynamics: DynamicsModel,
        perturbed: Float[Array, "rows obs_dim"],
        action: Float[Array, "rows act_dim"],
        noise: Noise,
    ) -> Float[Array, " rows"]:
        """U(P(s^, a^)), once a^ is chosen."""
        _, dynamics_noise, next_noise = noise
        outcome = dynamics.predict(perturbed, action, dynamics_noise)  # s^' = P(s^, a^)
        next_actor = context.slow_actor if self.next_policy == "slow" else frozen(context.actor)
        state = outcome if self.next_action_at == "outcome" else perturbed
        if self.next_action == "sample":
            next_action, _ = next_actor.sample(state, next_noise, context.batch.own_actions)  # a^' ~ pi'(s^')
        else:
            next_action = next_actor.mode(state)
        if self.detach_next_action:
            next_action = jax.lax.stop_gradient(next_action)
        return disagreement(critics.as_constants(outcome, next_action), self.std_ddof)  # U = std_k Q_k(s^', a^')

    @staticmethod
    def _draw_noise(context: Context, dynamics: DynamicsModel, rows: int, key: PRNGKeyArray) -> Noise:
        key_action, key_dynamics, key_next = jr.split(key, 3)
        return (
            context.batch.action_noise(key_action, rows),
            dynamics.draw_noise(key_dynamics, rows),
            context.batch.action_noise(key_next, rows),
        )

    @staticmethod
    def _without_gradients(context: Context) -> Context:
        """Everything but the actor becomes a constant."""
        return dataclasses.replace(
            context,
            slow_actor=frozen(context.slow_actor),
            critics=frozen(context.critics),
            target_critics=frozen(context.target_critics),
        )
