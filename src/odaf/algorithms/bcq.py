"""BCQ: the best of actions that the log could hold, each moved a little (Fujimoto et al. 2019).

    a^       = tanh( decoder(s, z) ),    z ~ q(z|s, a)
    L_G      = mean_{B, dims} ( a^ - a )^2 + 0.5 mean_{B, dims} KL( q || N(0, 1) )
    xi(s, a) = clip( a + perturbation tanh( MLP(s, a) ), -1, 1 )
    y        = r + discount (1 - d) max_i ( w min_k Q'_k(s', a_i) + (1 - w) max_k Q'_k(s', a_i) ),
               a_i = xi'( s', tanh( decoder(s', z_i) ) ),    z_i ~ clip( N(0, 1), -0.5, 0.5 )
    L_Q      = sum_k mean_B ( Q_k(s, a) - y )^2
    L_xi     = - mean_B Q_1( s, xi( s, tanh( decoder(s, z) ) ) ),    z ~ clip( N(0, 1), -0.5, 0.5 )

w is 0.75. The auto-encoder of actions is trained beside the critics, by L_G alone, and steps first; z is cut where it
is drawn from the prior, never in L_G. The target moves actions of the new decoder by the slow copy xi' of the
perturbation. Then the critics step, the perturbation against the new critics, and the slow copies of both follow at
each update; the auto-encoder has none. An end cuts the bootstrap, a time-out does not. The trained policy takes the one
of 100 actions that Q_1 values most.

Differs from the paper: observations are normalised, and the trained policy's 100 draws of z are the same for every
state and step, so that it is deterministic; asked for a draw, it takes fresh ones. Biases of hidden layers start at 0
instead of uniform.
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
    require_temporal_difference,
    require_unit_interval,
)
from odaf.components.behaviour_models import BehaviourCVAE, init_behaviour_cvae
from odaf.components.candidates import best_soft_value, fixed_normal
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.cvae import decoded_draws
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP, init_mlp
from odaf.components.numbers import Number
from odaf.components.ranked_actors import PerturbedActor, perturbed
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError


class BCQState(LearnerState):
    """State of BCQ."""

    step: Int[Array, ""]
    behaviour: Trained[BehaviourCVAE]  # no slow copy
    critics: Trained[MLP]
    perturbation: Trained[MLP]  # of xi


def perturbation_loss(
    perturbation: MLP,
    critics: CriticEnsemble,
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    reach: Number,
) -> tuple[Float[Array, ""], Metrics]:
    """L_xi for actions of the decoder, which are constants; gradients reach the perturbation only."""
    moved = perturbed(perturbation, reach, observations, jax.lax.stop_gradient(actions)[None])[0]
    first = CriticEnsemble(jax.tree.map(lambda leaf: leaf[:1], critics.networks))
    values = first.as_constants(observations, moved)[0]
    loss = -jnp.mean(values)
    return loss, {
        "actor/loss": loss,
        "actor/value": jnp.mean(values),
        "actor/shift": jnp.mean(jnp.abs(moved - actions)),
    }


@dataclasses.dataclass(frozen=True)
class BCQ(Algorithm[BCQState]):
    """Batch-constrained Q-learning: critics choose among actions of a model of the log."""

    kind: ClassVar[str] = "bcq"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    perturbation: float = 0.05
    """How far an action may be moved, in each dimension of [-1, 1]; 0 chooses among the model's actions as they are."""
    num_actions: int = 10
    """Actions a successor that the target takes the best of."""
    num_candidates: int = 100
    """Actions that the trained policy takes the best of."""
    lowest_weight: float = 0.75
    """w: weight of the lower critic in a target's values, the rest is the higher one's."""
    hidden_sizes: tuple[int, ...] = (400, 300)
    """Widths of the hidden layers of the perturbation and of the critics."""
    behaviour_hidden_sizes: tuple[int, ...] = (750, 750)
    """Widths of the hidden layers of the auto-encoder of actions."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_rate: float = 5e-3
    """Share of critics and perturbation that enters their slow copies at each update."""
    learning_rate: float = 1e-3
    """Step size of Adam for all networks."""
    batch_size: int = 100
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        require_temporal_difference(self)
        if not 0.0 <= self.perturbation <= 2.0:
            raise ConfigError(f"perturbation={self.perturbation} must lie in [0, 2], the width of an action's range")
        require_unit_interval(self, "lowest_weight")
        require_counts(self, ("num_actions", "num_candidates", "batch_size"))
        require_not_negative(self, ["normaliser_epsilon"])

    def citations(self) -> tuple[citations.Citation, ...]:
        """BCQ."""
        return (citations.BCQ,)

    def view(self) -> View:
        """Single rows with the reward as logged."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> BCQState:
        """Random networks, slow copies equal to them, fresh optimisers."""
        del models
        key_behaviour, key_critics, key_perturbation = jr.split(key, 3)
        inputs = spec.obs_dim + spec.act_dim
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        perturbation = init_mlp(key_perturbation, (inputs, *self.hidden_sizes, spec.act_dim), hidden_bias=0.0)
        behaviour = init_behaviour_cvae(key_behaviour, spec.obs_dim, spec.act_dim, self.behaviour_hidden_sizes)
        return BCQState(
            jnp.asarray(0), Trained.begin(behaviour, slow=False), Trained.begin(critics), Trained.begin(perturbation)
        )

    def target(
        self, state: BCQState, behaviour: BehaviourCVAE, batch: Transitions, key: PRNGKeyArray
    ) -> Float[Array, " rows"]:
        """y, the same for both critics, from actions of a model moved by the slow perturbation."""
        assert state.critics.slow is not None and state.perturbation.slow is not None
        observations = batch.next_observations
        noise = jr.normal(key, (self.num_actions, observations.shape[0], behaviour.cvae.latent_dim))
        actions = jnp.tanh(decoded_draws(behaviour.cvae.decoder, observations, noise))
        actions = perturbed(state.perturbation.slow, self.perturbation, observations, actions)
        values = best_soft_value(state.critics.slow, observations, actions, self.lowest_weight)
        return bellman_target(batch.rewards, batch.terminated, values, self.discount)

    def update(self, state: BCQState, batch: Transitions, key: PRNGKeyArray) -> tuple[BCQState, Metrics]:
        """A step of the auto-encoder, of the critics, of the perturbation; slow copies follow."""
        key_behaviour, key_target, key_actor = jr.split(key, 3)
        rows, observations = batch.actions.shape[0], batch.observations

        def behaviour_loss(behaviour: BehaviourCVAE) -> Float[Array, ""]:
            return behaviour.loss(observations, batch.actions, behaviour.draw_noise(key_behaviour, rows))

        loss_g, slope = jax.value_and_grad(behaviour_loss)(state.behaviour.now)
        behaviour = state.behaviour.stepped(slope, self.learning_rate)

        y = self.target(state, behaviour.now, batch, key_target)
        online = CriticEnsemble(state.critics.now)
        slope, loss_q, values = ensemble_td_gradient(online, observations, batch.actions, y)
        critics = state.critics.stepped(slope.networks, self.learning_rate, self.target_rate)

        actions = behaviour.now.act(observations, behaviour.now.draw_noise(key_actor, rows))
        new = CriticEnsemble(critics.now)
        slope, metrics = jax.grad(perturbation_loss, has_aux=True)(
            state.perturbation.now, new, observations, actions, self.perturbation
        )
        perturbation = state.perturbation.stepped(slope, self.learning_rate, self.target_rate)
        metrics |= {
            "behaviour/loss": loss_g,
            "critic/loss": loss_q,
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(y),
        }
        return BCQState(state.step + 1, behaviour, critics, perturbation), metrics

    def actor(self, state: BCQState) -> PerturbedActor:
        """The best of the model's moved actions by Q_1."""
        perturbation = state.perturbation.now
        return PerturbedActor(
            decoder=state.behaviour.now.cvae.decoder,
            perturbation=perturbation,
            reach=jnp.asarray(self.perturbation, perturbation.biases[0].dtype),
            critic=jax.tree.map(lambda leaf: leaf[0], state.critics.now),
            noise=fixed_normal(self.num_candidates, state.behaviour.now.cvae.latent_dim),
        )

    def values(self, state: BCQState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)
