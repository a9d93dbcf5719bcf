"""Behaviour cloning: the policy that does what the log did, on average.

mu minimises mean over batch and action dimensions of (mu(s) - a)^2, with mu = tanh(MLP). It ignores rewards, so it is
the floor that an offline learner has to beat.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError


class CloningState(LearnerState):
    """State of behaviour cloning."""

    step: Int[Array, ""]
    actor: Trained[DeterministicActor]  # no slow copy


def cloning_loss(actor: DeterministicActor, batch: Transitions) -> Float[Array, ""]:
    """Mean over rows and action dimensions of (mu(s) - a)^2."""
    return jnp.mean(jnp.square(actor.mode(batch.observations) - batch.actions))


@dataclasses.dataclass(frozen=True)
class BehaviourCloning(Algorithm[CloningState]):
    """Regression of logged actions on states."""

    kind: ClassVar[str] = "behaviour-cloning"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the actor's hidden layers."""
    learning_rate: float = 3e-4
    """Step size of Adam."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 0.0
    """Added to the standard deviations that observations are divided by, in their own units (papers 1e-3); 0 makes
    units of no account."""

    def __post_init__(self) -> None:
        if self.normaliser_epsilon < 0.0:
            raise ConfigError(f"normaliser_epsilon={self.normaliser_epsilon} must not be negative")

    def view(self) -> View:
        """Single rows; rewards do not matter."""
        return View(normaliser_epsilon=self.normaliser_epsilon)

    def citations(self) -> tuple[citations.Citation, ...]:
        """Cloning of logged actions by a network."""
        return (citations.CLONING,)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> CloningState:
        """Random actor, fresh optimiser."""
        del models
        actor = init_deterministic_actor(key, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        return CloningState(jnp.asarray(0), Trained.begin(actor, slow=False))

    def update(self, state: CloningState, batch: Transitions, key: PRNGKeyArray) -> tuple[CloningState, Metrics]:
        """One Adam step on the cloning loss."""
        del key
        loss, gradient = jax.value_and_grad(cloning_loss)(state.actor.now, batch)
        return CloningState(state.step + 1, state.actor.stepped(gradient, self.learning_rate)), {"actor/loss": loss}

    def actor(self, state: CloningState) -> DeterministicActor:
        """mu."""
        return state.actor.now
