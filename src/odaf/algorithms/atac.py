"""ATAC: actor and critics play a game in which critics rate the actor below the log as far as the log allows.

    y        = clip( r + discount (1 - d) min_k f'_k(s', a'), low, high ),                  a' ~ pi(s')
    E_td     = mean_B ( f_k(s, a) - y )^2
    E_res    = mean_B ( f_k(s, a) - r - discount (1 - d) f_k(s', a') )^2
    Bellman  = (1 - w) E_td + w E_res,                                                      w = residual_weight
    L_f      = sum_k ( mean_B ( f_k(s, a~) - f_k(s, a) ) + beta Bellman_k ),                a~ ~ pi(s)
    L_pi     = - mean_B f_1(s, a~) - alpha mean_B H( pi(s) )

(Cheng et al. 2022.) The gradient of E_res passes through both of its f_k; actions and y are constants for the critics.
A loss l + c m with c above 1 is divided by c, which keeps gradients small: `tempered`. After each step every weight
matrix of a critic is projected onto the ball of Frobenius norm `weight_norm`; then the slow copies f' move, then alpha
steps, then the actor against the new first critic and by the new alpha.

Critics and alpha are fast, the actor is a thousand times slower. For the first `warm_start_updates` all are fast, the
critics minimise Bellman alone and the actor clones: - log pi(a|s) stands in place of - f_1. Then the actor goes on at
its slow pace with fresh moments.

Differs from the paper: observations are normalised. The variant that compares at first states (ATAC_0) is not here.
"""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.algorithms.ranges import (
    require_counts,
    require_not_negative,
    require_order,
    require_positive,
    require_temporal_difference,
    require_unit_interval,
)
from odaf.components.adam import initial_moments
from odaf.components.critics import CriticEnsemble, init_critics, over_members
from odaf.components.losses import td_loss, temperature_loss
from odaf.components.networks import MLP, init_mlp
from odaf.components.numbers import Number
from odaf.components.policies import HEAD_BOUND, ExactGaussianActor
from odaf.components.targets import bellman_target, polyak
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View

LOG_STD_MIN, LOG_STD_MAX = math.log(1e-5), math.log(10.0)
LARGEST_ACTION = 1.0 - 1e-6  # logged actions are cut to plus or minus this


class ATACState(LearnerState):
    """State of ATAC."""

    step: Int[Array, ""]
    actor: Trained[ExactGaussianActor]  # no slow copy
    critics: Trained[MLP]  # f_1, f_2
    log_temperature: Trained[Float[Array, ""]]  # log alpha; no slow copy


def tempered(loss: Float[Array, ""], other: Float[Array, ""], weight: Number) -> Float[Array, ""]:
    """loss + weight * other, divided by the weight where that is above 1."""
    return (loss + weight * other) / jnp.maximum(weight, 1.0)


def projected(networks: MLP, largest: Number) -> MLP:
    """Every weight matrix scaled down to a Frobenius norm of at most `largest`; biases stay."""

    def scaled(weight: Float[Array, "*stack fan_in fan_out"]) -> Float[Array, "*stack fan_in fan_out"]:
        squares = jnp.sum(jnp.square(weight), axis=(-2, -1), keepdims=True)
        return weight * jnp.where(squares > largest**2, largest * jax.lax.rsqrt(jnp.maximum(squares, 1e-30)), 1.0)

    return dataclasses.replace(networks, weights=tuple(map(scaled, networks.weights)))


