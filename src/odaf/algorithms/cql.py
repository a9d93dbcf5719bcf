"""CQL: soft actor-critic whose critics are pressed down where the log holds no action (Kumar et al. 2020).

    y      = r + discount (1 - d) min_k Q'_k(s', a'),                                       a' ~ pi(s')
    gap_k  = T log sum_i exp( ( Q_k(s, a_i) - log p_i ) / T ) - Q_k(s, a)
    L_Q    = sum_k mean_B ( Q_k(s, a) - y )^2 + weight mean_B clip( gap_k, low, high )
    L_pi   = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                              a~ ~ pi(s)

The a_i are 3 n actions, n uniform, n of pi(s') and n of pi(s), all valued at s; p_i is the density each was drawn from
(`odaf.components.conservative`). With `lagrange_gap` the penalty is eta weight ( mean_B clip( gap_k ) - lagrange_gap )
and eta, which starts at e, climbs on it: it grows while the critics exceed the logged action's value by more than that.
With `backup_actions` above 1 the target takes the best of so many a' by the lower critic. For the first
`cloning_updates` the actor's loss has - log pi(a|s) in place of the critics. All losses of an update are taken at the
parameters from before it; then the slow copies move.

pi has one trunk; its log standard deviation is m out + c with learnt m and c, cut to [-20, 2]. Its density is exact.

Differs from the paper: it follows public codes (CORL; young-geng/CQL), whose target has no entropy and whose target
critics begin as copies. Hidden layers of the actor begin with zero biases.
"""

import dataclasses
import math
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.ranges import (
    require_counts,
    require_not_negative,
    require_order,
    require_positive,
    require_reward_scale,
    require_temporal_difference,
)
from odaf.algorithms.return_scale import scale_of_returns
from odaf.components.candidates import best_soft_value
from odaf.components.chunks import gradient_over_chunks
from odaf.components.conservative import Candidates, SoftMaximum, draw_candidates, values_and_gaps
from odaf.components.critics import CriticEnsemble, over_members
from odaf.components.duals import Dual, ascended
from odaf.components.losses import soft_actor_loss, td_loss, temperature_loss
from odaf.components.networks import MLP, init_mlp
from odaf.components.policies import ExactGaussianActor, draw_actions
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View

HIDDEN_GAIN, OUTPUT_GAIN = math.sqrt(2.0), 0.01  # of the critics' orthogonal layers; the actor's head has the latter
LOG_STD_MIN, LOG_STD_MAX, LOG_STD_OFFSET = -20.0, 2.0, -1.0
LARGEST_ACTION = 0.999  # logged actions that are cloned are cut to plus or minus this
LOG_MULTIPLIER_RANGE = (-math.inf, math.log(1e6))
LOWEST = 1.0  # weight of the lower critic, and the other's 0


