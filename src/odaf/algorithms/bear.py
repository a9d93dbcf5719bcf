"""BEAR: an actor whose actions have the support of the log's (Kumar et al. 2019).

    L_G    = mean_{B, dims} ( a^ - a )^2 + 0.5 mean_{B, dims} KL( q || N(0, 1) ),      a^ = tanh( decoder(s, z) )
    y      = r + discount (1 - d) max_i ( w min_k Q'_k(s', a_i) + (1 - w) max_k Q'_k(s', a_i) ),      a_i ~ pi(.|s')
    L_Q    = sum_k mean_B ( Q_k(s, a) - y )^2
    MMD(s) = sqrt( mean_ij k(x_i, x_j) + mean_ij k(y_i, y_j) - 2 mean_ij k(x_i, y_j) + 1e-6 )
    L_pi   = mean_B ( alpha ( MMD(s) - threshold ) - 1[step > warm_up_steps] min_k Q_k(s, a~) ),    a~ = tanh(x_1)

w is 0.75. x_i are draws of the actor before the tanh, y_j outputs of the decoder before the tanh for z ~ clip( N(0, 1),
-0.5, 0.5 ), constants. The kernel k is exp( -||x - y||^2 / (2 width) ) or exp( -|x - y|_1 / (2 width) ). alpha is the
multiplier of the constraint MMD <= threshold: log alpha climbs along alpha mean_B ( MMD(s) - threshold ), from the
first update on, and stays in [-5, 10].

The auto-encoder of actions is trained beside the critics, by L_G alone, and steps first; then the critics, the actor
against the new critics, and alpha by the discrepancy that the actor's loss saw. The slow critics follow at each update;
the actor has no slow copy. An end cuts the bootstrap, a time-out does not. The trained policy takes the one of 100
draws that Q_1 values most.

Differs from the paper: it is the form that the D4RL benchmark ran (targets from the actor itself, one action in the
actor's value, networks of 256 units). Observations are normalised. The trained policy's 100 draws come from noise that
is the same for every state and step, so that it is deterministic; asked for a draw, it takes fresh ones.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.algorithms.ranges import (
    require_counts,
    require_not_negative,
    require_positive,
    require_temporal_difference,
    require_unit_interval,
)
from odaf.components.behaviour_models import BehaviourCVAE, init_behaviour_cvae
from odaf.components.candidates import best_soft_value, fixed_normal
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.cvae import decoded_draws
from odaf.components.discrepancy import Kernel, discrepancy
from odaf.components.duals import Dual, ascended
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP, init_mlp
from odaf.components.policies import GaussianActor
from odaf.components.ranked_actors import RankedGaussianActor
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View


class BEARState(LearnerState):
    """State of BEAR."""

    step: Int[Array, ""]
    behaviour: Trained[BehaviourCVAE]  # no slow copy
    actor: Trained[GaussianActor]  # no slow copy
    critics: Trained[MLP]
    log_weight: Dual  # log alpha


def draws_before_tanh(
    actor: GaussianActor, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "draws rows act_dim"]
) -> Float[Array, "draws rows act_dim"]:
    """x_i: several draws a state before the tanh, from one pass through the actor."""
    mean, log_std = actor.parameters(observations)
    return mean[None] + jnp.exp(log_std)[None] * noise


@dataclasses.dataclass(frozen=True)
class BEAR(Algorithm[BEARState]):
    """Actor-critic held to the support of the logged actions by a maximum mean discrepancy."""

    kind: ClassVar[str] = "bear"
    warm_up: ClassVar[str | None] = "warm_up_steps"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    kernel: Kernel = "gaussian"
    """What the discrepancy sees samples through: squared distances, or sums of absolute ones (laplacian)."""
    kernel_width: float = 20.0
    """Width of the kernel, in units of actions before the tanh; it is not squared."""
    threshold: float = 0.05
    """Discrepancy that the actor may keep from the log."""
    num_draws: int = 4
    """Draws of the actor and of the auto-encoder a state that the discrepancy is taken between."""
    num_actions: int = 10
    """Draws a successor that the target takes the best of."""
    num_candidates: int = 100
    """Draws that the trained policy takes the best of."""
    lowest_weight: float = 0.75
    """w: weight of the lower critic in a target's values, the rest is the higher one's."""
    warm_up_steps: int = 40_000
    """Updates at the start in which the actor only fits the log."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    behaviour_hidden_sizes: tuple[int, ...] = (750, 750)
    """Widths of the hidden layers of the auto-encoder of actions."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    actor_learning_rate: float = 1e-4
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics."""
    behaviour_learning_rate: float = 3e-4
    """Step size of Adam for the auto-encoder."""
    weight_learning_rate: float = 1e-3
    """Step size of Adam for log alpha."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        require_temporal_difference(self)
        require_positive(self, ["kernel_width"])
        require_unit_interval(self, "lowest_weight")
        require_counts(self, ("num_draws", "num_actions", "num_candidates", "batch_size"))
        require_not_negative(self, ("threshold", "warm_up_steps", "normaliser_epsilon"))

    def citations(self) -> tuple[citations.Citation, ...]:
        """BEAR."""
        return (citations.BEAR,)

    def view(self) -> View:
        """Single rows with the reward as logged."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> BEARState:
        """Random networks, slow critics equal to the critics, alpha 1, fresh optimisers."""
        del models
        key_behaviour, key_actor, key_critics = jr.split(key, 3)
        sizes = (spec.obs_dim, *self.hidden_sizes, 2 * spec.act_dim)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        behaviour = init_behaviour_cvae(key_behaviour, spec.obs_dim, spec.act_dim, self.behaviour_hidden_sizes)
        return BEARState(
            step=jnp.asarray(0),
            behaviour=Trained.begin(behaviour, slow=False),
            actor=Trained.begin(GaussianActor(init_mlp(key_actor, sizes, hidden_bias=0.0)), slow=False),
            critics=Trained.begin(critics),
            log_weight=Trained.begin(jnp.zeros(()), slow=False),
        )

    def target(self, state: BEARState, batch: Transitions, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """y, the same for both critics."""
        assert state.critics.slow is not None
        noise = jr.normal(key, (self.num_actions, *batch.actions.shape))
        actions = jnp.tanh(draws_before_tanh(state.actor.now, batch.next_observations, noise))
        values = best_soft_value(state.critics.slow, batch.next_observations, actions, self.lowest_weight)
        return bellman_target(batch.rewards, batch.terminated, values, self.discount)

    def actor_loss(
        self,
        actor: GaussianActor,
        state: BEARState,
        behaviour: BehaviourCVAE,
        critics: CriticEnsemble,
        batch: Transitions,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, ""], Metrics]:
        """L_pi; gradients reach the actor only. Q takes part from the update after the warm-up on."""
        key_actor, key_behaviour = jr.split(key)
        rows = batch.actions.shape[0]
        noise = jr.normal(key_actor, (self.num_draws, *batch.actions.shape))
        latent_noise = jr.normal(key_behaviour, (self.num_draws, rows, behaviour.cvae.latent_dim))
        own = draws_before_tanh(actor, batch.observations, noise)
        logged = jax.lax.stop_gradient(decoded_draws(behaviour.cvae.decoder, batch.observations, latent_noise))
        apart = discrepancy(own, logged, self.kernel, self.kernel_width)
        values = jnp.min(critics.as_constants(batch.observations, jnp.tanh(own[0])), axis=0)
        counts = (state.step >= self.warm_up_steps).astype(values.dtype)
        weight = jax.lax.stop_gradient(jnp.exp(state.log_weight.now))
        loss = jnp.mean(weight * (apart - self.threshold) - counts * values)
        return loss, {
            "actor/loss": loss,
            "actor/discrepancy": jnp.mean(apart),
            "actor/value": jnp.mean(values),
        }

    def update(self, state: BEARState, batch: Transitions, key: PRNGKeyArray) -> tuple[BEARState, Metrics]:
        """A step of the auto-encoder, of the critics and their slow copies, of the actor, and of alpha."""
        key_behaviour, key_target, key_actor = jr.split(key, 3)
        observations = batch.observations

        def behaviour_loss(behaviour: BehaviourCVAE) -> Float[Array, ""]:
            noise = behaviour.draw_noise(key_behaviour, batch.actions.shape[0])
            return behaviour.loss(observations, batch.actions, noise)

        loss_g, slope = jax.value_and_grad(behaviour_loss)(state.behaviour.now)
        behaviour = state.behaviour.stepped(slope, self.behaviour_learning_rate)

        y = self.target(state, batch, key_target)
        online = CriticEnsemble(state.critics.now)
        slope, loss_q, values = ensemble_td_gradient(online, observations, batch.actions, y)
        critics = state.critics.stepped(slope.networks, self.critic_learning_rate, self.target_rate)

        new = CriticEnsemble(critics.now)
        slope, metrics = jax.grad(self.actor_loss, has_aux=True)(
            state.actor.now, state, behaviour.now, new, batch, key_actor
        )
        actor = state.actor.stepped(slope, self.actor_learning_rate)
        violation = metrics["actor/discrepancy"] - self.threshold
        log_weight = ascended(state.log_weight, violation, self.weight_learning_rate)
        metrics |= {
            "actor/weight": jnp.exp(log_weight.now),
            "behaviour/loss": loss_g,
            "critic/loss": loss_q,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
        }
        return BEARState(state.step + 1, behaviour, actor, critics, log_weight), metrics

    def actor(self, state: BEARState) -> RankedGaussianActor:
        """The best of pi's draws by Q_1."""
        critic = jax.tree.map(lambda leaf: leaf[0], state.critics.now)
        width = state.actor.now.network.weights[-1].shape[-1] // 2
        return RankedGaussianActor(state.actor.now, critic, fixed_normal(self.num_candidates, width))

    def values(self, state: BEARState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