@dataclasses.dataclass(frozen=True)
class ATAC(Algorithm[ATACState]):
    """Adversarially trained actor-critic: critics as pessimistic about the actor as Bellman's equation allows."""

    kind: ClassVar[str] = "atac"
    warm_up: ClassVar[str | None] = "warm_start_updates"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    bellman_weight: float = 16.0
    """beta: weight of Bellman's error beside the pessimism, whose weight is 1; smaller is more pessimistic."""
    residual_weight: float = 0.5
    """w: share of the error of the critic against itself in Bellman's error; the rest is against the slow critics."""
    weight_norm: float = 100.0
    """Largest Frobenius norm of a critic's weight matrix."""
    value_min: float | None = None
    """Least target, in shifted rewards (ant mazes -100); None sets no bound."""
    value_max: float | None = None
    """Largest target, in shifted rewards (ant mazes 0); None sets no bound."""
    warm_start_updates: int = 100_000
    """Updates at the start in which the actor clones the log and the critics learn its policy's values; they count
    among the updates of a run, so a short run needs fewer."""
    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of the hidden layers of actor and critics."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    reward_shift: float = 0.0
    """Added to every reward, such as -1 in mazes whose reward is 1 at the goal."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    actor_learning_rate: float = 5e-7
    """Step size of Adam for the actor after the warm start."""
    critic_learning_rate: float = 5e-4
    """Step size of Adam for the critics and log alpha, and for the actor in the warm start."""
    initial_temperature: float = 1.0
    """alpha at step 0."""
    target_entropy: float | None = None
    """Entropy in nats that alpha steers to; None gives minus the number of action dimensions."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        require_temporal_difference(self)
        require_unit_interval(self, "residual_weight", "a share of Bellman's error")
        require_positive(self, ("bellman_weight", "weight_norm", "initial_temperature"))
        require_counts(self, ["batch_size"])
        require_not_negative(self, ("warm_start_updates", "normaliser_epsilon"))
        require_order(self, "value_min", "value_max")

    def citations(self) -> tuple[citations.Citation, ...]:
        """ATAC."""
        return (citations.ATAC,)

    def view(self) -> View:
        """Single rows with the reward as logged."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> ATACState:
        """Random networks, the actor with a standard deviation near 1; slow critics equal to the critics."""
        del models
        key_actor, key_critics = jr.split(key)
        sizes = (spec.obs_dim, *self.hidden_sizes, 2 * spec.act_dim)
        network = init_mlp(key_actor, sizes, hidden_bias=0.0, output_bound=HEAD_BOUND)
        shape = (spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(key_critics, *shape, 2, "none", output_bound=None, hidden_bias=0.0)
        log_temperature = jnp.log(jnp.asarray(self.initial_temperature, jnp.float32))
        return ATACState(
            step=jnp.asarray(0),
            actor=Trained.begin(ExactGaussianActor(network, None, None, LOG_STD_MIN, LOG_STD_MAX), slow=False),
            critics=Trained.begin(projected(critics, self.weight_norm)),
            log_temperature=Trained.begin(log_temperature, slow=False),
        )

    # ---- losses -------------------------------------------------------------------------------------------------

    def rewards(self, batch: Transitions) -> Float[Array, " rows"]:
        """r."""
        return batch.rewards + self.reward_shift

    def target(
        self, state: ATACState, batch: Transitions, next_actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        assert state.critics.slow is not None
        members = CriticEnsemble(state.critics.slow)(batch.next_observations, next_actions)
        y = bellman_target(self.rewards(batch), batch.terminated, jnp.min(members, axis=0), self.discount)
        return y if self.value_min is None and self.value_max is None else jnp.clip(y, self.value_min, self.value_max)

    def critic_loss(
        self,
        critic: CriticEnsemble,
        batch: Transitions,
        y: Float[Array, " rows"],
        next_actions: Float[Array, "rows act_dim"],
        actions: Float[Array, "rows act_dim"],
        is_warm: Bool[Array, ""],
    ) -> tuple[Float[Array, ""], tuple[Float[Array, ""], Float[Array, ""], Float[Array, " rows"]]]:
        """One member's part of L_f, then its Bellman error, pessimism and values of the logged actions.

        Args:
            critic: a single member, as inside `over_members`.
            batch: rows of the log.
            y: of `target`.
            next_actions: a', constants.
            actions: a~, constants.
            is_warm: whether Bellman's error stands alone.
        """
        inputs = [(batch.observations, batch.actions), (batch.next_observations, next_actions)]
        inputs.append((batch.observations, actions))
        rows = jnp.concatenate([jnp.concatenate(pair, axis=-1) for pair in inputs])
        logged, following, chosen = jnp.split(critic.value(rows), 3)  # one call for all three
        own = bellman_target(self.rewards(batch), batch.terminated, following, self.discount)
        residual = jnp.mean(jnp.square(logged - own))  # a gradient through s' too
        bellman = (1.0 - self.residual_weight) * td_loss(logged, y) + self.residual_weight * residual
        pessimism = jnp.mean(chosen - logged)
        loss = jnp.where(is_warm, bellman, tempered(pessimism, bellman, self.bellman_weight))
        return loss, (bellman, pessimism, logged)

    def actor_loss(
        self,
        actor: ExactGaussianActor,
        critics: CriticEnsemble,
        batch: Transitions,
        noise: Float[Array, "rows act_dim"],
        temperature: Float[Array, ""],
        is_warm: Bool[Array, ""],
    ) -> tuple[Float[Array, ""], Metrics]:
        """L_pi; gradients reach the actor only."""
        actions, log_density = actor.sample(batch.observations, noise)
        first = jax.tree.map(lambda leaf: leaf[:1], critics)  # always the same one, no minimum
        values = first.as_constants(batch.observations, actions)[0]
        misfit = -actor.log_density(batch.observations, batch.actions)
        aim = jnp.where(is_warm, jnp.mean(misfit), -jnp.mean(values))
        loss = tempered(aim, jnp.mean(log_density), jax.lax.stop_gradient(temperature))
        metrics = {
            "actor/loss": loss,
            "actor/value": jnp.mean(values),
            "actor/misfit": jnp.mean(misfit),
            "actor/entropy": -jnp.mean(log_density),
        }
        return loss, metrics

    # ---- training -----------------------------------------------------------------------------------------------

    def update(self, state: ATACState, batch: Transitions, key: PRNGKeyArray) -> tuple[ATACState, Metrics]:
        """The critics step and are projected, their slow copies follow, then alpha steps, then the actor."""
        key_next, key_here = jr.split(key)
        batch = dataclasses.replace(batch, actions=jnp.clip(batch.actions, -LARGEST_ACTION, LARGEST_ACTION))
        is_warm = state.step < self.warm_start_updates
        noise = jr.normal(key_here, batch.actions.shape)
        next_actions, _ = state.actor.now.sample(batch.next_observations, jr.normal(key_next, batch.actions.shape))
        actions, log_density = state.actor.now.sample(batch.observations, noise)

        y = self.target(state, batch, next_actions)

        def member(critic: CriticEnsemble) -> tuple[CriticEnsemble, tuple[Array, Array, Array]]:
            return jax.grad(self.critic_loss, has_aux=True)(critic, batch, y, next_actions, actions, is_warm)

        gradient, (bellman, pessimism, values) = over_members(member, CriticEnsemble(state.critics.now))
        critics = state.critics.stepped(gradient.networks, self.critic_learning_rate)
        now = projected(critics.now, self.weight_norm)
        critics = dataclasses.replace(critics, now=now, slow=polyak(critics.slow, now, self.target_rate))

        target_entropy = float(-batch.actions.shape[1]) if self.target_entropy is None else self.target_entropy
        slope = jax.grad(temperature_loss)(state.log_temperature.now, log_density, target_entropy)
        log_temperature = state.log_temperature.stepped(slope, self.critic_learning_rate)

        temperature = jnp.exp(log_temperature.now)
        slope, actor_metrics = jax.grad(self.actor_loss, has_aux=True)(
            state.actor.now, CriticEnsemble(now), batch, noise, temperature, is_warm
        )
        rate = jnp.where(is_warm, self.critic_learning_rate, self.actor_learning_rate)
        actor = self._with_fresh_moments(state).stepped(slope, rate)
        metrics = actor_metrics | {
            "critic/loss": jnp.sum(bellman),
            "critic/pessimism": jnp.mean(pessimism),
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
            "temperature/value": temperature,
        }
        return ATACState(state.step + 1, actor, critics, log_temperature), metrics

    def _with_fresh_moments(self, state: ATACState) -> Trained[ExactGaussianActor]:
        """The actor, whose optimiser begins anew at the end of the warm start."""
        is_due = state.step == self.warm_start_updates
        fresh = initial_moments(state.actor.now)
        moments = jax.tree.map(lambda new, old: jnp.where(is_due, new, old), fresh, state.actor.moments)
        return dataclasses.replace(state.actor, moments=moments)

    def actor(self, state: ATACState) -> ExactGaussianActor:
        """pi."""
        return state.actor.now

    def values(self, state: ATACState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
