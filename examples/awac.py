"""A learner of one's own: advantage-weighted actor-critic (AWAC, Nair et al. 2020), on the parts that odaf offers.

    y    = r + discount (1 - d) min_k Q'_k(s', a'),   a' ~ pi(s')
    L_Q  = sum_k mean_B ( Q_k(s, a) - y )^2
    L_pi = - mean_B w log pi(a|s),    w = softmax over the batch of A(s, a) / temperature, times the batch's size
    A    = min_k Q_k(s, a) - min_k Q_k(s, a~),        a~ ~ pi(s)

`odaf.fit(AWAC(), ...)` needs nothing else. The command line knows it once a package offers it as an entry point:
`[project.entry-points."odaf.algorithms"]  awac = "awac:AWAC"`; then `odaf train awac.toml --data FILE --out DIR`.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr

from odaf.algorithms.base import Algorithm, LearnerState
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.losses import ensemble_td_gradient
from odaf.components.policies import init_gaussian_actor
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.view import View


class AWACState(LearnerState):
    step: jax.Array
    actor: Trained
    critics: Trained

    @property
    def slow_critics(self):
        assert self.critics.slow is not None
        return CriticEnsemble(self.critics.slow)


@dataclasses.dataclass(frozen=True)
class AWAC(Algorithm[AWACState]):
    """Cloning of the logged actions, weighted by how much better than the policy's own they are."""

    kind: ClassVar[str] = "awac"

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    temperature: float = 1.0
    """Advantages are divided by this before they become weights."""
    learning_rate: float = 3e-4
    """Step size of Adam."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    batch_size: int = 256
    """Transitions a gradient step."""

    def view(self):
        return View(discount=self.discount)

    def init(self, key, spec, models):
        shape = (spec.obs_dim, spec.act_dim, self.hidden_sizes)
        critics = init_critics(jr.fold_in(key, 1), *shape, 2, "layer", 3e-3)
        actor = init_gaussian_actor(jr.fold_in(key, 0), *shape)
        return AWACState(jnp.asarray(0), Trained.begin(actor, slow=False), Trained.begin(critics))

    def update(self, state, batch, key):
        noise, next_noise = jr.normal(key, (2, *batch.actions.shape))
        actor, critics = state.actor.now, CriticEnsemble(state.critics.now)
        next_actions, _ = actor.sample(batch.next_observations, next_noise)
        next_values = jnp.min(state.slow_critics(batch.next_observations, next_actions), axis=0)
        y = bellman_target(batch.rewards, batch.terminated, next_values, self.discount)
        gradient, critic_loss, values = ensemble_td_gradient(critics, batch.observations, batch.actions, y)
        own = critics(batch.observations, actor.sample(batch.observations, noise)[0])
        advantage = jnp.min(values, axis=0) - jnp.min(own, axis=0)
        weights = jax.nn.softmax(advantage / self.temperature) * self.batch_size

        def actor_loss(actor):
            return -jnp.mean(weights * actor.log_density(batch.observations, batch.actions))

        loss, actor_gradient = jax.value_and_grad(actor_loss)(actor)
        new_actor = state.actor.stepped(actor_gradient, self.learning_rate)
        new_critics = state.critics.stepped(gradient.networks, self.learning_rate, self.target_rate)
        metrics = {"actor/loss": loss, "critic/loss": critic_loss, "critic/mean": jnp.mean(values)}
        return AWACState(state.step + 1, new_actor, new_critics), metrics

    def actor(self, state):
        return state.actor.now

    def values(self, state):
        return CriticEnsemble(state.critics.now)
