"""IQL: values of the logged actions alone, by an expectile, and cloning weighted by advantage (Kostrikov et al. 2022).

    L_V  = mean_B |expectile - 1(u < 0)| u^2,             u = min_k Q'_k(s, a) - V(s)
    w    = min( exp( beta ( min_k Q'_k(s, a) - V(s) ) ), cap )
    L_pi = - mean_B sg[w] log pi(a|s)
    y    = r + discount (1 - d) V(s')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2

beta is the inverse temperature. No action that the log does not hold is ever asked for its value: V climbs towards the
best of those logged near a state, as far as the expectile says. V steps first, then the actor by the new V, then the
critics by the new V, and their slow copies Q' follow. An end cuts the bootstrap, a time-out does not. The actor's step
size falls along half a cosine.

pi is a Gaussian around tanh(MLP(s)) that is not squashed, with one standard deviation a dimension for all states;
trained, it acts by its mean. The deterministic actor has (mu(s) - a)^2, summed over dimensions, in place of
- log pi(a|s). Rewards are shifted and then scaled; with "returns" the episodes' returns span 1,000.

Differs from the paper: observations are normalised.
"""

import dataclasses
import math
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.ranges import (
    require_counts,
    require_not_negative,
    require_positive,
    require_reward_scale,
    require_temporal_difference,
)
from odaf.algorithms.return_scale import scale_of_returns
from odaf.components.adam import falling_rate
from odaf.components.critics import CriticEnsemble
from odaf.components.distributions import gaussian_log_density
from odaf.components.losses import ensemble_td_gradient, expectile_loss
from odaf.components.networks import MLP, init_mlp
from odaf.components.numbers import Number
from odaf.components.policies import Actor, DeterministicActor, UnsquashedGaussianActor
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError

LARGEST_ACTION = 1.0 - 1e-5  # logged actions are cut to plus or minus this


class IQLState(LearnerState):
    """State of IQL."""

    step: Int[Array, ""]
    actor: Trained[Actor]  # no slow copy
    value: Trained[MLP]  # V; no slow copy
    critics: Trained[MLP]
    reward_scale: Float[Array, ""]


def value_loss(
    value: MLP, observations: Float[Array, "rows obs_dim"], lowest: Float[Array, " rows"], expectile: Number
) -> Float[Array, ""]:
    """L_V for the lowest slow critic's values of the logged actions; gradients reach V only."""
    return expectile_loss(jax.lax.stop_gradient(lowest) - value(observations)[:, 0], expectile)


def cloning_weights(advantages: Float[Array, " rows"], inverse_temperature: Number, cap: Number) -> Array:
    """w, a constant."""
    return jax.lax.stop_gradient(jnp.minimum(jnp.exp(inverse_temperature * advantages), cap))


def actor_loss(actor: Actor, batch: Transitions, weights: Float[Array, " rows"]) -> Float[Array, ""]:
    """L_pi; gradients reach the actor only."""
    if isinstance(actor, DeterministicActor):
        misfit = jnp.sum(jnp.square(actor.mode(batch.observations) - batch.actions), axis=-1)
    else:
        assert isinstance(actor, UnsquashedGaussianActor)
        misfit = -gaussian_log_density(*actor.parameters(batch.observations), batch.actions, batch.own_actions)
    return jnp.mean(jax.lax.stop_gradient(weights) * misfit)


def _cut(batch: Transitions) -> Transitions:
    return dataclasses.replace(batch, actions=jnp.clip(batch.actions, -LARGEST_ACTION, LARGEST_ACTION))


def _lowest(state: IQLState, batch: Transitions) -> Float[Array, " rows"]:
    """min_k Q'_k(s, a)."""
    assert state.critics.slow is not None
    return jnp.min(CriticEnsemble(state.critics.slow)(batch.observations, batch.actions), axis=0)


