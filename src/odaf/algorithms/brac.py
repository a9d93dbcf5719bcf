"""BRAC: an actor-critic that pays for its divergence from whoever acted in the log (Wu et al. 2019).

    D(s)  = mean_i ( log pi(a_i|s) - log beta(a_i|s) ),                                       a_i ~ pi(.|s)
    y     = r + discount (1 - d) ( min_k Q'_k(s', a') - v alpha D(s') ),                      a' ~ pi(.|s')
    L_Q   = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi  = mean_B ( alpha D(s) - 1[step > warm_up_steps] min_k Q_k(s, a~) ),                 a~ ~ pi(.|s)

v is 1 with a value penalty (BRAC-v) and 0 without (BRAC-p). beta is a density of the logged actions, fitted beforehand
and frozen; inside log beta, and nowhere else, actions are cut to plus or minus 0.999. The gradient of L_pi passes
through both logarithms. There is no bonus for entropy and no slow copy of the actor. The critics step first, their slow
copies follow at each update, then the actor steps against the new critics. An end cuts the bootstrap, a time-out does
not. pi and beta are tanh-Gaussians whose standard deviation lies in [e^-5, 1]; the trained policy acts by tanh(mean).

With a target divergence alpha is learned: it climbs along D - target and stays in [0, 500]. In place of the divergence
above, "mmd" takes the squared maximum mean discrepancy between actions of pi and of beta, after the tanh, by a
Laplacian kernel exp(-|x - y|_1 / 20).

Differs from the paper: observations are normalised. a~ and a' are draws of their own beside those of D, from one pass
through the actor. beta is trained on most episodes; the others measure its error.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.ranges import require_counts, require_not_negative, require_temporal_difference
from odaf.components.behaviour_models import BehaviourConfig, fit_gaussian, init_gaussian, log_density_inside
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.discrepancy import squared_discrepancy
from odaf.components.duals import Dual, ascended_directly
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP
from odaf.components.numbers import Number
from odaf.components.policies import NarrowGaussianActor, draw_actions
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError

LARGEST_WEIGHT = 500.0  # of a learned alpha
KERNEL_WIDTH = 10.0  # of the Laplacian kernel exp( -|x - y|_1 / (2 width) )
BETA = BehaviourConfig(hidden_sizes=(200, 200), steps=300_000, learning_rate=5e-4)

Draws = tuple[Float[Array, "draws rows act_dim"], Float[Array, "draws rows"]]  # actions, log pi


class BRACState(LearnerState):
    """State of BRAC."""

    step: Int[Array, ""]
    actor: Trained[NarrowGaussianActor]  # no slow copy
    critics: Trained[MLP]
    weight: Dual | None  # alpha, where it is learned
    behaviour: NarrowGaussianActor  # beta, frozen


def kl_estimate(
    draws: Draws, behaviour: NarrowGaussianActor, observations: Float[Array, "rows obs_dim"]
) -> Float[Array, " rows"]:
    """D of actions drawn from pi; the gradient passes through log pi and through the place where log beta is asked."""
    actions, log_density = draws
    return jnp.mean(log_density - log_density_inside(behaviour, observations, actions), axis=0)


@dataclasses.dataclass(frozen=True)
class BRAC(Algorithm[BRACState]):
    """Actor-critic regularised by the divergence from a density of the logged actions."""

    kind: ClassVar[str] = "brac"
    warm_up: ClassVar[str | None] = "warm_up_steps"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    value_penalty: bool = True
    """Whether the divergence at the successor is taken off the target too (BRAC-v), or stands in the actor's loss alone
    (BRAC-p)."""
    weight: float = 1.0
    """alpha, what a nat of divergence costs in units of reward; where it is learned, its first value."""
    divergence: Literal["kl", "mmd"] = "kl"
    """Estimate of how far the policy is from the log: Kullback-Leibler, or a maximum mean discrepancy."""
    num_draws: int = 4
    """Actions a state that the divergence is estimated with."""
    target_divergence: float | None = None
    """Divergence that alpha steers to; None keeps alpha as it is."""
    warm_up_steps: int = 20_000
    """Updates at the start in which the actor only fits the divergence."""
    behaviour: BehaviourConfig = BETA
    """Sizes and training of beta."""
    hidden_sizes: tuple[int, ...] = (200, 200)
    """Widths of the actor's hidden layers."""
    critic_hidden_sizes: tuple[int, ...] = (300, 300)
    """Widths of the critics' hidden layers."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    actor_learning_rate: float = 3e-5
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 1e-3
    """Step size of Adam for the critics."""
    weight_learning_rate: float = 1e-3
    """Step size of Adam for a learned alpha."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        require_temporal_difference(self)
        if not 0.0 <= self.weight <= LARGEST_WEIGHT:
            raise ConfigError(f"weight={self.weight} must lie in [0, {LARGEST_WEIGHT:g}]")
        require_counts(self, ("num_draws", "batch_size"))
        require_not_negative(self, ("warm_up_steps", "normaliser_epsilon"))

    def citations(self) -> tuple[citations.Citation, ...]:
        """BRAC."""
        return (citations.BRAC,)

    def view(self) -> View:
        """Single rows with the reward as logged."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> NarrowGaussianActor:
        """beta before it is fitted."""
        return init_gaussian(key, spec.obs_dim, spec.act_dim, self.behaviour.hidden_sizes)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[NarrowGaussianActor, dict[str, Any]]:
        """Fit beta to the log."""

        def told(done: int, steps: int) -> None:
            progress("behaviour", done, steps)

        behaviour, findings = fit_gaussian(self.behaviour, dataset, normaliser, key, told)
        return behaviour, {"warnings": findings.pop("warnings"), "behaviour": findings}

    def pretraining(self) -> Hashable:
        """beta's settings."""
        return self.behaviour

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> BRACState:
        """Random networks, slow critics equal to the critics, fresh optimisers; beta as it was fitted."""
        key_actor, key_critics = jr.split(key)
        actor = init_gaussian(key_actor, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.critic_hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        weight = jnp.asarray(self.weight, jnp.float32)
        return BRACState(
            step=jnp.asarray(0),
            actor=Trained.begin(actor, slow=False),
            critics=Trained.begin(critics),
            weight=None if self.target_divergence is None else Trained.begin(weight, slow=False),
            behaviour=models,
        )

    def divergences(
        self, state: BRACState, draws: Draws, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray
    ) -> Float[Array, " rows"]:
        """D(s), or the discrepancy in its place."""
        if self.divergence == "kl":
            return kl_estimate(draws, state.behaviour, observations)
        logged, _ = draw_actions(state.behaviour, observations, jr.normal(key, draws[0].shape))
        return squared_discrepancy(draws[0], logged, "laplacian", KERNEL_WIDTH)

    def target(self, state: BRACState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        assert state.critics.slow is not None
        key_draws, key_behaviour = jr.split(key)
        draws = 1 + (self.num_draws if self.value_penalty else 0)
        noise = jr.normal(key_draws, (draws, *batch.actions.shape))
        actions, log_density = draw_actions(state.actor.now, batch.next_observations, noise)
        values = jnp.min(CriticEnsemble(state.critics.slow)(batch.next_observations, actions[0]), axis=0)
        if self.value_penalty:
            others = actions[1:], log_density[1:]
            divergence = self.divergences(state, others, batch.next_observations, key_behaviour)
            values = values - self._weight(state) * divergence
        return bellman_target(batch.rewards, batch.terminated, values, self.discount)

    def actor_loss(
        self,
        actor: NarrowGaussianActor,
        state: BRACState,
        critics: CriticEnsemble,
        batch: Transitions,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, ""], Metrics]:
        """L_pi; gradients reach the actor only. Q takes part from the update after the warm-up on."""
        key_draws, key_behaviour = jr.split(key)
        noise = jr.normal(key_draws, (1 + self.num_draws, *batch.actions.shape))
        actions, log_density = draw_actions(actor, batch.observations, noise)
        divergence = self.divergences(state, (actions[1:], log_density[1:]), batch.observations, key_behaviour)
        values = jnp.min(critics.as_constants(batch.observations, actions[0]), axis=0)
        counts = (state.step >= self.warm_up_steps).astype(values.dtype)
        loss = jnp.mean(self._weight(state) * divergence - counts * values)
        return loss, {
            "actor/loss": loss,
            "actor/divergence": jnp.mean(divergence),
            "actor/value": jnp.mean(values),
        }

    def update(self, state: BRACState, batch: Transitions, key: PRNGKeyArray) -> tuple[BRACState, Metrics]:
        """A step of the critics and their slow copies, of the actor against the new critics, and of a learned alpha."""
        key_target, key_actor = jr.split(key)
        y = self.target(state, batch, key_target)
        online = CriticEnsemble(state.critics.now)
        slope, loss, values = ensemble_td_gradient(online, batch.observations, batch.actions, y)
        critics = state.critics.stepped(slope.networks, self.critic_learning_rate, self.target_rate)

        new = CriticEnsemble(critics.now)
        slope, metrics = jax.grad(self.actor_loss, has_aux=True)(state.actor.now, state, new, batch, key_actor)
        actor = state.actor.stepped(slope, self.actor_learning_rate)

        weight = state.weight
        if weight is not None:
            assert self.target_divergence is not None
            violation = metrics["actor/divergence"] - self.target_divergence
            weight = ascended_directly(weight, violation, self.weight_learning_rate, (0.0, LARGEST_WEIGHT))
            metrics |= {"actor/weight": weight.now}
        metrics |= {
            "critic/loss": loss,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
        }
        return BRACState(state.step + 1, actor, critics, weight, state.behaviour), metrics

    def _weight(self, state: BRACState) -> Number:
        return self.weight if state.weight is None else state.weight.now

    def actor(self, state: BRACState) -> NarrowGaussianActor:
        """pi."""
        return state.actor.now

    def values(self, state: BRACState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
