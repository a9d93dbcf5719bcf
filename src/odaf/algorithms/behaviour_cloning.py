"""Behaviour cloning: the policy that does what the log did, on average.

mu minimises mean over batch and action dimensions of (mu(s) - a)^2, with mu = tanh(MLP). It ignores rewards, so it is
the floor that an offline learner has to beat.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.components.adam import adam_step, first_moments
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions


class CloningState(LearnerState):
    """State of behaviour cloning."""

    step: Int[Array, ""]
    actor: DeterministicActor
    actor_optimiser: optax.OptState


def cloning_loss(actor: DeterministicActor, batch: Transitions) -> Float[Array, ""]:
    """Mean over rows and action dimensions of (mu(s) - a)^2."""
    return jnp.mean(jnp.square(actor.mode(batch.observations) - batch.actions))


@dataclasses.dataclass(frozen=True)
class BehaviourCloning(Algorithm[CloningState]):
    """Regression of logged actions on states."""

    kind: ClassVar[str] = "behaviour-cloning"

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the actor's hidden layers."""
    learning_rate: float = 3e-4
    """Step size of Adam."""
    batch_size: int = 256
    """Transitions a gradient step."""
    discount: float = 0.99
    """Not used by the loss; kept so that value ranges can be reported for every learner."""

    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """No side networks."""
        del key, spec
        return ()

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """Nothing to pre-train."""
        del dataset, normaliser, key, progress
        return (), {"warnings": []}

    def init(self, key: PRNGKeyArray, spec: Spec, side: PyTree) -> CloningState:
        """Random actor, fresh optimiser."""
        del side
        actor = init_deterministic_actor(key, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        return CloningState(jnp.asarray(0), actor, first_moments(actor))

    def update(self, state: CloningState, batch: Transitions, key: PRNGKeyArray) -> tuple[CloningState, Metrics]:
        """One Adam step on the cloning loss."""
        del key
        loss, gradient = jax.value_and_grad(cloning_loss)(state.actor, batch)
        actor, moments = adam_step(self.learning_rate, gradient, state.actor_optimiser, state.actor)
        return CloningState(state.step + 1, actor, moments), {"actor/loss": loss}

    def actor(self, state: CloningState) -> DeterministicActor:
        """mu."""
        return state.actor