class CQLState(LearnerState):
    """State of CQL."""

    step: Int[Array, ""]
    actor: Trained[ExactGaussianActor]  # no slow copy
    critics: Trained[MLP]
    log_temperature: Trained[Float[Array, ""]]  # log alpha; no slow copy
    log_multiplier: Dual | None  # log eta; None without `lagrange_gap`
    reward_scale: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class CQL(Algorithm[CQLState]):
    """Conservative Q-learning: soft actor-critic with a penalty on the values of actions that the log does not hold."""

    kind: ClassVar[str] = "cql"
    draws_apart: ClassVar[bool] = True
    warm_up: ClassVar[str | None] = "cloning_updates"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    conservative_weight: float = 10.0
    """Weight of the penalty in each critic's loss (5 or 10)."""
    num_actions: int = 10
    """n, actions a state of each of the penalty's three sources."""
    penalty_temperature: float = 1.0
    """T: towards 0 the soft maximum is the largest value."""
    soft_maximum: SoftMaximum = "all"
    """What one soft maximum is taken over: "all" 3 n actions; or "threes", one action a source with the mean over n
    such, as in some public codes, whose scores were made that way."""
    gap_min: float | None = None
    """Least gap of a row (ant mazes -200); None sets no bound."""
    gap_max: float | None = None
    """Largest gap of a row; None sets no bound."""
    lagrange_gap: float | None = None
    """Gap that a multiplier of the weight steers to (ant mazes 0.8); None keeps the weight."""
    backup_actions: int = 1
    """Actions at s' of which the target takes the best (ant mazes 10)."""
    cloning_updates: int = 0
    """Updates at the start in which the actor clones the log."""
    actor_hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of the actor's hidden layers."""
    critic_hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Widths of the critics' hidden layers."""
    initial_log_std_scale: float = 1.0
    """m before the first update; 0 begins with one spread for all states."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    reward_scale: Literal["returns"] | float = 1.0
    """Factor on all rewards, after the shift; "returns" lets the returns of the log's episodes span 1,000."""
    reward_shift: float = 0.0
    """Added to every reward."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    actor_learning_rate: float = 3e-5
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics, and for the multiplier."""
    temperature_learning_rate: float = 3e-5
    """Step size of Adam for log alpha; 0 keeps alpha at its initial value."""
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
        require_reward_scale(self, "or 'returns'")
        require_positive(self, ("penalty_temperature", "initial_temperature"))
        require_counts(self, ("num_actions", "backup_actions", "batch_size"))
        require_not_negative(self, ("conservative_weight", "cloning_updates", "normaliser_epsilon"))
        require_order(self, "gap_min", "gap_max")

    def citations(self) -> tuple[citations.Citation, ...]:
        """CQL, and SAC that it stands on."""
        return (citations.CQL, citations.SAC)

    def view(self) -> View:
        """Single rows with the reward as logged: its scale is part of the state."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """A factor on the rewards, where the log decides it."""
        del key, spec
        return jnp.ones(()) if self.reward_scale == "returns" else ()

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """The factor by which the returns of the log's episodes span 1,000, where asked for; nothing is trained."""
        del normaliser, key, progress
        if self.reward_scale != "returns":
            return (), {"warnings": []}
        factor = scale_of_returns(dataset, self.reward_shift)
        return jnp.asarray(factor, jnp.float32), {"warnings": [], "reward_scale": factor}

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> CQLState:
        """Orthogonal critics and an actor with a small head; slow critics equal to the critics, fresh optimisers."""
        key_actor, key_critics = jr.split(key)
        sizes = (spec.obs_dim, *self.actor_hidden_sizes, 2 * spec.act_dim)
        head_bound = OUTPUT_GAIN * math.sqrt(6.0 / (sizes[-2] + sizes[-1]))  # Glorot's, times the gain
        network = init_mlp(key_actor, sizes, hidden_bias=0.0, output_bound=head_bound)
        network = eqx.tree_at(lambda mlp: mlp.biases[-1], network, jnp.zeros(sizes[-1]))
        scale, offset = jnp.asarray(self.initial_log_std_scale, jnp.float32), jnp.asarray(LOG_STD_OFFSET)
        critics = init_mlp(
            key_critics,
            (spec.obs_dim + spec.act_dim, *self.critic_hidden_sizes, 1),
            members=2,
            hidden_bias=0.0,
            orthogonal_gain=HIDDEN_GAIN,
            output_gain=OUTPUT_GAIN,
        )
        log_temperature = jnp.log(jnp.asarray(self.initial_temperature, jnp.float32))
        is_adaptive = self.lagrange_gap is not None
        return CQLState(
            step=jnp.asarray(0),
            actor=Trained.begin(ExactGaussianActor(network, scale, offset, LOG_STD_MIN, LOG_STD_MAX), slow=False),
            critics=Trained.begin(critics),
            log_temperature=Trained.begin(log_temperature, slow=False),
            log_multiplier=Trained.begin(jnp.ones(()), slow=False) if is_adaptive else None,
            reward_scale=jnp.asarray(models if isinstance(self.reward_scale, str) else self.reward_scale, jnp.float32),
        )

    # ---- losses -------------------------------------------------------------------------------------------------

    def target(self, state: CQLState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        assert state.critics.slow is not None
        noise = jr.normal(key, (self.backup_actions, *batch.actions.shape))
        actions, _ = draw_actions(state.actor.now, batch.next_observations, noise)
        next_values = best_soft_value(state.critics.slow, batch.next_observations, actions, LOWEST)
        rewards = state.reward_scale * (batch.rewards + self.reward_shift)
        return bellman_target(rewards, batch.terminated, next_values, self.discount)

    def penalty(self, gaps: Float[Array, " rows"]) -> Float[Array, ""]:
        """weight ( mean_B clip( gap ) - lagrange_gap ), before the multiplier."""
        if self.gap_min is not None or self.gap_max is not None:
            gaps = jnp.clip(gaps, self.gap_min, self.gap_max)
        allowed = 0.0 if self.lagrange_gap is None else self.lagrange_gap
        return self.conservative_weight * (jnp.mean(gaps) - allowed)

    def critic_gradient(
        self, state: CQLState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[MLP, Float[Array, ""], Metrics]:
        """Gradient of L_Q in the critics, and the mean of their penalties for the multiplier."""
        key_target, key_candidates = jr.split(key)
        y = self.target(state, batch, key_target)
        candidates = draw_candidates(key_candidates, state.actor.now, batch, self.num_actions).in_chunks()
        multiplier = 1.0 if state.log_multiplier is None else jnp.exp(state.log_multiplier.now)

        def loss(critic: CriticEnsemble, chunk: tuple[Candidates, Array]) -> tuple[Float[Array, ""], tuple[Array, ...]]:
            rows, targets = chunk
            values, gaps = values_and_gaps(critic, rows, self.penalty_temperature, self.soft_maximum)
            error, penalty = td_loss(values, targets), self.penalty(gaps)
            return error + multiplier * penalty, (error, penalty, values, gaps)

        def member(critic: CriticEnsemble) -> tuple[CriticEnsemble, tuple[Array, ...]]:
            return gradient_over_chunks(loss, critic, (candidates, y.reshape(candidates.observations.shape[:2])))

        gradient, (errors, penalties, values, gaps) = over_members(member, CriticEnsemble(state.critics.now))
        metrics = {
            "critic/loss": jnp.sum(jnp.mean(errors, axis=1)),
            "critic/mean": jnp.mean(values) / state.reward_scale,
            "critic/min": jnp.min(values) / state.reward_scale,
            "critic/max": jnp.max(values) / state.reward_scale,
            "target/mean": jnp.mean(y) / state.reward_scale,
            "conservative/gap": jnp.mean(gaps),
        }
        return gradient.networks, jnp.mean(penalties), metrics

    def actor_loss(
        self, actor: ExactGaussianActor, state: CQLState, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], tuple[Float[Array, " rows"], Metrics]]:
        """L_pi as a function of the actor; also log pi(a~|s) for the temperature."""
        actions, log_density = actor.sample(batch.observations, jr.normal(key, batch.actions.shape))
        values = jnp.min(CriticEnsemble(state.critics.now).as_constants(batch.observations, actions), axis=0)
        aims = values
        if self.cloning_updates > 0:
            logged = jnp.clip(batch.actions, -LARGEST_ACTION, LARGEST_ACTION)
            cloned = actor.log_density(batch.observations, logged)
            aims = jnp.where(state.step < self.cloning_updates, cloned, values)
        loss = soft_actor_loss(log_density, aims, jnp.exp(state.log_temperature.now))
        value = jnp.mean(values) / state.reward_scale
        metrics = {"actor/loss": loss, "actor/value": value, "actor/entropy": -jnp.mean(log_density)}
        return loss, (log_density, metrics)

    # ---- training -----------------------------------------------------------------------------------------------

    def update(self, state: CQLState, batch: Transitions, key: PRNGKeyArray) -> tuple[CQLState, Metrics]:
        """Temperature, actor, multiplier and critics step from the same old parameters; then the slow copies move."""
        key_actor, key_critic = jr.split(key)
        actor_gradient, (log_density, actor_metrics) = jax.grad(self.actor_loss, has_aux=True)(
            state.actor.now, state, batch.for_actor, key_actor
        )
        critic_gradient, penalty, critic_metrics = self.critic_gradient(state, batch, key_critic)
        target_entropy = float(-batch.actions.shape[1]) if self.target_entropy is None else self.target_entropy
        slope = jax.grad(temperature_loss)(state.log_temperature.now, log_density, target_entropy)
        log_temperature = state.log_temperature.stepped(slope, self.temperature_learning_rate)
        metrics = actor_metrics | critic_metrics | {"temperature/value": jnp.exp(log_temperature.now)}
        log_multiplier = state.log_multiplier
        if log_multiplier is not None:
            log_multiplier = ascended(log_multiplier, penalty, self.critic_learning_rate, LOG_MULTIPLIER_RANGE)
            metrics["conservative/multiplier"] = jnp.exp(log_multiplier.now)
        new_state = CQLState(
            step=state.step + 1,
            actor=state.actor.stepped(actor_gradient, self.actor_learning_rate),
            critics=state.critics.stepped(critic_gradient, self.critic_learning_rate, self.target_rate),
            log_temperature=log_temperature,
            log_multiplier=log_multiplier,
            reward_scale=state.reward_scale,
        )
        return new_state, metrics

    def actor(self, state: CQLState) -> ExactGaussianActor:
        """pi."""
        return state.actor.now

    def values(self, state: CQLState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