@dataclasses.dataclass(frozen=True)
class IQL(Algorithm[IQLState]):
    """Implicit Q-learning: an expectile of the logged actions' values, and cloning of the actions above it."""

    kind: ClassVar[str] = "iql"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})
    draws_apart: ClassVar[bool] = True

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor, V and critics."""
    actor_kind: Literal["gaussian", "deterministic"] = "gaussian"
    """What is cloned: a Gaussian whose draws are not squashed, or a single action a state."""
    expectile: float = 0.7
    """Of the logged actions' values, in (0, 1): 0.5 is their mean, towards 1 their best."""
    inverse_temperature: float = 3.0
    """beta: how steeply the weight of a logged action rises with its advantage; 0 clones all alike."""
    weight_cap: float = 100.0
    """Largest weight of a logged action."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    reward_scale: Literal["returns"] | float = "returns"
    """Factor on all rewards, after the shift; "returns" lets the returns of the log's episodes span 1,000."""
    reward_shift: float = 0.0
    """Added to every reward, such as -1 in mazes whose reward is 1 at the goal."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    learning_rate: float = 3e-4
    """Step size of Adam for all networks."""
    actor_decay_updates: int = 1_000_000
    """Updates in which the actor's step size falls to 0 along half a cosine; 0 keeps it."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        if not 0.0 < self.expectile < 1.0:
            raise ConfigError(f"expectile={self.expectile} must lie in (0, 1): 0.5 is the mean, towards 1 the best")
        require_temporal_difference(self)
        require_reward_scale(self, "or 'returns'")
        require_positive(self, ["weight_cap"])
        require_counts(self, ["batch_size"])
        require_not_negative(self, ("inverse_temperature", "actor_decay_updates", "normaliser_epsilon"))

    def can_be_padded(self) -> bool:
        """Yes: what it averages and draws is of own dimensions."""
        return type(self) is IQL

    def citations(self) -> tuple[citations.Citation, ...]:
        """IQL."""
        return (citations.IQL,)

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
        """The factor by which the returns of the log's episodes span 1,000; nothing is trained."""
        del normaliser, key, progress
        if self.reward_scale != "returns":
            return (), {"warnings": []}
        factor = scale_of_returns(dataset, self.reward_shift)
        return jnp.asarray(factor, jnp.float32), {"warnings": [], "reward_scale": factor}

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> IQLState:
        """Networks of orthogonal weights and zero biases, slow critics equal to the critics, fresh optimisers."""
        inner = self.hidden_sizes

        def drawn(purpose: int, *sizes: int, members: int | None = None) -> MLP:
            gain = math.sqrt(2.0)
            return init_mlp(jr.fold_in(key, purpose), sizes, members=members, hidden_bias=0.0, orthogonal_gain=gain)

        network = drawn(0, spec.obs_dim, *inner, spec.act_dim)
        is_gaussian = self.actor_kind == "gaussian"
        actor = (
            UnsquashedGaussianActor(network, jnp.zeros(spec.act_dim)) if is_gaussian else DeterministicActor(network)
        )
        return IQLState(
            step=jnp.asarray(0),
            actor=Trained.begin(actor, slow=False),
            value=Trained.begin(drawn(1, spec.obs_dim, *inner, 1), slow=False),
            critics=Trained.begin(drawn(2, spec.obs_dim + spec.act_dim, *inner, 1, members=2)),
            reward_scale=jnp.asarray(models if isinstance(self.reward_scale, str) else self.reward_scale, jnp.float32),
        )

    def update(self, state: IQLState, batch: Transitions, key: PRNGKeyArray) -> tuple[IQLState, Metrics]:
        """A step of V, of the actor by the new V, of the critics by the new V; then their slow copies follow."""
        del key
        is_apart = batch.actor is not None
        own, batch = _cut(batch.for_actor), _cut(batch)
        lowest = _lowest(state, batch)

        loss_v, slope = jax.value_and_grad(value_loss)(state.value.now, batch.observations, lowest, self.expectile)
        value = state.value.stepped(slope, self.learning_rate)

        advantages = (_lowest(state, own) if is_apart else lowest) - value.now(own.observations)[:, 0]
        weights = cloning_weights(advantages, self.inverse_temperature, self.weight_cap)
        loss_pi, slope = jax.value_and_grad(actor_loss)(state.actor.now, own, weights)
        actor = state.actor.stepped(slope, self.actor_rate(state.step))

        rewards = state.reward_scale * (batch.rewards + self.reward_shift)
        y = bellman_target(rewards, batch.terminated, value.now(batch.next_observations)[:, 0], self.discount)
        online = CriticEnsemble(state.critics.now)
        slope, loss_q, values = ensemble_td_gradient(online, batch.observations, batch.actions, y)
        critics = state.critics.stepped(slope.networks, self.learning_rate, self.target_rate)

        metrics = {
            "value/loss": loss_v,
            "value/advantage": jnp.mean(advantages) / state.reward_scale,
            "actor/loss": loss_pi,
            "actor/weight": jnp.mean(weights),
            "actor/capped": jnp.mean((weights >= self.weight_cap).astype(weights.dtype)),
            "critic/loss": loss_q,
            "critic/mean": jnp.mean(values) / state.reward_scale,
            "critic/min": jnp.min(values) / state.reward_scale,
            "critic/max": jnp.max(values) / state.reward_scale,
            "target/mean": jnp.mean(y) / state.reward_scale,
        }
        return IQLState(state.step + 1, actor, value, critics, state.reward_scale), metrics

    def actor_rate(self, step: Int[Array, ""]) -> Number:
        """The actor's step size after `step` updates."""
        return falling_rate(self.learning_rate, step, self.actor_decay_updates)

    def actor(self, state: IQLState) -> Actor:
        """pi."""
        return state.actor.now

    def values(self, state: IQLState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
